"""Live view: a policy in real time in the browser or in a window, and the same as a standalone page.

The page is drawn by viser (https://viser.studio), which needs no graphics on this machine.
There is no password, so it listens on 127.0.0.1 only, and answers who asks for that machine by name;
to watch from elsewhere, ``ssh -L 8080:localhost:8080 HOST``.  :func:`show` opens MuJoCo's own viewer instead.

In:  a policy and an environment.
Out: a page at http://localhost:8080, an .html file, or a window until it is closed.
"""

import contextlib
import io
import os
import queue
import sys
import time
import webbrowser
from pathlib import Path

from agility_ref.curriculum import hardest
from agility_ref.env import EnvConfig, Go1Env
from agility_ref.errors import UserError, unknown_name
from agility_ref.evaluate import EvaluationConfig
from agility_ref.files import write_text
from agility_ref.pictures.loopback import LOOPBACK, refusing_strangers
from agility_ref.pictures.plots import skill_colour
from agility_ref.pictures.record import Episode
from agility_ref.pictures.scene import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    LOOK_GROUP,
    SPHERE,
    WAYPOINT_COLOURS,
    make_scene,
    mark_waypoints,
)
from agility_ref.selector import Hierarchy, Single
from agility_ref.terrain import COURSE_KINDS, NUM_WAYPOINTS, Course, make_course
from agility_ref.world import World

import mujoco
import numpy as np

PUSH = 1.0  # [m/s] added to the trunk's velocity by a push
MISSING = "the live view needs one more package: pip install viser; `agility-ref video` and `plot strobe` do not"


class Session:
    """One robot that plays on and on; what the page's controls act on."""

    def __init__(self, policy: Single | Hierarchy, environment: str, config: EvaluationConfig):
        if environment not in COURSE_KINDS:
            raise unknown_name("environment", environment, COURSE_KINDS)
        highest = hardest(config.preset)
        self.policy, self.environment, self.config = policy, environment, config
        self.difficulty = highest / 2 if config.difficulty is None else config.difficulty
        self.paused, self.number, self.last_ending = False, -1, ""
        self.by_hand: int | None = None  # index of the skill that the visitor chose
        self.skill_names = tuple(s.name for s in policy.skills) if isinstance(policy, Hierarchy) else ()
        self.next_course()

    def next_course(self, difficulty: float | None = None) -> None:
        """Start on another course, of another difficulty if one is given."""
        self.number += 1
        self.difficulty = self.difficulty if difficulty is None else difficulty
        env_config, seed = EnvConfig().clean() if self.config.clean else EnvConfig(), self.config.seed + self.number
        rng = np.random.default_rng([self.config.seed, self.number])
        self.course = make_course(self.environment, self.difficulty, rng)
        self.env = Go1Env(World([self.course]), 1, env_config, seed=seed, num_threads=1)
        self._qpos, self._qvel = self.env.simulation.qpos, self.env.simulation.qvel
        self.observation, _ = self.env.reset(seed)
        self.skill: int | None = None  # chosen at the last step
        self.wanted: int | None = None  # ... and named by the oracle there

    def step(self) -> None:
        """Advance by one step; a finished episode starts again on the same course."""
        if self.skill_names:
            self.wanted = int(self.policy.labels[self.env.oracle_skill()[0]])
        if self.by_hand is not None:
            self.skill = self.by_hand
            action = self.policy.execute(self.observation, np.array([self.by_hand]))
        else:
            action, skill = self.policy.act(self.observation, self.env)
            self.skill = None if skill is None else int(skill[0])
        self.observation, _, terminated, truncated, info = self.env.step(action)
        if terminated[0] or truncated[0]:
            waypoints = info["totals"]["waypoints"][0]
            ending = "fell" if terminated[0] else "finished" if waypoints == NUM_WAYPOINTS else "ran out of time"
            self.last_ending = f"{ending} after {info['totals']['length'][0] * self.env.config.dt:.1f} s"

    def push(self, direction: str) -> None:
        """Kick the trunk to the ``left`` or ``right`` or from ``behind``."""
        forward = np.array([np.cos(self.env.yaw[0]), np.sin(self.env.yaw[0])])
        left = np.array([-forward[1], forward[0]])
        self._qvel[0, :2] += PUSH * {"left": left, "right": -left, "behind": forward}[direction]

    @property
    def qpos(self) -> np.ndarray:
        """(19,) joint positions now, a copy."""
        return self._qpos[0].copy()

    def status(self) -> str:
        """Return what the page shows beside the view, as Markdown."""
        env = self.env
        lines = [
            f"**{self.policy.name}** on **{self.environment}**, d = {self.difficulty:.2f}, course {self.number}",
            f"waypoint **{min(env.waypoint_index[0] + 1, NUM_WAYPOINTS)}** of {NUM_WAYPOINTS}, "
            f"speed {env.base_lin_vel[0, 0]:.1f} of {env.command[0]:.1f} m/s",
        ]
        if self.skill is not None:
            chosen, wanted = self.skill_names[self.skill], self.skill_names[self.wanted]
            by = "by hand" if self.by_hand is not None else "by the policy"
            lines.append(f"skill **{chosen}** {by}; the oracle would take {wanted}")
        if self.last_ending:
            lines.append(f"last episode: {self.last_ending}")
        return "\n\n".join(lines)


# ---------------------------------------------------------------------------- the page


def open_server(port: int):
    """Start viser on the loopback address only; port 0 is any that is free.

    Raises
    ------
    UserError : viser is not installed
    """
    try:
        import viser
    except ImportError:
        raise UserError(MISSING) from None
    with contextlib.redirect_stdout(io.StringIO()), refusing_strangers():  # no banner: ours names the same address
        server = viser.ViserServer(host=LOOPBACK, port=port, label="agility_ref", verbose=False)
    server.scene.set_up_direction("+z")
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    sky = np.linspace([150, 190, 230], [238, 244, 249], 64).astype(np.uint8)
    server.scene.set_background_image(np.repeat(sky[:, None], 2, axis=1))
    server.scene.configure_environment_map("studio", environment_intensity=0.35)
    server.initial_camera.position, server.initial_camera.look_at = (-0.9, -1.6, 0.75), (0.3, 0.0, 0.2)
    return server


def close(server) -> None:
    """Stop a server, quietly."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


def geom_mesh(model: mujoco.MjModel, geom: int):
    """Return the mesh of one primitive geom in the frame of its body, coloured."""
    import trimesh

    size, kind, make = model.geom_size[geom], model.geom_type[geom], trimesh.creation
    mesh = {
        BOX: lambda: make.box(2 * size),
        SPHERE: lambda: make.icosphere(2, size[0]),
        ELLIPSOID: lambda: make.icosphere(3).apply_scale(size),
        CAPSULE: lambda: make.capsule(2 * size[1], size[0], count=[12, 12]),
        CYLINDER: lambda: make.cylinder(size[0], 2 * size[1], sections=20),
    }[mujoco.mjtGeom(int(kind))]()
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    frame, rotation = np.eye(4), np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    frame[:3, :3], frame[:3, 3] = rotation.reshape(3, 3), model.geom_pos[geom]
    mesh.apply_transform(frame)
    if kind in (BOX, CYLINDER):
        mesh.unmerge_vertices()  # so that edges are sharp
    colour = model.geom_rgba[geom] ** [2.2, 2.2, 2.2, 1.0]  # a mesh file holds linear light, not sRGB
    mesh.visual.vertex_colors = np.tile((255 * colour).astype(np.uint8), (len(mesh.vertices), 1))
    return mesh


class Stage:
    """The scene on the page: the course moves past the robot, so the camera follows by itself."""

    def __init__(self, server, course: Course):
        import trimesh

        self.server = server
        self.model = make_scene(course)
        self.data = mujoco.MjData(self.model)
        self.root = server.scene.add_frame("/course", show_axes=False)
        self.bodies = {}
        shown = np.isin(self.model.geom_group, (0, LOOK_GROUP))
        balls = [self.model.geom(f"waypoint{k}").id for k in range(NUM_WAYPOINTS)]
        shown[balls] = False
        for body in range(self.model.nbody):
            geoms = np.flatnonzero(shown & (self.model.geom_bodyid == body))
            if len(geoms):
                name = f"/course/{self.model.body(body).name}"
                mesh = trimesh.util.concatenate([geom_mesh(self.model, g) for g in geoms])
                self.bodies[body] = server.scene.add_mesh_trimesh(name, mesh)
        self.waypoints = self.model.geom_pos[balls]
        for k, place in enumerate(self.waypoints):
            self._ball(f"/course/waypoint{k}", 0.035, "ahead", place)
        # One ball that moves: a browser without a GPU shows a new position at once, a new colour seconds later.
        self.goal = self._ball("/course/goal", 0.042, "current", self.waypoints[0])
        self.label = server.scene.add_label("/label", "", position=(0.0, 0.0, 0.55))

    def _ball(self, name: str, radius: float, state: str, position: np.ndarray):
        colour = tuple(int(WAYPOINT_COLOURS[state][k : k + 2], 16) for k in (1, 3, 5))
        return self.server.scene.add_icosphere(name, radius, color=colour, position=position)

    def update(self, qpos: np.ndarray, waypoint: int, label: str) -> None:
        """Move the robot, mark the current waypoint, write the active skill above the trunk."""
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        with self.server.atomic():
            self.root.position = (-qpos[0], -qpos[1], -qpos[2] + 0.28)
            for body, handle in self.bodies.items():
                if body:
                    handle.position, handle.wxyz = self.data.xpos[body], self.data.xquat[body]
            if label != self.label.text:
                self.label.text = label
            self.goal.position = self.waypoints[min(waypoint, NUM_WAYPOINTS - 1)]

    def remove(self) -> None:
        """Take everything off the page."""
        self.root.remove()
        self.label.remove()


def add_controls(server, session: Session, wishes: queue.SimpleQueue):
    """Add the page's controls; each puts a function into ``wishes`` for the simulation's thread.

    Returns the handle of the status text.
    """
    status = server.gui.add_markdown("")
    colours = [f'<span style="color:{skill_colour(s)}">■</span> {s}' for s in session.skill_names]
    if colours:
        server.gui.add_markdown(" &nbsp; ".join(colours))
    pause = server.gui.add_button_group("simulation", ["pause", "go on"])
    pause.on_click(lambda event: wishes.put(lambda: setattr(session, "paused", event.target.value == "pause")))
    server.gui.add_button("next course").on_click(lambda _: wishes.put(session.next_course))
    difficulty = server.gui.add_slider("difficulty", 0.0, 1.0, 0.05, round(20 * session.difficulty) / 20)
    difficulty.on_update(lambda _: wishes.put(lambda: session.next_course(difficulty.value)))
    push = server.gui.add_button_group("push", ["left", "right", "behind"])
    push.on_click(lambda event: wishes.put(lambda value=event.target.value: session.push(value)))
    if session.skill_names:
        choices = {"the policy chooses": None} | {name: k for k, name in enumerate(session.skill_names)}
        skill = server.gui.add_dropdown("skill", tuple(choices))
        skill.on_update(lambda _: wishes.put(lambda: setattr(session, "by_hand", choices[skill.value])))
    return status


def serve(
    policy: Single | Hierarchy,
    environment: str,
    config: EvaluationConfig,
    port: int = 8080,
    seconds: float = np.inf,
    browser: bool = False,
) -> None:
    """Play in real time until interrupted, or for ``seconds`` of wall time; open a ``browser`` where there is a display.

    Raises
    ------
    UserError : no such port, viser is not installed, or an unknown environment
    """
    if not 1 <= port <= 65535:
        raise UserError(f"port must be between 1 and 65535, got {port}")
    session = Session(policy, environment, config)
    server = open_server(port)
    wishes: queue.SimpleQueue = queue.SimpleQueue()
    status = add_controls(server, session, wishes)
    stage, course = Stage(server, session.course), session.course
    address = f"http://localhost:{server.get_port()}"
    print(f"watch at {address} (this machine only; no password). Ctrl-C stops.", flush=True)
    if browser and has_display():
        webbrowser.open(address)
    dt, begin = session.env.config.dt, time.monotonic()
    tick, counted, steps = begin, begin, 0
    try:
        while time.monotonic() - begin < seconds:
            while not wishes.empty():
                wishes.get()()
            if session.course is not course:
                stage.remove()
                stage, course = Stage(server, session.course), session.course
            if not session.paused:
                session.step()
            skill = session.policy.name if session.skill is None else session.skill_names[session.skill]
            stage.update(session.qpos, session.env.waypoint_index[0], skill)
            steps += 1
            if steps % 25 == 0:
                rate, counted = 25 / (time.monotonic() - counted), time.monotonic()
                pace = "paused" if session.paused else f"{rate:.0f} steps/s; real time is {1 / dt:.0f}"
                status.content = f"{session.status()}\n\n{pace}"
            tick = max(tick + dt, time.monotonic() - 5 * dt)  # catch up a little, never a lot
            time.sleep(max(tick - time.monotonic(), 0.0))
    finally:
        close(server)


def clip(episode: Episode, out: Path, seconds: float = 10.0, fps: int = 25) -> Path:
    """Write an episode as a page that plays without a server; return its path.

    Parameters
    ----------
    episode, out : what was played, and an .html file
    seconds, fps : how much of it, from the start [s], in how many pictures per second
    """
    if not 0.0 < seconds < np.inf:
        raise UserError(f"seconds must be above 0, got {seconds}")
    server = open_server(0)
    try:
        stage = Stage(server, episode.course)
        serializer = server.get_scene_serializer()
        stride = max(round(1 / fps / episode.dt), 1)
        for t in range(0, min(len(episode), round(seconds / episode.dt)), stride):
            stage.update(episode.qpos[t], int(episode.waypoint_index[t]), episode.skill_name(t))
            serializer.insert_sleep(stride * episode.dt)
        out = Path(out)
        out.parent.mkdir(parents=True, exist_ok=True)
        write_text(out, serializer.as_html())
    finally:
        close(server)
    return out


SPACE, RIGHT, LEFT, DOWN, UP = 32, 262, 263, 264, 265  # GLFW key codes
KEYS = """keys: space pauses, N next course, up and down arrows harder and easier, left and right arrows push,
B pushes from behind, 1 to 5 choose a skill by hand, 0 gives the choice back to the policy"""


def has_display() -> bool:
    """Whether a window can be opened here."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def press(session: Session, key: int) -> None:
    """Carry out what a key asks for."""
    highest = hardest(session.config.preset)
    if key == SPACE:
        session.paused = not session.paused
    elif key == ord("N"):
        session.next_course()
    elif key in (UP, DOWN):
        step = highest / 10 if key == UP else -highest / 10
        session.next_course(float(np.clip(session.difficulty + step, 0.0, 1.0)))
    elif key in (LEFT, RIGHT, ord("B")):
        session.push({LEFT: "left", RIGHT: "right"}.get(key, "behind"))
    elif key == ord("0"):
        session.by_hand = None
    elif ord("1") <= key < ord("1") + len(session.skill_names):
        session.by_hand = key - ord("1")


def show(policy: Single | Hierarchy, environment: str, config: EvaluationConfig, steps: int | None = None) -> None:
    """Play in real time until the window is closed, or for a number of steps.

    Raises
    ------
    UserError : this machine has no display
    """
    if not has_display():
        raise UserError("no display for a window; leave --window out to watch in the browser")
    from mujoco import viewer

    session, pressed, left = Session(policy, environment, config), [], steps
    print(KEYS)
    while True:
        number, model = session.number, make_scene(session.course)
        data = mujoco.MjData(model)
        options = {"key_callback": pressed.append, "show_left_ui": False, "show_right_ui": False}
        with viewer.launch_passive(model, data, **options) as window:
            window.cam.type, window.cam.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, model.body("trunk").id
            window.cam.distance, window.cam.azimuth, window.cam.elevation = 2.2, 60.0, -18.0
            while window.is_running() and session.number == number and left != 0:
                due = time.perf_counter() + session.env.config.dt
                while pressed:
                    press(session, pressed.pop(0))
                if not session.paused and session.number == number:
                    session.step()
                    left = left if left is None else left - 1
                data.qpos[:] = session.qpos
                mujoco.mj_forward(model, data)
                mark_waypoints(model, int(session.env.waypoint_index[0]))
                text = session.status().replace("*", "").replace("\n\n", "\n")
                window.set_texts((mujoco.mjtFontScale.mjFONTSCALE_150, mujoco.mjtGridPos.mjGRID_TOPLEFT, text, ""))
                window.sync()
                time.sleep(max(0.0, due - time.perf_counter()))
        if session.number == number:
            return

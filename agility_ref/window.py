"""Native window: the live view where this machine has a display.

MuJoCo's own viewer, driven by the same :class:`~agility_ref.viewer.Session` as the page in
the browser.  In: a policy and an environment.  Out: a window, until it is closed.
"""

import os
import sys
import time

import mujoco
import numpy as np

from agility_ref.errors import UserError
from agility_ref.evaluate import EvaluationConfig
from agility_ref.policies import find_preset
from agility_ref.scene import make_scene, mark_waypoints
from agility_ref.selector import Hierarchy, Single
from agility_ref.viewer import Session

SPACE, RIGHT, LEFT, DOWN, UP = 32, 262, 263, 264, 265  # GLFW key codes
KEYS = """keys: space pauses, N next course, up and down arrows harder and easier, left and right arrows push,
B pushes from behind, 1 to 5 choose a skill by hand, 0 gives the choice back to the policy"""


def has_display() -> bool:
    """Whether a window can be opened here."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def press(session: Session, key: int) -> None:
    """Carry out what a key asks for."""
    highest = find_preset(session.config.preset).max_difficulty
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
    """Play in real time until the window is closed, or for a number of control steps.

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
        with viewer.launch_passive(
            model, data, key_callback=pressed.append, show_left_ui=False, show_right_ui=False
        ) as window:
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
                window.set_texts(
                    (
                        mujoco.mjtFontScale.mjFONTSCALE_150,
                        mujoco.mjtGridPos.mjGRID_TOPLEFT,
                        session.status().replace("*", "").replace("\n\n", "\n"),
                        "",
                    )
                )
                window.sync()
                time.sleep(max(0.0, due - time.perf_counter()))
        if session.number == number:
            return

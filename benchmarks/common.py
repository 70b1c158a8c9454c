"""What the benchmarks share: loads to measure, a fair stopwatch, and the record of a run.

Speed on a shared machine drifts by tens of per cent within seconds, so nothing here is
measured once: :func:`alternate` runs the candidates in turn, and only figures of one run
are divided by each other.
"""

import importlib
import json
import os
import platform
import re
import resource
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from importlib import metadata
from multiprocessing import get_context
from types import ModuleType

from agility_ref.env import EnvConfig, Go1Env

# isort: split
from agility_ref.curriculum import PRESETS, Curriculum, CurriculumConfig, training_world
from agility_ref.env import TRAINING
from agility_ref.errors import UserError
from agility_ref.go1 import DEFAULT_DOF_POS, STAND_HEIGHT, PhysicsConfig, make_model, make_xml
from agility_ref.simulation import Placement
from agility_ref.terrain import CELL, COURSE_KINDS, LANE_LENGTH, LANE_WIDTH, NUM_WAYPOINTS, Box, Course, make_course
from agility_ref.training.progress import processor
from agility_ref.world import height_map

import mujoco
import numpy as np
import tyro
from mujoco import batch

# ---------------------------------------------------------------------------- time


def alternate(blocks: dict[str, Callable[[], float | None]], rounds: int) -> dict[str, np.ndarray]:
    """Time the blocks in turn, each once a round, every other round backwards.

    Parameters
    ----------
    blocks : name -> function.  It may return its own duration [s]; otherwise its wall time counts
    rounds : how often; one more round before them is not counted

    Returns
    -------
    name -> (rounds,) durations [s]
    """
    durations: dict[str, list[float]] = {name: [] for name in blocks}
    for k in range(rounds + 1):
        for name in list(blocks)[:: -1 if k % 2 else 1]:
            start = time.perf_counter()
            own = blocks[name]()
            duration = time.perf_counter() - start if own is None else own
            if k:
                durations[name].append(duration)
    return {name: np.array(values) for name, values in durations.items()}


def ratio(a: np.ndarray, b: np.ndarray) -> dict[str, float]:
    """Median of a over median of b, and the quartiles of the ratios round by round."""
    low, high = np.percentile(a / b, [25, 75])
    return {"value": float(np.median(a) / np.median(b)), "low": float(low), "high": float(high)}


def show(r: dict[str, float]) -> str:
    """Return a :func:`ratio` as text: its value and its quartiles."""
    return f"{r['value']:.2f} ({r['low']:.2f}-{r['high']:.2f})"


def in_fresh_process(function: Callable, *args):
    """Call a module-level function in a new process: nothing is warm, and memory is its own."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(function, *args).result()


def peak_memory(who: int = resource.RUSAGE_SELF) -> float:
    """Peak resident memory [GB] of this process, or of its children."""
    unit = 1 if sys.platform == "darwin" else 1024  # macOS counts bytes, Linux kilobytes
    return resource.getrusage(who).ru_maxrss * unit / 1e9


# ---------------------------------------------------------------------------- record


def available_cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def machine() -> dict:
    """Return the hardware, how busy it was, and the versions, JSON-ready."""
    versions = {"python": platform.python_version()}
    for package in ("agility-ref", "mujoco", "numpy", "torch", "envpool", "stable-baselines3"):
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            pass
    return {
        "cpu": processor(),
        "cores": available_cores(),
        "system": f"{platform.system()} {platform.machine()}",
        "load_average": os.getloadavg()[0],  # of the minute before: above 0.3 the machine was not quiet
        "versions": versions,
    }


def markdown(rows: list[dict]) -> str:
    """Format rows with equal keys as a markdown table."""
    cells = [list(rows[0]), *([str(v) for v in row.values()] for row in rows)]
    widths = [max(len(line[k]) for line in cells) for k in range(len(cells[0]))]
    lines = ["| " + " | ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)) + " |" for line in cells]
    return "\n".join([lines[0], "|" + "|".join("-" * (w + 2) for w in widths) + "|", *lines[1:]])


def report(as_json: bool, started: dict, figures: dict, *tables: list[dict]) -> None:
    """Print the one JSON object of a run, or its tables and the machine.

    Parameters
    ----------
    as_json : which of the two
    started : :func:`machine`, taken before measuring
    figures : everything measured, JSON-ready
    tables : the same, for people
    """
    if as_json:
        print(json.dumps({**started, **figures}))
        return
    for rows in tables:
        print(markdown(rows), end="\n\n")
    versions = ", ".join(f"{name} {version}" for name, version in started["versions"].items())
    print(f"{started['cpu']}, {started['cores']} cores, load {started['load_average']:.1f} before; {versions}")


def start(main: Callable[[object], None], config: type) -> None:
    """Read the command line and run a benchmark; a mistake of the user is one line and exit status 2."""
    try:
        main(tyro.cli(config))
    except UserError as error:
        print(f"{os.path.basename(sys.argv[0])}: {error}", file=sys.stderr)
        sys.exit(2)


def require(name: str, package: str) -> ModuleType:
    """Import an optional module; where it is missing, say so in one line and exit with status 2."""
    try:
        return importlib.import_module(name)
    except ImportError:
        print(f'this comparison needs {package}: pip install "agility-ref[bench]"', file=sys.stderr)
        sys.exit(2)


# ---------------------------------------------------------------------------- courses and models


def mixed_courses(num: int, kinds: tuple[str, ...] = COURSE_KINDS, difficulty: float = 0.5) -> list[Course]:
    """Generate courses, their kinds in turn."""
    return [make_course(kinds[k % len(kinds)], difficulty, seed=k) for k in range(num)]


def flat_course(like: Course) -> Course:
    """One level slab with the waypoints of another course."""
    slab = Box(0.0, LANE_LENGTH, -LANE_WIDTH / 2, LANE_WIDTH / 2, 0.0)
    return Course("walk", 0.0, (slab,), (), like.waypoints)


def models_of(courses: list[Course], physics: PhysicsConfig = PhysicsConfig()) -> list[mujoco.MjModel]:
    """Compile the courses, padded to the same number of boxes as :class:`Go1Env` does."""
    num_boxes = max(len(course.boxes) for course in courses)
    return [make_model(course, physics, num_boxes=num_boxes) for course in courses]


def substitute(xml: str, old: str, new: str) -> str:
    """Replace text that must be there."""
    if old not in xml:
        raise ValueError(f"the model no longer contains {old!r}: adapt this benchmark")
    return xml.replace(old, new)


def other_ground(course: Course, geom: str, physics: PhysicsConfig = PhysicsConfig()) -> str:
    """MJCF of a course, one geom in place of its boxes."""
    xml, count = re.subn(r'<geom class="terrain"[^>]*/>', "", make_xml(course, physics))
    if count != len(course.boxes):
        raise ValueError("the model's boxes have changed: adapt this benchmark")
    attributes = 'contype="1" conaffinity="0" condim="3" priority="1"'
    return substitute(xml, "<worldbody>", f"<worldbody><geom {geom} {attributes}/>")


def plane_model(physics: PhysicsConfig = PhysicsConfig()) -> mujoco.MjModel:
    """One Go1 on an infinite plane."""
    course = flat_course(make_course("walk", 0.0))
    return mujoco.MjModel.from_xml_string(other_ground(course, 'type="plane" size="0 0 1"', physics))


# ---------------------------------------------------------------------------- loads


def trot(num_robots: int, num_steps: int, dt: float = 0.02) -> np.ndarray:
    """Joint targets (num_steps, num_robots, 12) of an open-loop trot at 2.5 Hz, every robot in its own phase."""
    time_ = np.arange(num_steps)[:, None] * dt
    phase = 2 * np.pi * (2.5 * time_ + np.linspace(0.0, 1.0, num_robots, endpoint=False))
    targets = np.tile(DEFAULT_DOF_POS, (num_steps, num_robots, 1))
    for leg, sign in enumerate((1, -1, -1, 1)):  # FR with RL, FL with RR
        lift = np.maximum(sign * np.sin(phase), 0.0)
        targets[:, :, 3 * leg + 1] += 0.25 * lift
        targets[:, :, 3 * leg + 2] -= 0.5 * lift
    return targets


class Trotters:
    """Bare physics: N robots spread over the waypoints of courses, trotting on the spot.

    A call restores the start and simulates ``steps`` control steps, so every call does the
    same work, and the same robots meet the same ground under every candidate.  Robot i is on
    course ``i % len(models)``: neighbours never share a model, which is the slowest order for
    the processor's cache.
    """

    def __init__(
        self,
        models: list[mujoco.MjModel],
        courses: list[Course],
        num_robots: int = 256,
        substeps: int = PhysicsConfig().substeps,
        steps: int = 20,
        num_threads: int = 0,
    ):
        """Place the robots; models[k] is simulated with its robots at the waypoints of courses[k]."""
        self.substeps, self.num_robots, self.steps = substeps, num_robots, steps
        which = np.arange(num_robots) % len(models)
        self.batch = batch.Batch(models[0], num_robots, num_threads)
        Placement(self.batch, models).place(np.arange(num_robots), which)
        self.batch.reset(keyframe=0, stage=mujoco.mjtStage.mjSTAGE_NONE)
        qpos, heights = self.batch.bind("qpos"), {k: height_map(courses[k]) for k in np.unique(which)}
        for i, k in enumerate(which):
            x, y = courses[k].waypoints[(i // 10) % NUM_WAYPOINTS]  # 10 or 400 courses: the same mix
            row, column = round(x / CELL), round((y + LANE_WIDTH / 2) / CELL)
            under = heights[k][row - 15 : row + 15, column - 10 : column + 10]  # 0.6 m x 0.4 m
            qpos[i, :3] = x, y, under.max() + STAND_HEIGHT + 0.01
        self.ctrl = self.batch.bind("ctrl")
        for _ in range(25):  # half a second to settle
            self.batch.step(nstep=substeps)
        self.start = self.batch.state.copy()
        self.targets = trot(num_robots, steps)

    def __call__(self) -> float:
        """Simulate; return the seconds that took."""
        self.batch.state[:] = self.start
        start = time.perf_counter()
        for targets in self.targets:
            self.ctrl[:] = targets
            self.batch.step(nstep=self.substeps)
        return time.perf_counter() - start

    def rate(self, durations: np.ndarray) -> float:
        """Control steps per second of all robots together, median over calls."""
        return float(self.num_robots * self.steps / np.median(durations))


class Taped:
    """An environment that remembers what its simulation was given, to replay it bare.

    The replay starts every step from the same states, models and controls as the
    environment did, so both meet the same contacts; what differs is the environment's
    own work.
    """

    def __init__(self, env: Go1Env):
        """Wrap an environment."""
        self.env = env
        self.bare = batch.Batch(env.simulation.models[0], env.num_envs, env.simulation.batch.nthread)
        self._placement, self._course = Placement(self.bare, env.simulation.models), np.full(env.num_envs, -1)
        self.nstep = env.config.physics.substeps * env.config.action_repeat
        self.tape: list[tuple] = []
        self.step_seconds = self.tape_seconds = 0.0

    def __getattr__(self, name: str):
        return getattr(self.env, name)

    def step(self, action: np.ndarray):
        """Step the environment; record outside the time that counts."""
        start = time.perf_counter()
        before, course = self.env.simulation.batch.state.copy(), self.env.course.copy()
        called = time.perf_counter()
        result = self.env.step(action)
        returned = time.perf_counter()
        self.tape.append((before, course, self.env.simulation.batch.ctrl.copy()))
        self.step_seconds += returned - called
        self.tape_seconds += time.perf_counter() - returned + called - start
        return result

    def rewind(self) -> None:
        """Forget the tape and the times."""
        self.tape, self.step_seconds, self.tape_seconds = [], 0.0, 0.0

    def replay(self) -> float:
        """Simulate the tape without the environment; return the seconds of Batch.step alone."""
        seconds, ctrl = 0.0, self.bare.bind("ctrl")
        for state, course, targets in self.tape:
            moved = np.flatnonzero(course != self._course)
            self._placement.place(moved, course[moved])
            self._course = course
            self.bare.state[:] = state
            ctrl[:] = targets
            start = time.perf_counter()
            try:
                self.bare.step(nstep=self.nstep)
            except batch.SimulationError:
                pass
            seconds += time.perf_counter() - start
        return seconds


def walk_training(
    seed: int, num_envs: int, config: EnvConfig = TRAINING, autoreset: bool = True
) -> tuple[Go1Env, Curriculum]:
    """Build what ``agility-ref train walk --preset quick`` trains on."""
    levels = CurriculumConfig()
    world = training_world(("walk",), levels, PRESETS["quick"], seed)
    curriculum = Curriculum(1, num_envs, levels, seed)
    return Go1Env(world, num_envs, config, curriculum.next_course, seed, autoreset=autoreset), curriculum

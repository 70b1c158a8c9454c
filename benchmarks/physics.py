"""The physics choice: speed of the candidates; ``fidelity.py`` shows what their policies are worth.

    python benchmarks/physics.py [--json]

Speed is bare physics on the same courses, the same open-loop trot.  Each candidate changes
one thing against the chosen physics, ``PhysicsConfig()``.
"""

import contextlib
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

from agility_ref.go1 import PhysicsConfig, make_xml
from agility_ref.terrain import LANE_LENGTH, LANE_WIDTH, Course
from agility_ref.world import height_map

import mujoco
import numpy as np
from common import (
    Trotters,
    alternate,
    flat_course,
    machine,
    mixed_courses,
    other_ground,
    ratio,
    report,
    show,
    start,
    substitute,
)

CHOSEN = PhysicsConfig()


@dataclass(frozen=True)
class Config:
    """Physics candidates."""

    robots: int = 256
    """Robots simulated side by side."""
    courses: int = 50
    """Courses, all kinds in turn."""
    rounds: int = 9
    """Rounds of the alternation; the median counts."""
    steps: int = 20
    """Control steps a block."""
    json: bool = False
    """Print one JSON object."""


@dataclass(frozen=True)
class Candidate:
    """One way to simulate: numbers of PhysicsConfig, edits of the MJCF, another ground."""

    name: str
    physics: PhysicsConfig = CHOSEN
    edits: tuple[tuple[str, str], ...] = ()
    ground: str = "courses"
    """courses (padded alike, as in Go1Env), plane, or, for rough ground: boxes, flat, height field."""


def candidates() -> list[Candidate]:
    """List everything that was considered; the chosen physics first."""

    def step(timestep: float) -> PhysicsConfig:
        return replace(CHOSEN, timestep=timestep, substeps=round(0.02 / timestep))

    def newton(iterations: int, ls_iterations: int) -> PhysicsConfig:
        return replace(CHOSEN, iterations=iterations, ls_iterations=ls_iterations)

    iterations = f'iterations="{CHOSEN.iterations}"'
    listed = [
        Candidate("chosen"),
        *(Candidate(f"{1000 * t:g} ms x {round(0.02 / t)}", step(t)) for t in (0.0025, 0.004, 0.005, 0.01)),
        Candidate("Euler", edits=(("implicitfast", "Euler"),)),
        Candidate("implicit", edits=(("implicitfast", "implicit"),)),
        Candidate("RK4", edits=(("implicitfast", "RK4"),)),
        *(Candidate(f"Newton {n}, {k} line search", newton(n, k)) for n, k in ((2, 6), (4, 6), (10, 10), (100, 50))),
        Candidate("PGS 10", newton(10, CHOSEN.ls_iterations), (('iterations="10"', 'solver="PGS" iterations="10"'),)),
        Candidate("CG 10", newton(10, CHOSEN.ls_iterations), (('iterations="10"', 'solver="CG" iterations="10"'),)),
        Candidate("elliptic cone", edits=(("pyramidal", "elliptic"),)),
        Candidate("elliptic, impratio 100", edits=(("pyramidal", "elliptic"), (iterations, f'impratio="100" {iterations}'))),
        Candidate("joint friction 0.2 N m", edits=(("armature=", 'frictionloss="0.2" armature='),)),
        Candidate("condim 1, no friction", edits=(('condim="3"', 'condim="1"'),)),
        Candidate("condim 4", edits=(('condim="3"', 'condim="4"'),)),
        Candidate("condim 6", edits=(('condim="3"', 'condim="6"'),)),
        Candidate("no midphase", edits=(("<default>", '<option><flag midphase="disable"/></option><default>'),)),
        Candidate("feet alone touch", edits=(('<geom contype="0" conaffinity="1" mass="0"/>', '<geom contype="0" conaffinity="0" mass="0"/>'),)),
        Candidate("infinite plane", ground="plane"),
        Candidate("rough: boxes", ground="boxes"),
        Candidate("rough: height field", ground="height field"),
        Candidate("flat: one box", ground="flat"),
    ]  # fmt: skip
    return listed[:1] + [c for c in listed[1:] if replace(c, name="chosen") != listed[0]]


def candidate_courses(candidate: Candidate, num: int) -> list[Course]:
    """Return the courses on which a candidate's robots stand."""
    if candidate.ground in ("courses", "plane"):
        courses = mixed_courses(num)
    else:
        courses = mixed_courses(num, ("walk",))
    return [flat_course(c) for c in courses] if candidate.ground in ("plane", "flat") else courses


def height_field(course: Course, physics: PhysicsConfig) -> tuple[str, Callable]:
    """MJCF of a course as a height field of 5 cm cells, and what fills it in."""
    heights = height_map(course)[2::5, 2::5].T  # (rows along y, columns along x)
    low, high = heights.min(), heights.max()
    size = f"{LANE_LENGTH / 2} {LANE_WIDTH / 2} {high - low:.6g} 1"
    asset = f'<asset><hfield name="ground" nrow="{heights.shape[0]}" ncol="{heights.shape[1]}" size="{size}"/></asset>'
    geom = f'type="hfield" hfield="ground" pos="{LANE_LENGTH / 2} 0 {low:.6g}"'

    def fill(model: mujoco.MjModel) -> None:
        model.hfield_data[:] = ((heights - low) / (high - low)).ravel()

    return substitute(other_ground(course, geom, physics), "<worldbody>", asset + "<worldbody>"), fill


def compile_candidate(candidate: Candidate, courses: list[Course]) -> list[mujoco.MjModel]:
    """Compile a candidate's model of every course."""
    num_boxes = max(len(course.boxes) for course in courses)
    models = []
    for course in courses:
        fill = None
        if candidate.ground == "plane":
            xml = other_ground(course, 'type="plane" size="0 0 1"', candidate.physics)
        elif candidate.ground == "height field":
            xml, fill = height_field(course, candidate.physics)
        else:
            xml = make_xml(course, candidate.physics, num_boxes)
        for old, new in candidate.edits:
            xml = substitute(xml, old, new)
        models.append(mujoco.MjModel.from_xml_string(xml))
        if fill:
            fill(models[-1])
    return models


def speed(config: Config) -> dict:
    """Measure control steps per second of every candidate, in one alternation."""
    loads = {}
    for candidate in candidates():
        courses = candidate_courses(candidate, config.courses)
        models = compile_candidate(candidate, courses)
        loads[candidate.name] = Trotters(models, courses, config.robots, candidate.physics.substeps, config.steps)
    seconds = alternate(loads, config.rounds)
    return {
        name: {
            "control_steps_per_second": load.rate(seconds[name]),
            "speed_over_chosen": ratio(seconds["chosen"], seconds[name]),
            "contacts": float(contacts(load)),
            "unstable": float((load.batch.warning[:, :, 1].sum(axis=1) > 0).mean()),
        }
        for name, load in loads.items()
    }


def contacts(load: Trotters) -> float:
    """Mean contacts a robot at the end of a block."""
    ncon = load.batch.bind("ncon")
    load()
    return float(np.mean(ncon))


def main(config: Config) -> None:
    started = machine()
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):  # for MUJOCO_LOG.TXT
        figures = {"chosen": asdict(CHOSEN), "speed": speed(config)}
    rows = [
        {
            "candidate": name,
            "control steps/s": f"{f['control_steps_per_second']:.0f}",
            "over chosen": show(f["speed_over_chosen"]),
            "contacts a robot": f"{f['contacts']:.1f}",
            "unstable robots": f"{f['unstable']:.0%}",
        }
        for name, f in figures["speed"].items()
    ]
    report(config.json, started, {"config": asdict(config), **figures}, rows)


if __name__ == "__main__":
    start(main, Config)

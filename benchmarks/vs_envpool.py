"""Against EnvPool's native C++ Go1, the fastest alternative on a CPU that installs with pip.

    python benchmarks/vs_envpool.py [--json]        needs: pip install "agility-ref[bench]"

EnvPool simulates MuJoCo Playground's joystick task: 5 physics steps of 4 ms a control step
and 48 observations, where ours takes its own physics steps and looks at 132 points of the
ground.  Both act at 50 Hz on 2 threads, in turn.  Each of EnvPool's tasks runs in a fresh
process: 256 of its robots take more than 10 GB.
"""

import time
from dataclasses import asdict, dataclass

from agility_ref.env import EnvConfig, Go1Env
from agility_ref.go1 import DEFAULT_DOF_POS, PhysicsConfig
from agility_ref.world import World

import numpy as np
from common import (
    alternate,
    flat_course,
    in_fresh_process,
    machine,
    mixed_courses,
    peak_memory,
    ratio,
    report,
    require,
    show,
    start,
    trot,
)

TASKS = {"flat": "Go1JoystickFlatTerrain-v1", "rough": "Go1JoystickRoughTerrain-v1"}


@dataclass(frozen=True)
class Config:
    """Go1Env against EnvPool."""

    robots: int = 256
    """Robots of both; EnvPool needs about 50 MB for each."""
    threads: int = 2
    """Simulation threads of both."""
    courses: int = 50
    """Courses of ours: walk for rough, level ones for flat."""
    rounds: int = 9
    """Rounds of the alternation; the median counts."""
    steps: int = 20
    """Control steps a block."""
    json: bool = False
    """Print one JSON object."""


def compare(ground: str, config: Config) -> dict:
    """Alternate EnvPool and ours on one kind of ground."""
    envpool = require("envpool", "EnvPool")
    rough = mixed_courses(config.courses, ("walk",))
    world = World(rough if ground == "rough" else [flat_course(course) for course in rough])
    targets = trot(config.robots, config.steps)
    task = EnvConfig(action_repeat=1, scandot_period=2)  # an action for each control step, as theirs
    ours = Go1Env(world, config.robots, task, num_threads=config.threads)
    theirs = envpool.make(TASKS[ground], env_type="gymnasium", num_envs=config.robots, num_threads=config.threads)
    settings = theirs.spec.config._asdict()
    offset = targets - DEFAULT_DOF_POS  # both homes are (0, 0.9, -1.8)
    our_actions = offset / EnvConfig().action_scale
    their_actions = np.clip(offset / settings["action_scale"], -1.0, 1.0)
    ours.reset(0)
    theirs.reset()

    def run(env, actions: np.ndarray) -> float:
        start = time.perf_counter()
        for action in actions:
            env.step(action)
        return time.perf_counter() - start

    seconds = alternate(
        {"ours": lambda: run(ours, our_actions), "envpool": lambda: run(theirs, their_actions)}, config.rounds
    )
    steps = config.robots * config.steps
    substeps = {"ours": PhysicsConfig().substeps, "envpool": round(settings["ctrl_dt"] / settings["sim_dt"])}
    rates = {name: float(steps / np.median(seconds[name])) for name in seconds}
    environment = ratio(seconds["envpool"], seconds["ours"])
    share = substeps["ours"] / substeps["envpool"]
    return {
        "environment_steps_per_second": rates,
        "physics_steps_per_second": {name: rates[name] * substeps[name] for name in rates},
        "environment_over_envpool": environment,
        "physics_over_envpool": {key: value * share for key, value in environment.items()},
        "peak_memory_gb": peak_memory(),
    }


def main(config: Config) -> None:
    require("envpool", "EnvPool")
    started = machine()
    figures = {ground: in_fresh_process(compare, ground, config) for ground in TASKS}
    rows = [
        {
            "ground": ground,
            "steps/s, ours": f"{f['environment_steps_per_second']['ours']:.0f}",
            "EnvPool": f"{f['environment_steps_per_second']['envpool']:.0f}",
            "ours / EnvPool": show(f["environment_over_envpool"]),
            "physics steps, ours / EnvPool": show(f["physics_over_envpool"]),
        }
        for ground, f in figures.items()
    ]
    report(config.json, started, {"config": asdict(config), **figures}, rows)


if __name__ == "__main__":
    start(main, Config)

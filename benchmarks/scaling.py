"""How speed and memory grow with robots, threads and courses.

    python benchmarks/scaling.py [--json]

Every point runs in a process of its own, so that its peak memory is its own.  The points
of a sweep are not alternated: on a busy machine trust the ratios of the other scripts.
"""

import time
from dataclasses import asdict, dataclass

from agility_ref.env import EnvConfig, Go1Env
from agility_ref.go1 import DEFAULT_DOF_POS
from agility_ref.world import World

import numpy as np
from common import available_cores, in_fresh_process, machine, mixed_courses, peak_memory, report, start, trot


@dataclass(frozen=True)
class Config:
    """Scaling."""

    robots: tuple[int, ...] = (1, 4, 16, 64, 256, 1024, 2048)
    """Robots of the first sweep, on 50 courses and all cores."""
    courses: tuple[int, ...] = (10, 50, 100, 200, 400)
    """Courses of the third sweep, with 256 robots; the second is 256 robots on 1 to all cores."""
    seconds: float = 5.0
    """Measured time of each point [s]."""
    json: bool = False
    """Print one JSON object."""


def point(robots: int, courses: int, threads: int, seconds: float) -> dict:
    """Measure one point: environment steps per second, start-up seconds, peak memory."""
    start = time.perf_counter()
    env = Go1Env(World(mixed_courses(courses)), robots, num_threads=threads)
    env.reset(0)
    ready = time.perf_counter()
    actions = (trot(robots, 10, EnvConfig().dt) - DEFAULT_DOF_POS) / EnvConfig().action_scale
    for action in actions:
        env.step(action)
    durations: list[float] = []
    while sum(durations) < seconds:
        begin = time.perf_counter()
        for action in actions:
            env.step(action)
        durations.append(time.perf_counter() - begin)
    return {
        "robots": robots,
        "courses": courses,
        "threads": threads,
        "steps_per_second": float(robots * len(actions) / np.median(durations)),
        "start_seconds": ready - start,
        "peak_memory_gb": peak_memory(),
    }


def main(config: Config) -> None:
    started, cores = machine(), available_cores()
    sweeps = {
        "robots": [(n, 50, cores) for n in config.robots],
        "threads": [(256, 50, n) for n in range(1, cores + 1)],
        "courses": [(256, n, cores) for n in config.courses],
    }
    figures = {
        name: [in_fresh_process(point, *where, config.seconds) for where in points] for name, points in sweeps.items()
    }
    tables = []
    for name, points in figures.items():
        first = points[0]["steps_per_second"]
        tables.append(
            [
                {
                    name: p[name],
                    "steps/s": f"{p['steps_per_second']:.0f}",
                    "over the first": f"{p['steps_per_second'] / first:.2f}",
                    "start [s]": f"{p['start_seconds']:.1f}",
                    "peak memory [GB]": f"{p['peak_memory_gb']:.2f}",
                }
                for p in points
            ]
        )
    ratios = {
        f"{name}_last_over_first": points[-1]["steps_per_second"] / points[0]["steps_per_second"]
        for name, points in figures.items()
    }
    report(config.json, started, {"config": asdict(config), **figures, **ratios}, *tables)


if __name__ == "__main__":
    start(main, Config)

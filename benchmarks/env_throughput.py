"""What the environment costs on top of its physics, and what terrain costs the physics.

    python benchmarks/env_throughput.py [--json]

``Go1Env.step`` is divided by the bare ``Batch.step`` that it contains: the same models,
states and controls, replayed right afterwards.  Physics loads are open-loop trots, the
same robots at the same places of every terrain.
"""

from dataclasses import asdict, dataclass

from agility_ref.env import EnvConfig, Go1Env
from agility_ref.go1 import DEFAULT_DOF_POS
from agility_ref.policy import Policy
from agility_ref.world import World

import numpy as np
from common import (
    Taped,
    Trotters,
    alternate,
    flat_course,
    machine,
    mixed_courses,
    models_of,
    plane_model,
    ratio,
    report,
    show,
    start,
    trot,
)


@dataclass(frozen=True)
class Config:
    """Environment and physics throughput."""

    robots: int = 256
    """Robots simulated side by side."""
    courses: int = 50
    """Courses, all kinds in turn."""
    rounds: int = 15
    """Rounds of the alternation; the median counts."""
    steps: int = 20
    """Steps per block."""
    weights: str = ""
    """Checkpoint of a policy that drives the environment; an open-loop trot by default."""
    json: bool = False
    """Print one JSON object."""


def environment_over_physics(config: Config) -> dict:
    """Compare Go1Env.step with the Batch.step inside it."""
    env = Taped(Go1Env(World(mixed_courses(config.courses)), config.robots))
    policy = Policy.load(config.weights) if config.weights else None
    targets = trot(config.robots, 10, EnvConfig().dt)  # 10 steps are one period of the trot
    actions = (targets - DEFAULT_DOF_POS) / EnvConfig().action_scale
    observation = env.reset(0)[0]
    clock = 0

    def with_environment() -> float:
        nonlocal observation, clock
        env.rewind()
        for _ in range(config.steps):
            action = policy(observation) if policy else actions[clock % len(actions)]
            observation, *_ = env.step(action)
            clock += 1
        return env.step_seconds

    # The replay needs the tape, so the order stays: not alternate(), the same idea.
    pairs = []
    for _ in range(config.rounds + 1):
        seconds = with_environment()
        pairs.append((seconds, env.replay()))
    with_env, bare = np.array(pairs[1:]).T
    steps = config.robots * config.steps
    return {
        "environment_steps_per_second": float(steps / np.median(with_env)),
        "bare_steps_per_second": float(steps / np.median(bare)),
        "environment_over_bare": ratio(bare, with_env),  # of speeds, hence bare time above
        "controls": config.weights or "open-loop trot",
    }


def terrain_costs(config: Config) -> dict:
    """Compare physics on different terrains, numbers of courses and threads."""
    mixed = mixed_courses(config.courses)
    five = ("walk", "climb", "gap", "beam", "climb-gap")  # divides 10 and 400
    few, many = mixed_courses(10, five), mixed_courses(400, five)
    rough = mixed_courses(config.courses, ("walk",))
    flat = [flat_course(course) for course in rough]

    def load(models: list, courses: list, num_threads: int = 0) -> Trotters:
        return Trotters(models, courses, config.robots, steps=config.steps, num_threads=num_threads)

    models = models_of(mixed)
    loads = {
        "courses": load(models, mixed),
        "plane": load([plane_model()] * len(mixed), [flat_course(course) for course in mixed]),
        "rough": load(models_of(rough), rough),
        "flat": load(models_of(flat), flat),
        "10 courses": load(models_of(few), few),
        "400 courses": load(models_of(many), many),
        "1 thread": load(models, mixed, 1),
        "2 threads": load(models, mixed, 2),
    }
    seconds = alternate(loads, config.rounds)
    return {
        "physics_steps_per_second": {name: loads[name].rate(seconds[name]) for name in loads},
        "courses_over_plane": ratio(seconds["courses"], seconds["plane"]),
        "rough_over_flat": ratio(seconds["rough"], seconds["flat"]),
        "courses_400_over_10": ratio(seconds["400 courses"], seconds["10 courses"]),
        "threads_2_over_1": ratio(seconds["1 thread"], seconds["2 threads"]),
    }


def main(config: Config) -> None:
    started = machine()
    figures = environment_over_physics(config) | terrain_costs(config)
    ratios = [
        {"figure": "Go1Env.step over bare Batch.step, speed", "ratio": show(figures["environment_over_bare"])},
        {"figure": "physics on courses over one plane, time", "ratio": show(figures["courses_over_plane"])},
        {"figure": "rough courses over flat ones, time", "ratio": show(figures["rough_over_flat"])},
        {"figure": "400 courses over 10, time", "ratio": show(figures["courses_400_over_10"])},
        {"figure": "two threads over one, speed", "ratio": show(figures["threads_2_over_1"])},
    ]
    rates = {
        "Go1Env.step, 40 ms": figures["environment_steps_per_second"],
        "bare Batch.step, 40 ms": figures["bare_steps_per_second"],
        **{f"physics on {name}, 20 ms": value for name, value in figures["physics_steps_per_second"].items()},
    }
    speeds = [{"steps/s": name, "median": f"{value:.0f}"} for name, value in rates.items()]
    report(config.json, started, {"config": asdict(config), **figures}, ratios, speeds)


if __name__ == "__main__":
    start(main, Config)

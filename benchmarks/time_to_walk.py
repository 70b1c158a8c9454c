"""How long a robot needs to learn to walk, from scratch.

    python benchmarks/time_to_walk.py [--seeds 0 1 2] [--json]

Trains what ``agility-ref train walk --preset quick`` trains until the deterministic policy
reaches 0.8 of the waypoints of the quick walk courses.  Evaluations are not on the clock.
"""

import time
from dataclasses import asdict, dataclass

import numpy as np
import tyro
from common import machine, report, walk_training

from agility_ref.checkpoint import Policy
from agility_ref.env import ACTION_DIM
from agility_ref.evaluate import EvaluationConfig, evaluate
from agility_ref.observation import OBS_DIM, SCANDOTS
from agility_ref.policies import PPOConfig
from agility_ref.ppo import Learner, train
from agility_ref.selector import Single


@dataclass(frozen=True)
class Config:
    """Steps and time until walking."""

    seeds: tuple[int, ...] = (0, 1, 2)
    """Training seeds, one after the other."""
    goal: float = 0.8
    """Waypoint fraction of the deterministic policy at which the clock stops."""
    every: int = 100_000
    """Environment steps between evaluations."""
    steps: int = 2_000_000
    """Environment steps after which a seed gives up."""
    episodes: int = 64
    """Complete episodes of an evaluation."""
    json: bool = False
    """Print one JSON object."""


def learn(seed: int, config: Config) -> dict:
    """Train one seed; return its curve and where it reached the goal (None if it did not)."""
    ppo = PPOConfig()
    env, _ = walk_training(seed, ppo.num_envs)
    learner = Learner.create(OBS_DIM, ACTION_DIM, ppo, seed, fixed=SCANDOTS)
    evaluation = EvaluationConfig(config.episodes, preset="quick")
    curve, seconds, next_evaluation = [], 0.0, config.every
    start = time.perf_counter()
    for record in train(env, learner, config.steps):
        if record["steps"] >= next_evaluation or record["steps"] >= config.steps:
            next_evaluation += config.every
            seconds += time.perf_counter() - start
            policy = Single("walk", Policy.from_arrays(learner.arrays(), {}))
            fraction = float(evaluate(policy, "walk", evaluation).waypoint_fraction.mean())
            curve.append({"steps": record["steps"], "seconds": seconds, "waypoint_fraction": fraction})
            if fraction >= config.goal:
                break
            start = time.perf_counter()
    last = curve[-1]
    reached = last["waypoint_fraction"] >= config.goal
    return {
        "seed": seed,
        "steps": last["steps"] if reached else None,
        "seconds": last["seconds"] if reached else None,
        "waypoint_fraction": last["waypoint_fraction"],
        "steps_per_second": last["steps"] / last["seconds"],
        "curve": curve,
    }


def main(config: Config) -> None:
    started = machine()
    runs = [learn(seed, config) for seed in config.seeds]
    figures = {"runs": runs, "reached": sum(run["steps"] is not None for run in runs)}
    if figures["reached"] == len(runs):
        figures |= {key: float(np.median([run[key] for run in runs])) for key in ("steps", "seconds")}
    rows = [
        {
            "seed": run["seed"],
            "steps": run["steps"] or f"not in {config.steps}",
            "wall [s]": f"{run['seconds']:.0f}" if run["seconds"] else "-",
            "waypoints": f"{run['waypoint_fraction']:.2f}",
            "steps/s": f"{run['steps_per_second']:.0f}",
        }
        for run in runs
    ]
    report(config.json, started, {"config": asdict(config), **figures}, rows)


if __name__ == "__main__":
    main(tyro.cli(Config))

"""How long a robot needs to learn to walk, from scratch: the quick case of ``time_to_skill.py``.

    python benchmarks/time_to_walk.py [--seeds 0 1 2] [--json]

Trains what ``agility-ref train walk --preset quick`` trains until the deterministic policy
reaches 0.8 of the waypoints of the quick walk courses.  Evaluations are not on the clock.
"""

from dataclasses import dataclass

import time_to_skill
from common import start


@dataclass(frozen=True)
class Config:
    """Steps and time until walking."""

    seeds: tuple[int, ...] = (0, 1, 2)
    """Training seeds, one after the other."""
    goal: float = 0.8
    """Waypoint fraction of the deterministic policy at which the clock stops."""
    every: int = 100_000
    """Environment steps between evaluations."""
    steps: int = 0
    """Environment steps after which a seed gives up; 0 for the policy's budget."""
    episodes: int = 64
    """Complete episodes of an evaluation."""
    json: bool = False
    """Print one JSON object."""


def main(config: Config) -> None:
    time_to_skill.main(
        time_to_skill.Config(
            "walk", "quick", config.seeds, (config.goal,), config.every, config.steps, config.episodes, "", config.json
        )
    )


if __name__ == "__main__":
    start(main, Config)

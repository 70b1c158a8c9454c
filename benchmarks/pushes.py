"""What pushes cost, and where they strike robots that then fall.

    python benchmarks/pushes.py [--policies leap climb-up] [--difficulties 0.5 1] [--json]

A push sets the horizontal velocity anew.  A robot on level ground can take a step or turn back; one in
the air, or with its front feet over a gap, goes where the new velocity takes it.  So every skill plays its
own courses twice, the same episodes with the same noise: without pushes and with them.
"""

from dataclasses import asdict, dataclass

from agility_ref.env import EnvConfig
from agility_ref.errors import UserError
from agility_ref.evaluate import (
    EvaluationConfig,
    evaluation_env,
    evaluation_world,
    in_first_episode,
    rollout,
    waypoint_fraction,
)
from agility_ref.selector import Single
from agility_ref.terrain import Obstacle
from agility_ref.training.bank import load_policy
from agility_ref.training.policies import find_policy
from agility_ref.training.runs import TrainConfig

import numpy as np
from common import machine, report, start
from learning import check_skill, tell

PLACES = ("in the air", "at an obstacle", "elsewhere")  # where a push strikes; the last two with a foot on the ground
REACH = 0.15  # [m] so far before an obstacle a robot's trunk is over it with its front feet


@dataclass(frozen=True)
class Config:
    """What pushes cost."""

    policies: tuple[str, ...] = ("climb-up", "climb", "leap", "beam")
    """Specialists."""
    difficulties: tuple[float, ...] = (0.5, 0.75, 1.0)
    """Difficulties of their courses, 0 to 1."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Training seeds."""
    episodes: int = 256
    """Complete episodes of each policy, seed and difficulty."""
    seed: int = 0
    """Seed of courses, starts, commands, noise and pushes."""
    aftermath: float = 1.5
    """A fall within this time after a push is put down to it [s]."""
    runs: str = ""
    """Folder of runs to look in before the shipped weights; runs/full by default."""
    json: bool = False
    """Print one JSON object."""


@dataclass(frozen=True)
class Play:
    """N episodes."""

    waypoints: np.ndarray
    """(N,) waypoint fraction."""
    falls: dict[str, tuple[int, int]]
    """Place -> pushes that struck there, and those that a fall followed."""


def play(policy: Single, course: str, evaluation: EvaluationConfig, push_interval: float, aftermath: float) -> Play:
    """Play the courses of an evaluation with a push every ``push_interval`` [s], 0 for none."""
    env = evaluation_env(course, evaluation, EnvConfig(push_interval=push_interval))

    def before(action: np.ndarray) -> dict[str, np.ndarray]:
        return {"pushed": env.push_timer == 1, "in_air": ~env.foot_contact.any(axis=1), "x": env.base_pos[:, 0]}

    r = rollout(policy, env, evaluation.seed, before=before)
    alive = in_first_episode(r["done"])
    followed = falls_soon(r["terminated"] & alive, round(aftermath / env.config.dt))
    at_obstacle = np.stack([near(x, c.obstacles) for x, c in zip(r["x"].T, env.world.courses, strict=True)], axis=1)
    where = np.where(r["in_air"], 0, np.where(at_obstacle, 1, 2))
    struck = [(where == k) & r["pushed"] & alive for k in range(len(PLACES))]
    counts = [(int(mark.sum()), int((mark & followed).sum())) for mark in struck]
    return Play(waypoint_fraction(r["waypoints"], alive), dict(zip(PLACES, counts, strict=True)))


def near(x: np.ndarray, obstacles: tuple[Obstacle, ...]) -> np.ndarray:
    """(T,) bool: a trunk at x (T,) is over an obstacle, or less than REACH before it."""
    return np.any([(o.x0 - REACH < x) & (x < o.x1) for o in obstacles], axis=0)


def falls_soon(fell: np.ndarray, steps: int) -> np.ndarray:
    """(T, N) bool: a fall of an episode, fell (T, N), comes in this step or within ``steps`` after it."""
    last = np.where(fell.any(axis=0), fell.argmax(axis=0), -1)
    ahead = last - np.arange(len(fell))[:, None]
    return (ahead >= 0) & (ahead <= steps)


def measure(config: Config) -> list[dict]:
    """Return one row per policy and difficulty, over all its seeds, JSON-ready."""
    rows = []
    for name in config.policies:
        (course,) = find_policy(name).courses
        policies = [load_policy(name, TrainConfig(seed=seed, out=config.runs)) for seed in config.seeds]
        for difficulty in config.difficulties:
            evaluation = EvaluationConfig(config.episodes, config.seed, difficulty=difficulty)
            tell(f"{name}, d = {difficulty}")
            calm, pushed = (
                [play(p, course, evaluation, interval, config.aftermath) for p in policies]
                for interval in (0.0, EnvConfig().push_interval)
            )
            falls = {place: np.sum([p.falls[place] for p in pushed], axis=0).tolist() for place in PLACES}
            rows.append(
                {
                    "policy": name,
                    "difficulty": difficulty,
                    "waypoints": {
                        kind: float(np.mean([p.waypoints for p in plays]))
                        for kind, plays in (("without pushes", calm), ("with pushes", pushed))
                    },
                    "pushes": {place: count for place, (count, _) in falls.items()},
                    "fell after": {place: after / max(count, 1) for place, (count, after) in falls.items()},
                }
            )
        evaluation_world.cache_clear()
    tell()
    return rows


def show(rows: list[dict]) -> list[dict]:
    """Format numbers for people."""
    return [
        {
            "policy": row["policy"],
            "d": f"{row['difficulty']:g}",
            **{kind: f"{value:.2f}" for kind, value in row["waypoints"].items()},
            **{f"pushes {p}": f"{n / max(sum(row['pushes'].values()), 1):.2f}" for p, n in row["pushes"].items()},
            **{f"fell after one {place}": f"{share:.2f}" for place, share in row["fell after"].items()},
        }
        for row in rows
    ]


def main(config: Config) -> None:
    for name in config.policies:
        check_skill(name)
        if len(find_policy(name).courses) > 1:
            raise UserError(f"{name} is no specialist: it has several kinds of course")
    for difficulty in config.difficulties:
        EvaluationConfig(config.episodes, config.seed, difficulty=difficulty)  # refuses what cannot be played
    started = machine()
    rows = measure(config)
    report(config.json, started, {"config": asdict(config), "rows": rows}, show(rows))


if __name__ == "__main__":
    start(main, Config)

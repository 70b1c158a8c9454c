"""What pushes cost, and how much of that no policy can help.

    python benchmarks/pushes.py [--policies leap climb-up] [--difficulties 0.5 1] [--json]

A push sets the horizontal velocity anew.  A robot that stands can take a step; one in the air
flies on at the new velocity, and over a gap lands where that takes it.  So every skill plays
its own courses three times, the same episodes with the same noise: without pushes, with
pushes that wait until a foot touches the ground, and with pushes as they come.  The loss from
the second to the third is the price of being struck in the air.
"""

from dataclasses import asdict, dataclass

from agility_ref.env import EnvConfig, Go1Env
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
from agility_ref.stats import paired_difference
from agility_ref.training.bank import load_policy
from agility_ref.training.policies import find_policy
from agility_ref.training.runs import TrainConfig

import numpy as np
from common import machine, report, start
from learning import check_skill, tell

PUSHES = {"none": 0.0, "on the ground": EnvConfig().push_interval, "anywhere": EnvConfig().push_interval}


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
    """N episodes under one kind of pushes."""

    waypoints: np.ndarray
    """(N,) waypoint fraction."""
    falls: dict[str, tuple[int, int]]
    """Where a push struck, in the air or on the ground -> pushes, and those that a fall followed."""


def wait_for_ground(env: Go1Env) -> None:
    """Put off by a step every push that would strike a robot in the air."""
    env.push_timer += (env.push_timer == 1) & ~env.foot_contact.any(axis=1)


def play(policy: Single, course: str, evaluation: EvaluationConfig, pushes: str, aftermath: float) -> Play:
    """Play the courses of an evaluation under one kind of pushes."""
    env = evaluation_env(course, evaluation, EnvConfig(push_interval=PUSHES[pushes]))

    def before(action: np.ndarray) -> dict[str, np.ndarray]:
        if pushes == "on the ground":
            wait_for_ground(env)
        return {"pushed": env.push_timer == 1, "in_air": ~env.foot_contact.any(axis=1)}

    r = rollout(policy, env, evaluation.seed, before=before)
    alive = in_first_episode(r["done"])
    followed = falls_soon(r["terminated"] & alive, round(aftermath / env.config.dt))
    struck = r["pushed"] & alive
    places = {"in the air": struck & r["in_air"], "on the ground": struck & ~r["in_air"]}
    falls = {place: (int(mark.sum()), int((mark & followed).sum())) for place, mark in places.items()}
    return Play(waypoint_fraction(r["waypoints"], alive), falls)


def falls_soon(fell: np.ndarray, steps: int) -> np.ndarray:
    """(T, N) bool: a fall of an episode, fell (T, N), comes in this step or within ``steps`` after it."""
    last = np.where(fell.any(axis=0), fell.argmax(axis=0), -1)
    ahead = last - np.arange(len(fell))[:, None]
    return (ahead >= 0) & (ahead <= steps)


def measure(config: Config) -> list[dict]:
    """Return one row a policy and difficulty, over all its seeds, JSON-ready."""
    rows = []
    for name in config.policies:
        (course,) = find_policy(name).courses
        policies = [load_policy(name, TrainConfig(seed=seed, out=config.runs)) for seed in config.seeds]
        for difficulty in config.difficulties:
            evaluation = EvaluationConfig(config.episodes, config.seed, difficulty=difficulty)
            tell(f"{name}, d = {difficulty}")
            played = {kind: [play(p, course, evaluation, kind, config.aftermath) for p in policies] for kind in PUSHES}
            scores = {kind: np.stack([p.waypoints for p in plays]) for kind, plays in played.items()}
            falls = {
                place: np.sum([p.falls[place] for p in played["anywhere"]], axis=0).tolist()
                for place in ("in the air", "on the ground")
            }
            rows.append(
                {
                    "policy": name,
                    "difficulty": difficulty,
                    "waypoints": {kind: float(values.mean()) for kind, values in scores.items()},
                    "price of the air": paired_difference(scores["anywhere"], scores["on the ground"]),
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
            **{f"pushes: {kind}": f"{value:.2f}" for kind, value in row["waypoints"].items()},
            "price of the air": "{:+.2f} [{:+.2f}, {:+.2f}]".format(*row["price of the air"]),
            "pushes in the air": f"{row['pushes']['in the air'] / max(sum(row['pushes'].values()), 1):.2f}",
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

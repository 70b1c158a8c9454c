"""Why the oracle falls on Climb+Gap: the same obstacles in other orders, and skills that see no deep pits.

    python benchmarks/climb_gap.py [--difficulty 0.5] [--json]

The oracle plays courses of six obstacles, up (u), down (d) and gap (g), noise and pushes off.
Then it plays those of Climb+Gap again, and the scandots of some of its skills are cut off: ground
that lies deeper under the trunk than so many metres, besides the 0.3 m at which it hangs, looks
as if it lay just so deep.  What then gets better was not a matter of legs.
"""

from dataclasses import asdict, dataclass, replace

import numpy as np
from common import machine, report, start
from learning import tell

from agility_ref.bank import TrainConfig, load_policy
from agility_ref.checkpoint import Policy
from agility_ref.env import Go1Env
from agility_ref.errors import UserError
from agility_ref.evaluate import in_first_episode, rollout, waypoint_fraction
from agility_ref.observation import SCANDOTS
from agility_ref.policies import find_policy
from agility_ref.selector import Hierarchy
from agility_ref.stats import bootstrap_interval, paired_difference
from agility_ref.task import EnvConfig
from agility_ref.terrain import islands
from agility_ref.world import World

CLIMB_GAP = "ugudgd"
LAYOUTS = ("uuuuuu", "uududd", "ududud", "gggggg", "udgudg", "gudgud", CLIMB_GAP)
DEPTHS = (0.6, 0.4, 0.2, 0.1)  # [m]
CUT_OFF = (("climb-up",), ("climb-down",), ("leap",), ("climb-up", "climb-down"))


@dataclass(frozen=True)
class Config:
    """Where the oracle falls on Climb+Gap, and why."""

    difficulty: float = 0.5
    """Difficulty of all courses, 0 to 1."""
    episodes: int = 128
    """Complete episodes of each layout, one a course."""
    seed: int = 0
    """Seed of the courses and starts."""
    train_seed: int = 0
    """Training seed of the weights."""
    runs: str = ""
    """Folder of runs to look in before the shipped weights; runs/full by default."""
    json: bool = False
    """Print one JSON object."""


@dataclass(frozen=True)
class ShortSighted:
    """A skill for which no ground lies deeper than ``depth``."""

    policy: Policy
    depth: float
    """Largest scandot that it sees [m]."""

    @property
    def name(self) -> str:
        """Name of the skill."""
        return self.policy.name

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Return the action (n, 12)."""
        seen = observation.copy()
        seen[:, SCANDOTS] = np.minimum(seen[:, SCANDOTS], self.depth)
        return self.policy(seen)


def cut_off(oracle: Hierarchy, names: tuple[str, ...], depth: float) -> Hierarchy:
    """Return the oracle with some of its skills short-sighted."""
    bank = zip(find_policy("oracle").skills, oracle.skills, strict=True)
    return replace(oracle, skills=tuple(ShortSighted(skill, depth) if name in names else skill for name, skill in bank))


def play(policy: Hierarchy, moves: str, config: Config) -> np.ndarray:
    """Play one episode a course; return the waypoint fractions (N,)."""
    courses = [
        islands("climb-gap", moves, config.difficulty, np.random.default_rng([config.seed, k]))
        for k in range(config.episodes)
    ]
    env = Go1Env(World(courses), len(courses), EnvConfig().clean(), lambda ids, fraction: ids, config.seed)
    r = rollout(policy, env, config.seed)
    return waypoint_fraction(r["waypoints"], in_first_episode(r["done"]))


def measure(oracle: Hierarchy, config: Config) -> tuple[list[dict], list[dict]]:
    """Play every layout, then every cut; return the rows of both tables."""
    scores = {}
    for moves in LAYOUTS:
        scores[moves] = play(oracle, moves, config)
        tell(f"{moves}: {scores[moves].mean():.2f}")
    layouts = [
        {"layout": moves, "waypoints": s.mean(), "interval": bootstrap_interval(s, np.mean)}
        for moves, s in scores.items()
    ]
    cuts = []
    for names in CUT_OFF:
        for depth in DEPTHS:
            s = play(cut_off(oracle, names, depth), CLIMB_GAP, config)
            gain, low, high = paired_difference(s, scores[CLIMB_GAP])
            cuts.append(
                {
                    "short-sighted": ", ".join(names),
                    "depth": depth,
                    "waypoints": s.mean(),
                    "gain": gain,
                    "interval": (low, high),
                }
            )
            tell(f"{', '.join(names)} cut off at {depth:g} m: {s.mean():.2f}")
    tell()
    return layouts, cuts


def show(rows: list[dict]) -> list[dict]:
    """Format numbers for people."""

    def text(value: object) -> str:
        if isinstance(value, tuple):
            return f"[{value[0]:.2f}, {value[1]:.2f}]"
        return f"{value:.2f}" if isinstance(value, float) else str(value)

    return [{key: text(value) for key, value in row.items()} for row in rows]


def main(config: Config) -> None:
    started = machine()
    if not 0.0 <= config.difficulty <= 1.0:
        raise UserError(f"difficulty must be between 0 and 1, not {config.difficulty}")
    if config.episodes < 1 or config.seed < 0:
        raise UserError(f"episodes start at 1 and seeds at 0, got {config.episodes} and {config.seed}")
    oracle = load_policy("oracle", TrainConfig(seed=config.train_seed, out=config.runs))
    layouts, cuts = measure(oracle, config)
    figures = {"config": asdict(config), "layouts": layouts, "short_sighted": cuts}
    report(config.json, started, figures, show(layouts), show(cuts))


if __name__ == "__main__":
    start(main, Config)

"""Where the oracle falls on Climb+Gap: the same obstacles in other orders, and skills with other bounds of sight.

    python benchmarks/climb_gap.py [--difficulty 0.5] [--json]

The oracle plays courses of six obstacles, up (u), down (d) and gap (g), noise and pushes off, with its
skills as they are, which see ground no higher or lower than their own courses show it
(`agility_ref/training/sight.py`), and with skills that see all there is.  On Climb+Gap some skills
alone are then given unbounded sight.  Last, an oracle over walk, climb and leap, whose `climb` reads
the ground at most so deep: what SIGHT_DEPTH was chosen by.
"""

from dataclasses import asdict, dataclass, replace

from agility_ref.env import EnvConfig, Go1Env
from agility_ref.evaluate import EvaluationConfig, in_first_episode, rollout, waypoint_fraction
from agility_ref.observation import OBS_DIM, SCANDOT_STD, SCANDOTS
from agility_ref.policy import CLIP
from agility_ref.selector import Hierarchy, oracle_hierarchy
from agility_ref.stats import paired_difference
from agility_ref.terrain import islands
from agility_ref.training.bank import load_bank, load_policy
from agility_ref.training.policies import find_policy
from agility_ref.training.runs import TrainConfig
from agility_ref.world import World

import numpy as np
from common import machine, report, start
from learning import tell

CLIMB_GAP = "ugudgd"
LAYOUTS = ("uuuuuu", "uududd", "ududud", "gggggg", "udgudg", "gudgud", CLIMB_GAP)
ALL = find_policy("oracle").skills
THREE = find_policy("ps-rl-3").skills
DEPTHS = (1.0, 0.65, 0.5, 0.35, 0.2)  # [m] below the feet; 1 is where scandots end
DEPTH_LAYOUTS = (CLIMB_GAP, "uugddd", "uududd")


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


def see(oracle: Hierarchy, skills: tuple[str, ...], names: tuple[str, ...], **bounds: np.ndarray) -> Hierarchy:
    """Return the oracle over ``skills``, of which those in ``names`` have other bounds of sight."""
    pairs = zip(skills, oracle.skills, strict=True)
    return replace(oracle, skills=tuple(replace(skill, **bounds) if name in names else skill for name, skill in pairs))


def unbounded(oracle: Hierarchy, names: tuple[str, ...]) -> Hierarchy:
    """Return the oracle with the sight of some of its skills as the scandots are."""
    end = np.full(OBS_DIM, CLIP, np.float32)
    return see(oracle, ALL, names, low=-end, high=end)


def shallow(oracle: Hierarchy, depth: float) -> Hierarchy:
    """Return the oracle over THREE with a ``climb`` that reads the ground at most ``depth`` [m] below its feet."""
    high = np.full(OBS_DIM, CLIP, np.float32)
    high[SCANDOTS] = depth / SCANDOT_STD
    return see(oracle, THREE, ("climb",), high=high)


def play(policy: Hierarchy, moves: str, config: Config) -> np.ndarray:
    """Play one episode a course; return the waypoint fractions (N,)."""
    courses = [
        islands("climb-gap", moves, config.difficulty, np.random.default_rng([config.seed, k]))
        for k in range(config.episodes)
    ]
    env = Go1Env(World(courses), len(courses), EnvConfig().clean(), lambda ids, fraction: ids, config.seed)
    r = rollout(policy, env, config.seed)
    return waypoint_fraction(r["waypoints"], in_first_episode(r["done"]))


def measure(weights: TrainConfig, config: Config) -> tuple[list[dict], list[dict], list[dict]]:
    """Play every layout, Climb+Gap with single skills unbounded, and depths of sight; return the rows of the tables."""
    oracle, layouts, bounded = load_policy("oracle", weights), [], {}
    for moves in LAYOUTS:
        bounded[moves], free = play(oracle, moves, config), play(unbounded(oracle, ALL), moves, config)
        layouts.append({"layout": moves, "all unbounded": free.mean(), **compare(bounded[moves], free)})
        tell(f"{moves}: {bounded[moves].mean():.2f}, unbounded {free.mean():.2f}")
    singles = []
    for name in ALL:
        free = play(unbounded(oracle, (name,)), CLIMB_GAP, config)
        singles.append({"unbounded": name, "waypoints": free.mean(), **compare(bounded[CLIMB_GAP], free)})
        tell(f"{name} unbounded: {free.mean():.2f}")
    three, depths = oracle_hierarchy("oracle", load_bank(THREE, weights)), []
    for depth in DEPTHS:
        row = {moves: play(shallow(three, depth), moves, config).mean() for moves in DEPTH_LAYOUTS}
        depths.append({"climb reads at most": depth} | row)
        tell(f"depth {depth}: {row[CLIMB_GAP]:.2f}")
    tell()
    return layouts, singles, depths


def compare(bounded: np.ndarray, free: np.ndarray) -> dict:
    """Waypoint fractions (N,) with the sight of all skills bounded, and what that gains on the same episodes."""
    gain, low, high = paired_difference(bounded, free)
    return {"bounded": bounded.mean(), "gain": gain, "interval": (low, high)}


def show(rows: list[dict]) -> list[dict]:
    """Format numbers for people."""

    def text(value: object) -> str:
        if isinstance(value, tuple):
            return f"[{value[0]:.2f}, {value[1]:.2f}]"
        return f"{value:.2f}" if isinstance(value, float) else str(value)

    return [{key: text(value) for key, value in row.items()} for row in rows]


def main(config: Config) -> None:
    started = machine()
    EvaluationConfig(config.episodes, config.seed, difficulty=config.difficulty)  # refuses what cannot be played
    layouts, singles, depths = measure(TrainConfig(seed=config.train_seed, out=config.runs), config)
    figures = {"config": asdict(config), "layouts": layouts, "singles": singles, "depths": depths}
    report(config.json, started, figures, show(layouts), show(singles), show(depths))


if __name__ == "__main__":
    start(main, Config)

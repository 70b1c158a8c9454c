"""Where the oracle should take a skill up before an obstacle, and how long keep it after.

    python benchmarks/oracle_regions.py [--preset quick] [--json]

``LEAD`` and ``TAIL`` of ``agility_ref/world.py`` are this table's choice.  For each skill
the oracle plays every lead and tail of a grid on training courses, the other skills as they
are; no course of an evaluation is among them.  Half of the courses choose, the other half
say what the choice is worth: a difference measured where it was picked would flatter it.
"""

from dataclasses import asdict, dataclass
from unittest.mock import patch

from agility_ref import world
from agility_ref.curriculum import CurriculumConfig, hardest, training_world
from agility_ref.env import Go1Env
from agility_ref.errors import unknown_name
from agility_ref.pictures import record
from agility_ref.selector import Hierarchy
from agility_ref.stats import paired_difference
from agility_ref.terrain import NUM_WAYPOINTS
from agility_ref.training.bank import load_policy
from agility_ref.training.runs import TrainConfig

import numpy as np
from common import machine, report, start

KINDS = {  # skill -> the courses that need it
    "climb-up": ("climb-up", "climb", "climb-gap"),
    "climb-down": ("climb-down", "climb", "climb-gap"),
    "leap": ("gap", "climb-gap"),
    "beam": ("beam",),
}


@dataclass(frozen=True)
class Config:
    """Leads and tails of the oracle's regions."""

    skills: tuple[str, ...] = tuple(KINDS)
    """Skills whose regions are chosen."""
    leads: tuple[float, ...] = (0.3, 0.5, 0.7, 0.9)
    """Distances before an obstacle that are tried [m], besides the present one."""
    tails: tuple[float, ...] = (0.15, 0.3, 0.45, 0.6)
    """Distances after it that are tried [m], besides the present one."""
    preset: str = "full"
    """quick (d up to 0.4) or full (d up to 1); also names the weights."""
    seed: int = 0
    """Training seed of the courses and of the weights."""
    runs: str = ""
    """Folder of runs to look in before the shipped weights; runs/<preset> by default."""
    levels: int = 10
    """Levels of difficulty of each kind; those below d = 0 are left out."""
    variants: int = 8
    """Courses a kind and level; even, for half of them choose."""
    json: bool = False
    """Print one JSON object."""


def courses_for(skill: str, config: Config) -> world.World:
    """Build the training courses that need a skill."""
    layout = CurriculumConfig(num_levels=config.levels, variants=config.variants)
    top = hardest(config.preset)
    built = training_world(KINDS[skill], layout, top, config.seed)
    return world.World([course for course in built.courses if course.difficulty >= 0])


def play_region(oracle: Hierarchy, courses: world.World, skill: str, lead: float, tail: float, seed: int) -> np.ndarray:
    """Play one episode a course with the skill's region moved; return the waypoint fractions (N,)."""
    with patch.dict(world.LEAD, {skill: lead}), patch.dict(world.TAIL, {skill: tail}):
        courses.regions = np.stack([world.region_map(course) for course in courses.courses])
    env = Go1Env(courses, len(courses), next_course=lambda ids, fraction: ids, seed=seed)
    return np.array([episode.reached for episode in record.play(oracle, env, skill, seed)]) / NUM_WAYPOINTS


def choose(oracle: Hierarchy, skill: str, config: Config) -> dict:
    """Play the grid of one skill; return its figures."""
    courses = courses_for(skill, config)
    present = world.LEAD[skill], world.TAIL[skill]
    leads, tails = (sorted({*tried, now}) for tried, now in zip((config.leads, config.tails), present, strict=True))
    scores = {
        (lead, tail): play_region(oracle, courses, skill, lead, tail, config.seed) for lead in leads for tail in tails
    }
    chooses, judges = np.s_[::2], np.s_[1::2]
    best = max(scores, key=lambda region: scores[region][chooses].mean())
    mean, low, high = paired_difference(scores[best][judges], scores[present][judges])
    return {
        "skill": skill,
        "courses": len(courses),
        "leads": leads,
        "tails": tails,
        "waypoint_fraction": [[float(scores[lead, tail].mean()) for tail in tails] for lead in leads],
        "present": present,
        "best": best,
        "best_minus_present": {"mean": mean, "low": low, "high": high},
        "chosen": best if low > 0 else present,
    }


def main(config: Config) -> None:
    for skill in config.skills:
        if skill not in KINDS:
            raise unknown_name("skill", skill, KINDS)
    started = machine()
    oracle = load_policy("oracle", TrainConfig(preset=config.preset, seed=config.seed, out=config.runs))
    found = [choose(oracle, skill, config) for skill in config.skills]
    grids = [
        [
            {f"{f['skill']}: lead [m]": lead}
            | {f"tail {tail:g} m": f"{value:.3f}" for tail, value in zip(f["tails"], row, strict=True)}
            for lead, row in zip(f["leads"], f["waypoint_fraction"], strict=True)
        ]
        for f in found
    ]
    summary = [
        {
            "skill": f["skill"],
            "courses": f["courses"],
            **{name: "{:g} + {:g}".format(*f[name]) for name in ("present", "best")},
            "best - present": "{mean:+.3f} [{low:+.3f}, {high:+.3f}]".format(**f["best_minus_present"]),
            "chosen": "{:g} + {:g}".format(*f["chosen"]),
        }
        for f in found
    ]
    report(config.json, started, {"config": asdict(config), "skills": found}, *grids, summary)


if __name__ == "__main__":
    start(main, Config)

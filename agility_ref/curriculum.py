"""Curriculum: which course a robot is put on when its episode ends.

Paper section 4.2: "Curriculum is crucial for the robot to learn anything."  The rule is
the game-like one of Extreme Parkour with the waypoint fraction as the score: up a level
after a good episode, two after a completed course, down after a bad one.

A :class:`Preset` names the hardest course of a run, in training and in evaluation.

In:  the waypoint fraction of the episodes that ended.
Out: the index of each robot's next course in the :class:`~agility_ref.world.World`.
"""

from dataclasses import dataclass

import numpy as np

from agility_ref.errors import unknown_name
from agility_ref.files import pack_stream, unpack_stream
from agility_ref.terrain import EASIEST, make_course
from agility_ref.world import World


@dataclass(frozen=True)
class Preset:
    """A scale at which the whole table can be trained."""

    name: str
    max_difficulty: float
    """Hardest difficulty in training, and the top of the range in evaluation."""


PRESETS = {"quick": Preset("quick", 0.4), "full": Preset("full", 1.0)}


def find_preset(name: str) -> Preset:
    """Look a preset up.

    Raises
    ------
    UserError : no such preset
    """
    if name not in PRESETS:
        raise unknown_name("preset", name, PRESETS)
    return PRESETS[name]


@dataclass(frozen=True)
class CurriculumConfig:
    """How levels are laid out and when a robot moves between them."""

    num_levels: int = 10
    """Levels between the easiest and the hardest course; usual 5 to 20."""
    variants: int = 4
    """Courses per kind and level, drawn with different seeds; usual 2 to 10."""
    promote: float = 0.75
    """Waypoint fraction at or above which a robot moves up; usual 0.6 to 0.9."""
    demote: float = 0.4
    """Waypoint fraction below which a robot moves down; usual 0.2 to 0.5."""
    easy_share: float = 0.25
    """Share of resets to a level drawn at or below the robot's own, against forgetting; 0 to 0.5."""
    top_easy_share: float = 0.5
    """The same, in addition, for robots at the top, where the easy levels are furthest away; 0 to 0.8."""
    enabled: bool = True
    """False draws every level uniformly, the ablation of section 4.2."""


def level_difficulties(kind: str, max_difficulty: float, num_levels: int) -> np.ndarray:
    """Difficulty of every level of a kind, shape (num_levels,)."""
    return np.linspace(EASIEST[kind], max_difficulty, num_levels)


def training_world(kinds: tuple[str, ...], config: CurriculumConfig, max_difficulty: float, seed: int) -> World:
    """Build the courses, ordered by kind, then level, then variant."""
    courses = [
        make_course(kind, d, np.random.default_rng([seed, k, level, variant]))
        for k, kind in enumerate(kinds)
        for level, d in enumerate(level_difficulties(kind, max_difficulty, config.num_levels))
        for variant in range(config.variants)
    ]
    return World(courses)


class Curriculum:
    """Levels of N robots; a robot stays on one kind, and on one variant of every level, for life.

    Kinds and variants are dealt out in blocks: neighbouring robots then share courses, and
    physics that stays in the processor's cache is a tenth faster.  With fewer robots than kinds
    some kinds have none.

    ``level`` is what a robot has earned, ``played`` what its episode is on: now and then an
    easier one, which is not scored.
    """

    def __init__(self, num_kinds: int, num_envs: int, config: CurriculumConfig, seed: int):
        self.config = config
        block = np.arange(num_envs) * num_kinds * config.variants // num_envs
        self.kind, self.variant = block // config.variants, block % config.variants
        self.level = np.zeros(num_envs, int)
        self.played = np.zeros(num_envs, int)
        self.rng = np.random.default_rng(seed)

    def next_course(self, ids: np.ndarray, waypoint_fraction: np.ndarray | None) -> np.ndarray:
        """Update the levels of robots ``ids`` and return their next courses.

        Parameters
        ----------
        ids : (n,) robots whose episode ended
        waypoint_fraction : (n,) of that episode; None at the very start

        Returns
        -------
        (n,) indices into the training world
        """
        c, rng, top = self.config, self.rng, self.config.num_levels - 1
        if waypoint_fraction is not None:
            scored = self.played[ids] == self.level[ids]
            # A completed course counts twice: an episode takes 100,000 steps of 256 robots, and
            # small budgets have few of them.
            step = (waypoint_fraction >= c.promote).astype(int) + (waypoint_fraction >= 1.0)
            step -= waypoint_fraction < c.demote
            self.level[ids] = np.clip(self.level[ids] + step * scored, 0, top)
        level = self.level[ids]
        easier = rng.integers(0, level + 1)
        replay = rng.random(len(ids)) < c.easy_share
        replay |= (level == top) & (rng.random(len(ids)) < c.top_easy_share)
        self.played[ids] = np.where(replay, easier, level)
        if not c.enabled:
            self.level[ids] = self.played[ids] = rng.integers(0, c.num_levels, len(ids))
        return (self.kind[ids] * c.num_levels + self.played[ids]) * c.variants + self.variant[ids]

    def mean_level(self) -> float:
        """Mean level over robots, as a fraction of the top level."""
        return float(self.level.mean() / max(self.config.num_levels - 1, 1))

    def mean_levels(self) -> np.ndarray:
        """Mean level of the robots of each kind, as fractions of the top level, (K,)."""
        totals = np.bincount(self.kind, weights=self.level) / max(self.config.num_levels - 1, 1)
        return totals / np.bincount(self.kind)

    def state(self) -> dict[str, np.ndarray]:
        """Return what a resumed run needs."""
        return {"level": self.level.copy(), "played": self.played.copy(), "rng": pack_stream(self.rng)}

    def load_state(self, state: dict[str, np.ndarray]) -> None:
        """Go on from :meth:`state`."""
        self.level[:], self.played[:] = (np.clip(state[k], 0, self.config.num_levels - 1) for k in ("level", "played"))
        unpack_stream(self.rng, state["rng"])

"""Curriculum: which course a robot is put on when its episode ends.

Paper section 4.2: "Curriculum is crucial for the robot to learn anything."  As in Extreme
Parkour, robots move up to harder courses where they do well and down where they do not.  What
differs: there each robot has a level of its own, here all robots on a kind of course share one,
which a hundred times as many episodes measure.

In:  the waypoint fraction of the episodes that ended.
Out: the index of each robot's next course in the :class:`~agility_ref.world.World`.
"""

from dataclasses import dataclass

from agility_ref.errors import MANY, require_at_least, unknown_name
from agility_ref.terrain import EASIEST, make_course
from agility_ref.world import World

import numpy as np

PRESETS = {"quick": 0.4, "full": 1.0}  # scales of the whole table: the hardest difficulty, in training and evaluation


def hardest(preset: str) -> float:
    """Return the hardest difficulty of a preset; a UserError says that there is no such preset."""
    if preset not in PRESETS:
        raise unknown_name("preset", preset, PRESETS)
    return PRESETS[preset]


@dataclass(frozen=True)
class CurriculumConfig:
    """How levels are laid out and when a kind of course moves between them."""

    num_levels: int = 10  # levels between the easiest and the hardest course; usual 5 to 20
    variants: int = 4  # courses per kind and level, drawn with different seeds; usual 2 to 10
    promote: float = 0.75  # score at which a kind moves up; usual 0.6 to 0.9
    demote: float = 0.25  # score below which a kind moves down; usual 0.1 to 0.4
    first_score: float = 0.4  # score that a new frontier starts with, between the two
    score_step: float = 0.04  # share by which one episode moves the score; usual 0.02 to 0.1
    easy_share: float = 0.3  # share of episodes at or below the frontier, against forgetting; 0 to 0.5
    top_easy_share: float = 0.625  # the same once the frontier is the top; 0 to 0.8
    kind_floor: float = 0.1  # weight of a kind in the draw: this + 1 - its score; above 0, inf: evenly
    enabled: bool = True  # False draws kinds and levels uniformly, the ablation of section 4.2

    def __post_init__(self):
        require_at_least(1, MANY, num_levels=self.num_levels, variants=self.variants)
        require_at_least(1e-3, kind_floor=min(self.kind_floor, 1.0))  # all that is left at a score of 1; may be inf


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
    """One frontier level per kind of course, shared by all robots.

    Every episode played on the frontier moves the score of its kind towards its waypoint
    fraction, and the score moves the frontier.  Kinds with a low score are played more often.

    A robot keeps its variant for life, dealt out in blocks: neighbouring robots then share courses,
    and physics that stays in the processor's cache is a tenth faster.
    """

    def __init__(self, num_kinds: int, num_envs: int, config: CurriculumConfig, seed: int):
        self.config = config
        self.frontier = np.zeros(num_kinds, int)
        self.score = np.full(num_kinds, config.first_score)
        self.variant = np.arange(num_envs) * config.variants // num_envs
        self.kind, self.level = np.zeros(num_envs, int), np.zeros(num_envs, int)  # of the episode that a robot plays
        self.rng = np.random.default_rng(seed)

    def next_course(self, ids: np.ndarray, waypoint_fraction: np.ndarray | None) -> np.ndarray:
        """Score the episodes of robots ``ids`` and return their next courses.

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
            for robot, fraction in zip(ids, waypoint_fraction, strict=True):
                self._score(self.kind[robot], self.level[robot], fraction)
        # w_k = floor + (1 - score_k): where robots fail on the frontier is drawn more often
        evenly = np.isinf(c.kind_floor) or not c.enabled
        weight = np.ones(len(self.score)) if evenly else c.kind_floor + 1.0 - self.score
        self.kind[ids] = rng.choice(len(weight), len(ids), p=weight / weight.sum())
        frontier = self.frontier[self.kind[ids]]
        easier = rng.integers(0, frontier + 1)
        replay = rng.random(len(ids)) < np.where(frontier == top, c.top_easy_share, c.easy_share)
        self.level[ids] = np.where(replay, easier, frontier)
        if not c.enabled:
            self.level[ids] = rng.integers(0, c.num_levels, len(ids))
        return (self.kind[ids] * c.num_levels + self.level[ids]) * c.variants + self.variant[ids]

    def _score(self, kind: int, level: int, fraction: float) -> None:
        """Move the score of a kind by one episode, and its frontier where that is due."""
        c = self.config
        if level != self.frontier[kind]:
            return
        self.score[kind] += c.score_step * (fraction - self.score[kind])
        step = int(self.score[kind] >= c.promote) - int(self.score[kind] < c.demote)
        moved = np.clip(level + step, 0, c.num_levels - 1)
        if moved != level:
            self.frontier[kind], self.score[kind] = moved, c.first_score

    def levels(self) -> np.ndarray:
        """Frontier of each kind as a fraction of the top level, (K,)."""
        return self.frontier / max(self.config.num_levels - 1, 1)

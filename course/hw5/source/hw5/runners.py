"""Runners: points with a heading that see what a robot would see.  Complete; nothing to do here.

A runner moves along a course of ``agility_ref`` and sees the 132 scandots.  With the skill that the oracle names it
runs straight; with another it stumbles: it slows down, turns away and sags, and sees the course from there.
"""

from agility_ref.observation import scandots
from agility_ref.terrain import CELL, make_course
from agility_ref.world import World

import numpy as np

KINDS = ("climb-gap", "beam", "climb")
END = 9.0  # [m]


class Runners:
    """N runners on random courses.

    Attributes
    ----------
    regions : (C, nx) int8, the oracle's skill at every cell of every course, an index into ``agility_ref.terrain.SKILLS``
    course, x : (N,) on which course and where [m] each runner is
    """

    cell = CELL

    def __init__(self, n: int, seed: int, courses: int = 9):
        self.n, self.rng = n, np.random.default_rng(seed)
        self.world = World([make_course(KINDS[k % 3], self.rng.uniform(0.2, 0.9), self.rng) for k in range(courses)])
        self.regions = self.world.regions
        self.course, self.x = np.zeros(n, int), np.zeros(n)
        self.y, self.sag, self.yaw = np.zeros(n), np.zeros(n), np.zeros(n)
        self._start(np.ones(n, bool))

    def _start(self, who: np.ndarray) -> None:
        count = who.sum()
        self.course[who] = self.rng.integers(0, len(self.world), count)
        self.x[who] = self.rng.uniform(1.0, 2.0, count)
        self.y[who] = self.sag[who] = self.yaw[who] = 0.0

    def observe(self) -> np.ndarray:
        """Return the scandots (N, 132) of this moment."""
        height = self.world.support[self.course, self.world.column(self.x)] + 0.3 - self.sag
        noise = 0.02 * self.rng.standard_normal((self.n, 1))
        return scandots(self.world, self.course, np.column_stack([self.x, self.y, height]), self.yaw) + noise

    def step(self, right: np.ndarray) -> None:
        """Move on; ``right`` (N,) bool says who runs with the oracle's skill."""
        kick = self.rng.standard_normal((3, self.n)) * np.where(right, (0.02,), (0.12,))
        self.yaw = 0.8 * self.yaw + kick[0]
        self.y = np.clip(0.8 * self.y + kick[1], -0.6, 0.6)
        self.sag = np.clip(0.8 * self.sag + 0.5 * np.abs(kick[2]), 0.0, 0.3)
        self.x = self.x + np.where(right, 0.08, 0.03)
        self._start(self.x > END)

"""Traces: every control step of a selector's episodes, as arrays to measure.

In:  a :class:`~agility_ref.selector.Hierarchy` and the robots of an evaluation.
Out: a :class:`Trace`; arrays are (T, N) for T control steps of N episodes.
"""

from dataclasses import dataclass

import numpy as np

from agility_ref.env import Go1Env
from agility_ref.evaluate import in_first_episode, rollout, waypoint_fraction
from agility_ref.selector import Hierarchy
from agility_ref.terrain import Course


@dataclass(frozen=True)
class Trace:
    """Every control step of N episodes, as the robots were when they decided."""

    policy: str
    environment: str
    skills: tuple[str, ...]
    """What the policy chooses from."""
    dt: float
    """Control time step [s]."""
    courses: list[Course]
    """That of each episode."""
    skill: np.ndarray
    """(T, N) skill chosen, -1 after the end."""
    oracle: np.ndarray
    """(T, N) skill among ``skills`` that the oracle wanted, likewise."""
    position: np.ndarray
    """(T, N, 3) of the trunk [m]."""
    velocity: np.ndarray
    """(T, N, 3) of the trunk, along the axes of the world [m/s]."""
    waypoint_fraction: np.ndarray
    """(N,)"""

    @property
    def wrong(self) -> np.ndarray:
        """(T, N) bool, the choice was not the oracle's."""
        return self.skill != self.oracle

    def spans(self, skill: str) -> np.ndarray:
        """(N, K, 2) first and last x [m] of the obstacles that need ``skill``, NaN where a course has fewer."""
        found = [[(o.x0, o.x1) for o in course.obstacles if o.skill == skill] for course in self.courses]
        spans = np.full((len(found), max(map(len, found)), 2), np.nan)
        for row, own in zip(spans, found, strict=True):
            row[: len(own)] = np.reshape(own, (-1, 2))
        return spans


def play(policy: Hierarchy, env: Go1Env, environment: str, seed: int) -> Trace:
    """Play one complete episode of every robot of ``env`` with the deterministic policy."""
    qpos, qvel = env.simulation.qpos, env.simulation.qvel

    def before(action: np.ndarray) -> dict[str, np.ndarray]:
        return {"position": qpos[:, :3].copy(), "velocity": qvel[:, :3].copy(), "course": env.course.copy()}

    r = rollout(policy, env, seed, before=before)
    alive = in_first_episode(r["done"])
    return Trace(
        policy=policy.name,
        environment=environment,
        skills=tuple(skill.name for skill in policy.skills),
        dt=env.config.dt,
        courses=[env.world.courses[k] for k in r["course"][0]],
        skill=np.where(alive, r["skill"], -1),
        oracle=np.where(alive, r["oracle"], -1),
        position=r["position"],
        velocity=r["velocity"],
        waypoint_fraction=waypoint_fraction(r["waypoints"], alive),
    )

"""Traces: every control step of a selector's episodes, as arrays to measure.

In:  a :class:`~agility_ref.selector.Hierarchy` and the robots of an evaluation.
Out: a :class:`Trace`; arrays are (T, N) for T control steps of N episodes.
"""

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from agility_ref.env import Go1Env
from agility_ref.selector import Hierarchy
from agility_ref.terrain import NUM_WAYPOINTS, Course


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
    observation, _ = env.reset(seed)
    policy.reset()
    qpos, qvel = env.batch.bind("qpos"), env.batch.bind("qvel")
    courses = [env.world.courses[k] for k in env.course]
    running, waypoints = np.ones(env.num_envs, bool), np.zeros(env.num_envs)
    rows: dict[str, list[np.ndarray]] = defaultdict(list)
    while running.any():
        rows["position"].append(qpos[:, :3].copy())
        rows["velocity"].append(qvel[:, :3].copy())
        rows["oracle"].append(np.where(running, policy.labels[env.oracle_skill()], -1))
        action, skill = policy.act(observation, env)
        rows["skill"].append(np.where(running, skill, -1))
        observation, _, terminated, truncated, info = env.step(action)
        waypoints[running] = info["episode"]["waypoints"][running]
        running &= ~(terminated | truncated)
    return Trace(
        policy=policy.name,
        environment=environment,
        skills=tuple(skill.name for skill in policy.skills),
        dt=env.config.dt,
        courses=courses,
        waypoint_fraction=waypoints / NUM_WAYPOINTS,
        **{name: np.stack(values) for name, values in rows.items()},
    )

"""Evaluation: the four metrics of Table 1, each defined once.

Paper section 4 and Table 1: reward, episode length, waypoint fraction, edge violation.
Every policy plays the same courses from the same starts with the same commands, noise and
pushes, one **complete** episode a course; the paper's evaluator counts what happens to end
within 1500 steps.

In:  a policy (:class:`~agility_ref.selector.Single` or ``Hierarchy``) and an environment.
Out: :class:`Evaluation`, one number per episode and metric.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from agility_ref.env import EnvConfig, Go1Env
from agility_ref.errors import UserError, unknown_name
from agility_ref.policies import find_preset
from agility_ref.selector import Hierarchy, Single
from agility_ref.terrain import COURSE_KINDS, NUM_WAYPOINTS, make_course
from agility_ref.world import World

METRICS = ("reward", "episode_length", "waypoint_fraction", "edge_violation")


@dataclass(frozen=True)
class EvaluationConfig:
    """What is played, and how often."""

    episodes: int = 64
    """Complete episodes, one a course; usual 64 to 256."""
    seed: int = 0
    """Seed of courses, starts, commands, noise and pushes."""
    preset: str = "full"
    """quick draws d ~ U(0, 0.4), full U(0, 1)."""
    difficulty: float | None = None
    """Fixes the difficulty of all courses, 0 to 1."""
    clean: bool = False
    """Turn noise, pushes, payload and friction differences off."""


# The four metrics.  alive[t, n] says that episode n had not ended before step t.


def reward_metric(reward: np.ndarray, alive: np.ndarray) -> np.ndarray:
    """Sum of the reward over the episode: (T, N) -> (N,)."""
    return (reward * alive).sum(axis=0)


def episode_length(alive: np.ndarray) -> np.ndarray:
    """Control steps of the episode: (T, N) -> (N,)."""
    return alive.sum(axis=0)


def waypoint_fraction(waypoints: np.ndarray, alive: np.ndarray) -> np.ndarray:
    """Waypoints reached by the end of the episode / 8: (T, N) -> (N,)."""
    return (waypoints * alive).max(axis=0) / NUM_WAYPOINTS


def edge_violation(feet_on_edge: np.ndarray, alive: np.ndarray) -> np.ndarray:
    """Feet on an edge, mean over the episode's steps: (T, N) -> (N,)."""
    return (feet_on_edge * alive).sum(axis=0) / alive.sum(axis=0)


@dataclass(frozen=True)
class Evaluation:
    """One policy on one environment; arrays have one entry an episode."""

    policy: str
    environment: str
    config: EvaluationConfig
    reward: np.ndarray
    episode_length: np.ndarray
    waypoint_fraction: np.ndarray
    edge_violation: np.ndarray
    fell: np.ndarray
    """(N,) bool, terminated rather than truncated."""
    difficulty: np.ndarray
    """(N,) difficulty of the course."""
    skill: np.ndarray | None
    """(T, N) skill chosen, -1 after the end; None for a policy without skills."""
    oracle: np.ndarray | None
    """(T, N) skill the oracle wanted, likewise."""

    def summary(self) -> dict:
        """Return mean and standard deviation of each metric, JSON-ready."""
        metrics = {
            name: {"mean": float(getattr(self, name).mean()), "std": float(getattr(self, name).std())}
            for name in METRICS
        }
        return {
            "policy": self.policy,
            "environment": self.environment,
            "preset": self.config.preset,
            "seed": self.config.seed,
            "episodes": len(self.reward),
            "environment_steps": int(self.episode_length.sum()),
            "falls": float(self.fell.mean()),
            **metrics,
        }


@lru_cache(maxsize=4)
def evaluation_world(environment: str, config: EvaluationConfig) -> World:
    """Build the courses of an evaluation; the same for every policy.

    Raises
    ------
    UserError : unknown environment or preset, difficulty outside [0, 1], no episodes
    """
    if environment not in COURSE_KINDS:
        raise unknown_name("environment", environment, COURSE_KINDS)
    if config.episodes < 1:
        raise UserError(f"episodes must be at least 1, not {config.episodes}")
    if config.difficulty is not None and not 0.0 <= config.difficulty <= 1.0:
        raise UserError(f"difficulty must be between 0 and 1, not {config.difficulty}")
    highest = find_preset(config.preset).max_difficulty
    kind = COURSE_KINDS.index(environment)
    courses = []
    for episode in range(config.episodes):
        rng = np.random.default_rng([config.seed, 77, kind, episode])  # no training world uses these
        d = rng.uniform(0.0, highest)
        courses.append(make_course(environment, d if config.difficulty is None else config.difficulty, rng))
    return World(courses)


def evaluation_env(environment: str, config: EvaluationConfig, env_config: EnvConfig = EnvConfig()) -> Go1Env:
    """Build one robot a course; robot i plays course i."""
    world = evaluation_world(environment, config)
    if config.clean:
        env_config = env_config.clean()
    return Go1Env(world, len(world), env_config, lambda ids, fraction: ids, seed=config.seed)


def evaluate(
    policy: Single | Hierarchy,
    environment: str,
    config: EvaluationConfig = EvaluationConfig(),
    env_config: EnvConfig = EnvConfig(),
) -> Evaluation:
    """Play one complete episode on every course with the deterministic policy."""
    env = evaluation_env(environment, config, env_config)
    observation, _ = env.reset(config.seed)
    policy.reset()
    n = env.num_envs
    running, fell = np.ones(n, bool), np.zeros(n, bool)
    records: dict[str, list[np.ndarray]] = {k: [] for k in ("reward", "waypoints", "edge", "alive", "skill", "oracle")}
    while running.any():
        if isinstance(policy, Hierarchy):
            records["oracle"].append(np.where(running, policy.labels[env.oracle_skill()], -1))
        action, skill = policy.act(observation, env)
        if skill is not None:
            records["skill"].append(np.where(running, skill, -1))
        observation, reward, terminated, truncated, info = env.step(action)
        records["alive"].append(running.copy())
        records["reward"].append(reward)
        records["waypoints"].append(info["episode"]["waypoints"])
        records["edge"].append(info["feet_on_edge"])
        fell |= running & terminated
        running &= ~(terminated | truncated)
    r = {name: np.array(values) for name, values in records.items() if values}
    return Evaluation(
        policy=policy.name,
        environment=environment,
        config=replace(config, episodes=n),
        reward=reward_metric(r["reward"], r["alive"]),
        episode_length=episode_length(r["alive"]),
        waypoint_fraction=waypoint_fraction(r["waypoints"], r["alive"]),
        edge_violation=edge_violation(r["edge"], r["alive"]),
        fell=fell,
        difficulty=env.world.difficulties,
        skill=r.get("skill"),
        oracle=r.get("oracle"),
    )

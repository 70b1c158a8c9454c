"""Evaluation: the four metrics of Table 1, each defined once.

Paper section 4 and Table 1: reward, episode length, waypoint fraction, edge violation.
Two protocols:

complete      Every policy plays the same courses from the same starts with the same commands,
              noise and pushes, one **complete** episode per course.  Policies are compared
              episode by episode.
as-published  Counts as the evaluator of Extreme Parkour does, on which the paper stands; see
              :mod:`agility_ref.results.published` for what of it is reproduced and what is not.

In:  a policy (:class:`~agility_ref.selector.Single` or ``Hierarchy``) and an environment.
Out: :class:`Evaluation`, one number per episode and metric.
"""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

from agility_ref.curriculum import hardest
from agility_ref.env import EnvConfig, Go1Env
from agility_ref.errors import MANY, MAX_SEED, UserError, require_at_least, unknown_name
from agility_ref.selector import Hierarchy, Single
from agility_ref.terrain import COURSE_KINDS, NUM_WAYPOINTS, Course, make_course
from agility_ref.world import World

import numpy as np
from tqdm import tqdm

METRICS = ("reward", "episode_length", "waypoint_fraction", "edge_violation")
PROTOCOLS = ("complete", "as-published")
EVALUATION_STREAM = 77  # in the seed of an evaluation course, and of no training course
GOLDEN_SHARE = (5**0.5 - 1) / 2  # steps of this share of a circle fill it most evenly


@dataclass(frozen=True)
class EvaluationConfig:
    """What is played, and how often."""

    episodes: int = 64  # complete episodes, one per course; usual 64 to 256; as published: robots, 256 in the original
    seed: int = 0  # seed of courses, starts, commands, noise and pushes
    preset: str = "full"  # quick draws d ~ U(0, 0.4), full U(0, 1)
    difficulty: float | None = None  # fixes the difficulty of all courses, 0 to 1
    clean: bool = False  # turn noise, pushes, payload and friction differences off
    protocol: str = "complete"  # complete: whole episodes, paired; as-published: counts as the original evaluator does

    def __post_init__(self):
        if self.protocol not in PROTOCOLS:
            raise unknown_name("protocol", self.protocol, PROTOCOLS)
        require_at_least(0, MAX_SEED, seed=self.seed)
        require_at_least(1, MANY, episodes=self.episodes)
        if self.difficulty is not None and not 0.0 <= self.difficulty <= 1.0:
            raise UserError(f"difficulty must be between 0 and 1, not {self.difficulty}")


def in_first_episode(done: np.ndarray) -> np.ndarray:
    """Which steps belong to each robot's first episode: (T, N) -> (T, N) bool."""
    return np.cumsum(done, axis=0) - done == 0


# The four metrics.  alive[t, n] says that episode n had not ended before step t.


def reward_metric(reward: np.ndarray, alive: np.ndarray) -> np.ndarray:
    """Sum of the reward over the episode: (T, N) -> (N,)."""
    return (reward * alive).sum(axis=0)


def episode_length(alive: np.ndarray, action_repeat: int) -> np.ndarray:
    """Length of the episode in control steps, ``action_repeat`` to a step: (T, N) -> (N,)."""
    return alive.sum(axis=0) * action_repeat


def waypoint_fraction(waypoints: np.ndarray, alive: np.ndarray) -> np.ndarray:
    """Waypoints reached by the end of the episode / 8: (T, N) -> (N,)."""
    return (waypoints * alive).max(axis=0) / NUM_WAYPOINTS


def edge_violation(feet_on_edge: np.ndarray, alive: np.ndarray) -> np.ndarray:
    """Feet on an edge, mean over the episode's steps: (T, N) -> (N,)."""
    return (feet_on_edge * alive).sum(axis=0) / alive.sum(axis=0)


@dataclass(frozen=True)
class Evaluation:
    """One policy on one environment; arrays have one entry per episode.

    Under ``as-published`` the episodes are those that ended in time, in the order of their
    ends, and ``edge_violation`` has one entry per robot and step instead.
    """

    policy: str
    environment: str
    config: EvaluationConfig
    reward: np.ndarray
    episode_length: np.ndarray
    waypoint_fraction: np.ndarray
    edge_violation: np.ndarray
    fell: np.ndarray  # (N,) bool, terminated rather than truncated
    difficulty: np.ndarray  # (N,) difficulty of the course
    skill: np.ndarray | None  # (T, N) skill chosen, -1 after the end; None for a policy without skills and as published
    oracle: np.ndarray | None  # (T, N) skill the oracle wanted, likewise
    dt: float = EnvConfig().dt  # time between two actions [s]


@lru_cache(maxsize=1)  # 2 MB per course, and a table goes through one terrain after another
def evaluation_world(environment: str, config: EvaluationConfig) -> World:
    """Build the terrain of an evaluation; see :func:`evaluation_courses`.

    As published, edges are those across the lane alone, as in the original.
    """
    return World(evaluation_courses(environment, config), "x" if config.protocol == "as-published" else "xy")


def evaluation_courses(environment: str, config: EvaluationConfig) -> list[Course]:
    """Draw the courses of an evaluation; the same for every policy.

    Each difficulty is uniform, but together they are spread evenly (a Kronecker sequence), however many there are::

        d_k = frac(d_0 + k (sqrt 5 - 1) / 2),   d_0 ~ U(0, 1)

    Independent draws would make one evaluation easier than another for all policies at once.

    Raises
    ------
    UserError : unknown environment or preset
    """
    if environment not in COURSE_KINDS:
        raise unknown_name("environment", environment, COURSE_KINDS)
    highest, kind = hardest(config.preset), COURSE_KINDS.index(environment)
    courses, first = [], 0.0
    for episode in range(config.episodes):
        rng = np.random.default_rng([config.seed, EVALUATION_STREAM, kind, episode])
        drawn = rng.random()  # of every course, so that its layout does not depend on how d is chosen
        first = first if episode else drawn
        d = highest * ((first + episode * GOLDEN_SHARE) % 1.0)
        courses.append(make_course(environment, d if config.difficulty is None else config.difficulty, rng))
    return courses


def evaluation_env(environment: str, config: EvaluationConfig, env_config: EnvConfig = EnvConfig()) -> Go1Env:
    """Build one robot a course; robot i plays course i."""
    world = evaluation_world(environment, config)
    env_config = env_config.clean() if config.clean else env_config
    return Go1Env(world, len(world), env_config, lambda ids, fraction: ids, seed=config.seed)


def evaluate(
    policy: Single | Hierarchy, environment: str, config: EvaluationConfig = EvaluationConfig(),
    env_config: EnvConfig = EnvConfig(),
) -> Evaluation:  # fmt: skip
    """Play the deterministic policy on every course, one complete episode each, and measure it.

    Raises
    ------
    UserError : as :func:`evaluation_courses`
    ValueError : another protocol; :func:`agility_ref.results.published.evaluate_by_protocol` has both
    """
    if config.protocol != "complete":
        raise ValueError(f"evaluate plays complete episodes, not {config.protocol}")
    env = evaluation_env(environment, config, env_config)
    r = rollout(policy, env, config.seed)
    alive = in_first_episode(r["done"])
    skill, oracle = (np.where(alive, r[k], -1) if k in r else None for k in ("skill", "oracle"))
    return Evaluation(
        policy.name, environment, config,
        reward=reward_metric(r["reward"], alive), episode_length=episode_length(alive, env.config.action_repeat),
        waypoint_fraction=waypoint_fraction(r["waypoints"], alive), edge_violation=edge_violation(r["edge"], alive),
        fell=(r["terminated"] & alive).any(axis=0), difficulty=env.world.difficulties,
        skill=skill, oracle=oracle, dt=env.config.dt,
    )  # fmt: skip


def rollout(
    policy: Single | Hierarchy, env: Go1Env, seed: int,
    enough: Callable[[list[np.ndarray]], bool] = lambda done: np.any(done, axis=0).all(),
    before: Callable[[np.ndarray], dict[str, np.ndarray]] = lambda action: {},
    after: Callable[[dict], dict[str, np.ndarray]] = lambda info: {},
) -> dict[str, np.ndarray]:  # fmt: skip
    """Step until ``enough`` of the list of ``done`` arrays (N,) is true; return (T, N, ...) arrays.

    By default every robot ends an episode; those that do begin another one at once.  ``waypoints`` is the count after the
    step, before the reset; ``skill`` and ``oracle`` are there for hierarchies only; whatever
    ``before`` (given the action) and ``after`` (given the info) return is kept of each step too.
    """
    observation, _ = env.reset(seed)
    r: dict[str, list[np.ndarray]] = defaultdict(list)
    bar = tqdm(total=env.max_steps, desc=policy.name, unit="step", leave=False, delay=3, disable=None)
    while not r["done"] or not enough(r["done"]):
        if isinstance(policy, Hierarchy):
            r["oracle"].append(policy.labels[env.oracle_skill()])
        action, skill = policy.act(observation, env)
        if skill is not None:
            r["skill"].append(skill.copy())
        seen = before(action)
        observation, reward, terminated, truncated, info = env.step(action)
        for name, values in (seen | after(info)).items():
            r[name].append(values)
        r["reward"].append(reward)
        r["waypoints"].append(info["totals"]["waypoints"])
        r["edge"].append(info["feet_on_edge"])
        r["terminated"].append(terminated)
        r["done"].append(terminated | truncated)
        bar.update()
    bar.close()
    return {name: np.array(values) for name, values in r.items()}

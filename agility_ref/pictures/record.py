"""Recordings: play episodes and keep what there is to see.

Every picture, film, clip and diagnosis is made from these arrays, so it shows what was simulated
and nothing else.  The live views simulate for themselves.

In:  a policy, an environment and which of its evaluation courses to play.
Out: one :class:`Episode` per robot, trimmed to its length.
"""

from dataclasses import dataclass, replace

from agility_ref.env import EnvConfig, Go1Env
from agility_ref.errors import UserError
from agility_ref.evaluate import EvaluationConfig, evaluation_courses, in_first_episode, rollout
from agility_ref.go1 import BODY_TOUCH, DEFAULT_DOF_POS
from agility_ref.rewards import TERMS
from agility_ref.selector import Hierarchy, Single
from agility_ref.terrain import NUM_WAYPOINTS, Course
from agility_ref.world import World

import numpy as np

# State arrays of the same name: the simulation's, and what the environment keeps track of.
SIMULATED = ("qpos", "qvel", "foot_pos", "torque")
FOLLOWED = ("foot_contact", "foot_on_edge", "waypoint_index")


@dataclass(frozen=True)
class Episode:
    """One robot's episode of T steps.

    Row t of every state array is the state **before** step t; row t of ``target``
    and of ``reward_terms`` is what step t was asked to do and what it earned.
    """

    policy: str
    environment: str
    course: Course
    dt: float  # Control time step [s].
    command: float  # Commanded speed [m/s].
    fell: bool  # The episode ended by a fall.
    reached: int  # Waypoints reached by the end, 0 to 8.
    qpos: np.ndarray  # (T, 19) trunk position [m], quaternion wxyz, 12 joint angles [rad].
    qvel: np.ndarray
    """(T, 18) trunk velocity along the axes of the world [m/s], angular velocity, 12 joint velocities [rad/s]."""
    foot_pos: np.ndarray
    """(T, 4, 3) centres of the feet FR, FL, RR, RL [m]; zero in row 0, where nothing has been simulated yet."""
    foot_contact: np.ndarray  # (T, 4) bool, the foot touches the terrain.
    foot_on_edge: np.ndarray  # (T, 4) bool, the foot violates an edge.
    body_contact: np.ndarray  # (T, 9) bool, trunk, thighs and calves that touch the terrain.
    torque: np.ndarray  # (T, 12) at the end of the step before [N m]; zero in row 0.
    target: np.ndarray  # (T, 12) joint angles asked for [rad].
    waypoint_index: np.ndarray  # (T,) waypoints reached so far.
    heading_error: np.ndarray  # (T,) angle from the heading to the current waypoint [rad].
    reward_terms: dict[str, np.ndarray]  # name -> (T,) weighted term; they sum to the reward of the step.
    skills: tuple[str, ...] = ()  # Names of the skills that a hierarchy chooses from; empty for a single policy.
    skill: np.ndarray | None = None  # (T,) index of the chosen skill; None for a single policy.
    wanted: np.ndarray | None = None  # (T,) index of the skill that the oracle names at that place; likewise.

    def __len__(self) -> int:
        return len(self.qpos)

    @property
    def time(self) -> np.ndarray:
        """(T,) [s]"""
        return np.arange(len(self)) * self.dt

    @property
    def wrong(self) -> np.ndarray:
        """(T,) bool, the choice was not the oracle's."""
        return self.skill != self.wanted

    def spans(self, skill: str) -> np.ndarray:
        """(K, 2) first and last x [m] of the obstacles that need ``skill``."""
        return np.reshape([(o.x0, o.x1) for o in self.course.obstacles if o.skill == skill], (-1, 2))

    @property
    def reward(self) -> np.ndarray:
        """(T,) reward of every step, the sum of its terms."""
        return np.sum(list(self.reward_terms.values()), axis=0)

    def skill_name(self, t: int) -> str:
        """Name of the skill that acts at step t; the policy's own for a single policy."""
        return self.policy if self.skill is None else self.skills[self.skill[t]]

    def summary(self) -> str:
        """One line for a title."""
        ending = "fell" if self.fell else "finished" if self.reached == NUM_WAYPOINTS else "out of time"
        return (
            f"{self.policy} on {self.environment}, d = {self.course.difficulty:.2f}: "
            f"{self.reached} of {NUM_WAYPOINTS} waypoints, {ending} after {len(self) * self.dt:.1f} s"
        )


def record(
    policy: Single | Hierarchy,
    environment: str,
    config: EvaluationConfig = EvaluationConfig(),
    courses: tuple[int, ...] = (0,),
    robots: int = 1,
    env_config: EnvConfig = EnvConfig(),
) -> list[Episode]:
    """Play evaluation courses to the end with the deterministic policy.

    Parameters
    ----------
    policy : what acts
    environment : a course kind
    config : seed, preset, difficulty and noise as in an evaluation; its number of episodes
        is not used
    courses : which courses of that evaluation, counted from 0
    robots : robots per course, from different starts
    env_config : the task

    Returns
    -------
    len(courses) * robots episodes, those of one course side by side

    Raises
    ------
    UserError : as in an evaluation, or a negative course number
    """
    if min(courses) < 0:
        raise UserError(f"courses are counted from 0, got {min(courses)}")
    drawn = evaluation_courses(environment, replace(config, episodes=max(courses) + 1))
    world = World([drawn[k] for k in courses])
    if config.clean:
        env_config = env_config.clean()
    n = len(world) * robots
    env = Go1Env(world, n, env_config, lambda ids, fraction: ids // robots, seed=config.seed)
    return play(policy, env, environment, config.seed)


def play(policy: Single | Hierarchy, env: Go1Env, environment: str, seed: int) -> list[Episode]:
    """Play one episode of every robot of ``env``; every robot stays on its course."""
    simulation, c = env.simulation, env.config
    touching = simulation.columns(BODY_TOUCH)

    def before(action: np.ndarray) -> dict[str, np.ndarray]:
        row = {name: getattr(simulation, name).copy() for name in SIMULATED}
        row |= {name: getattr(env, name).copy() for name in (*FOLLOWED, "command", "course")}
        row["body_contact"] = simulation.sensors[:, touching] > 0
        row["heading_error"] = env.heading_error[:, 0].copy()
        row["target"] = DEFAULT_DOF_POS + c.action_scale * np.clip(np.float64(action), -c.action_limit, c.action_limit)
        return row

    r = rollout(policy, env, seed, before=before, after=lambda info: info["reward_terms"])
    alive = in_first_episode(r["done"])
    length, fell = alive.sum(axis=0), (r["terminated"] & alive).any(axis=0)
    reached = (r["waypoints"] * alive).max(axis=0)
    states = (*SIMULATED, *FOLLOWED, "body_contact", "heading_error", "target")
    choices = {"skill": r.get("skill"), "wanted": r.get("oracle")}
    return [
        Episode(
            policy=policy.name,
            environment=environment,
            course=env.world.courses[r["course"][0, i]],
            dt=c.dt,
            command=float(r["command"][0, i]),
            fell=bool(fell[i]),
            reached=int(reached[i]),
            skills=tuple(s.name for s in policy.skills) if isinstance(policy, Hierarchy) else (),
            reward_terms={name: r[name][: length[i], i] for name in TERMS},
            **{name: r[name][: length[i], i] for name in states},
            **{name: None if values is None else values[: length[i], i] for name, values in choices.items()},
        )
        for i in range(env.num_envs)
    ]


def side_by_side(episodes: list[Episode], name: str, nothing: float = 0) -> np.ndarray:
    """Return one array of every episode, (T, N, ...), filled up with ``nothing`` after the end of each."""
    arrays = [getattr(episode, name) for episode in episodes]
    padded = np.full((max(map(len, arrays)), len(arrays), *arrays[0].shape[1:]), nothing, arrays[0].dtype)
    for n, array in enumerate(arrays):
        padded[: len(array), n] = array
    return padded

"""As published: the four metrics as the evaluator of Extreme Parkour counts them.

The protocol ``as-published`` of :mod:`agility_ref.evaluate`; ``complete`` is what we use ourselves.

In:  a policy and an environment, or every step of a run of fixed length, arrays (T, N).
Out: the four metrics, one number an ended episode.
"""

from agility_ref.env import EnvConfig
from agility_ref.evaluate import METRICS, Evaluation, EvaluationConfig, evaluate, evaluation_env, rollout
from agility_ref.selector import Hierarchy, Single

import numpy as np

PUBLISHED_EPISODES = 1.5  # length of an as-published run, in longest episodes: 1500 control steps
PUBLISHED_MEMORY = 1000  # the latest values of each metric that the original keeps
PUBLISHED_WAYPOINTS = 7.0  # the original divides by 7 where a course has 8 waypoints


def as_published(
    reward: np.ndarray, waypoints: np.ndarray, feet_on_edge: np.ndarray, done: np.ndarray
) -> dict[str, np.ndarray]:
    """Measure a run of fixed length as the original evaluator does.

    The paper's table was probably counted this way: it prints 0.14 +- 0.00 for policies that pass
    one waypoint, which is 1/7 and not 1/8, and nearly every violation's deviation exceeds its mean.

    Reproduced:

    * the run takes 1500 control steps, 1.5 times the longest episode, and counts what **ends**
      in it: a robot that falls early counts several times, one that survives once, and what
      is under way at the end not at all;
    * waypoints are those passed **before** the last step of the episode, divided by 7: all
      eight and the first seven both give 1;
    * edge violation is the number of feet on an edge of each robot in each step, of which
      the memory of 1000 values keeps the **last steps of the run** alone (with 256 robots
      the last four), whatever episode they belong to;
    * edges are those across the lane alone (:func:`agility_ref.evaluate.evaluation_world`);
    * of more than 1000 ended episodes the last 1000 count;
    * the standard deviations of :func:`mean_std`.

    Not reproduced, because it lies in the task and not in the counting:

    * reward weights, and the clipping of the reward at zero; there the edge term counts on a fifth of the
      courses alone;
    * from a robot's second episode on, the original allows 1001 steps; here 1000;
    * on ``gap`` the original's waypoints stand before each gap, ours behind it;
    * observation noise, payloads up to 2 kg and friction of 0.6 to 1.2, where the original's evaluator
      has no noise, no payload and friction of 0.6 to 2;
    * an action every 20 ms, where ours come every 40 ms, so that 1000 values reach twice as far back;
    * commanded speeds of 0.3 to 0.8 m/s, motors of differing strength, pushes of all robots in
      the same step, 25 courses shared by 256 robots, all terrains pooled in one number.

    Parameters
    ----------
    reward, feet_on_edge : (T, N) of each step
    waypoints : (T, N) count after the step, before a reset
    done : (T, N) bool, the episode ends with this step

    Returns
    -------
    the four metrics, (E,) for the E ended episodes, but edge_violation (min(T N, 1000),); episode_length is in steps; and
    ``ends`` (E, 2), step and robot of each end, in order
    """
    ends = np.argwhere(done)  # by step, then by robot, as the original extends its lists
    first = np.zeros(done.shape[1], int)  # step in which the robot's current episode began
    sums, lengths, passed = [], [], []
    for t, n in ends:
        sums.append(reward[first[n] : t + 1, n].sum())
        lengths.append(t + 1 - first[n])
        passed.append(waypoints[t - 1, n] if t > first[n] else 0)
        first[n] = t + 1
    kept = slice(-PUBLISHED_MEMORY, None)
    return {
        "reward": np.array(sums[kept], float),
        "episode_length": np.array(lengths[kept], int),
        "waypoint_fraction": np.array(passed[kept]) / PUBLISHED_WAYPOINTS,
        "edge_violation": feet_on_edge.ravel()[kept],
        "ends": ends[kept],
    }


def evaluate_by_protocol(
    policy: Single | Hierarchy,
    environment: str,
    config: EvaluationConfig = EvaluationConfig(),
    env_config: EnvConfig = EnvConfig(),
) -> Evaluation:
    """Play the deterministic policy on every course and measure it by the protocol of ``config``."""
    if config.protocol == "complete":
        return evaluate(policy, environment, config, env_config)
    env = evaluation_env(environment, config, env_config)
    steps = round(PUBLISHED_EPISODES * env.max_steps)
    r = rollout(policy, env, config.seed, lambda done: len(done) >= steps)
    measured = as_published(r["reward"], r["waypoints"], r["edge"], r["done"])
    measured["episode_length"] *= env.config.action_repeat
    step, robot = measured.pop("ends").T
    return Evaluation(
        policy.name, environment, config, **measured,
        fell=r["terminated"][step, robot], difficulty=env.world.difficulties[robot], skill=None, oracle=None, dt=env.config.dt,
    )  # fmt: skip


def summary(played: Evaluation) -> dict:
    """Return mean and standard deviation of each metric, JSON-ready."""
    metrics = {}
    for name in METRICS:
        mean, std = mean_std(getattr(played, name), name, played.config.protocol)
        metrics[name] = {"mean": mean, "std": None if np.isnan(std) else std}  # one episode has none
    return {
        "policy": played.policy,
        "environment": played.environment,
        "preset": played.config.preset,
        "protocol": played.config.protocol,
        "seed": played.config.seed,
        "episodes": len(played.reward),
        "control_steps": int(played.episode_length.sum()),
        "falls": float(played.fell.mean()),
        **metrics,
    }


def mean_std(values: np.ndarray, metric: str, protocol: str) -> tuple[float, float]:
    """Mean and standard deviation as the protocol prints them.

    The original divides the squares of reward and episode length by n - 1, those of
    waypoints and edges by n; ``complete`` divides all by n.
    """
    ddof = int(protocol == "as-published" and metric in ("reward", "episode_length"))
    std = float(values.std(ddof=ddof)) if len(values) > ddof else float("nan")
    return float(values.mean()), std

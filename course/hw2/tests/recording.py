"""Record a short piece of two episodes of Go1Env, with the reward terms that it gave."""

from functools import cache
from pathlib import Path

import agility_ref
from agility_ref.env import EnvConfig, Go1Env
from agility_ref.go1 import FOOT_RADIUS, FOOT_TOUCH, FOOT_VELOCITY
from agility_ref.policy import Policy
from agility_ref.terrain import make_course
from agility_ref.world import World

import numpy as np
from adapters import Log

STEPS = 50  # of either episode: a log of 100 steps
OTHER_FEET = [1, 0, 3, 2]  # agility_ref: FR FL RR RL
WALK = sorted(Path(agility_ref.__file__).parent.glob("weights/walk-full-*.npz"))[0]


@cache
def record(seed: int) -> tuple[Log, dict[str, np.ndarray]]:
    """Let the shipped walk policy walk, noisily; return the log and every term (100, N), unweighted."""
    rng = np.random.default_rng(seed)
    world = World([make_course("walk", 0.4, rng), make_course("climb", 0.2, rng)])
    env = Go1Env(world, 8, EnvConfig(push_interval=0.5), lambda ids, _: ids % 2, seed=seed % 1000)
    policy, weights = Policy.load(WALK), vars(env.config.rewards)
    rows, terms, stands = [], [], np.ones(8, bool)
    for episode in range(2):
        observation, _ = env.reset(seed % 1000 + episode)
        for step in range(STEPS):
            action = policy(observation) + 0.4 * rng.standard_normal((8, 12))
            observation, _, terminated, truncated, info = env.step(action)
            stands &= ~(terminated | truncated)  # a robot that ended has begun anew
            rows.append(_row(env, np.clip(action, -env.config.action_limit, env.config.action_limit), step == 0))
            terms.append({k: v / (weights[k] * env.config.dt) for k, v in info["reward_terms"].items() if weights[k]})
    log = {name: np.stack([row[name] for row in rows])[:, stands] for name in rows[0]}
    return Log(**log), {name: np.stack([term[name] for term in terms])[:, stands] for name in terms[0]}


def _row(env: Go1Env, action: np.ndarray, first: bool) -> dict[str, np.ndarray]:
    simulation = env.simulation
    feet = simulation.foot_pos[:, OTHER_FEET]
    clearance = feet[:, :, 2] - FOOT_RADIUS - env.world.ground(env.course[:, None], feet)
    force = -simulation.sensors[:, simulation.columns(FOOT_TOUCH)].reshape(-1, 4, 4)[:, OTHER_FEET, 1:]
    velocity = simulation.sensors[:, simulation.columns(FOOT_VELOCITY)].reshape(-1, 4, 3)[:, OTHER_FEET]
    return {
        "position": env.base_pos,
        "quaternion": simulation.qpos[:, [4, 5, 6, 3]].copy(),
        "velocity": simulation.qvel[:, :3].copy(),
        "waypoint": env.base_pos[:, :2] + env.goal,
        "command": env.command.copy(),
        "level": env.world.kinds[env.course] == "walk",
        "action": action,
        "start": np.full(env.num_envs, first),
        "foot_force": force,
        "foot_velocity": velocity,
        "foot_clearance": clearance,
    }

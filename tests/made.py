"""Policies made by hand, for tests that need one and not what it does."""

from agility_ref.env import ACTION_DIM
from agility_ref.observation import ACTION_MIRROR, NUM_SCANDOTS, OBS_DIM, OBS_MIRROR, SCANDOT_MIRROR, SCANDOTS, Mirror
from agility_ref.ppo import Learner, PPOConfig
from agility_ref.training.state import learner_state, policy_arrays

import numpy as np


def random_arrays(seed=0, obs_dim=OBS_DIM, act_dim=ACTION_DIM, gain=1.0):
    """Weights of an untrained network; gain > 1 makes it move more than a beginner's."""
    fixed = SCANDOTS if obs_dim == OBS_DIM else slice(0, 0)
    flipped = Mirror(np.arange(obs_dim), np.where(np.arange(obs_dim) < 1, -1, 1).astype(np.float32))
    obs_mirror = {OBS_DIM: OBS_MIRROR, NUM_SCANDOTS: SCANDOT_MIRROR}.get(obs_dim, flipped)
    act_mirror = ACTION_MIRROR if act_dim == ACTION_DIM else Mirror.identity(act_dim)
    learner = Learner.create(obs_mirror, act_mirror, PPOConfig(hidden=(16,)), seed, fixed=fixed)
    for layer in learner.net.actor.last:
        layer.weight.data *= gain
    return policy_arrays(learner) | learner_state(learner)

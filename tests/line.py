"""A task that is learned in a second, for the tests of PPO: points on a line that want to be followed."""

from agility_ref.observation import Mirror
from agility_ref.ppo import Learner, PPOConfig, train

import numpy as np

TINY = PPOConfig(num_envs=8, num_steps=16, hidden=(16,), update_epochs=2, num_minibatches=2)

# The line's mirror image: x changes its sign, age does not; two actions swap and change theirs, two choices swap.
LINE = Mirror(np.array([0, 1]), np.array([-1, 1], np.float32))
ACTIONS = Mirror(np.array([1, 0]), np.array([-1, -1], np.float32))
CHOICES = Mirror(np.array([1, 0]), np.array([1, 1], np.float32))


class FakeEnv:
    """Points on a line that earn -(a - x)^2, the mean of two actions; the best action is what is observed.

    ``limit`` steps truncate an episode; a point that starts at abs(x) > 0.95 ends terminated
    after one step.  The API is that of Go1Env, SAME_STEP autoreset included.
    """

    def __init__(self, num_envs=8, limit=5):
        self.num_envs, self.limit = num_envs, limit

    def _start(self, ids):
        self.x[ids] = self.rng.uniform(-1, 1, len(ids))
        self.age[ids] = 0
        self.total[ids] = 0.0

    def _observe(self):
        return np.stack([self.x, self.age / self.limit], axis=1, dtype=np.float32)

    def reset(self, seed=None):
        self.rng = np.random.default_rng(seed)
        self.x, self.total = np.zeros(self.num_envs), np.zeros(self.num_envs)
        self.age = np.zeros(self.num_envs, int)
        self._start(np.arange(self.num_envs))
        return self._observe(), {}

    def step(self, action):
        reward = -((np.asarray(action, float) - self.x[:, None]) ** 2).mean(axis=1)
        terminated = np.abs(self.x) > 0.95
        self.age += 1
        self.total += reward
        truncated = ~terminated & (self.age >= self.limit)
        info = {
            "final_obs": self._observe(),
            "totals": {"reward": self.total.copy(), "length": self.age.copy()},
            "kind": np.arange(self.num_envs) % 3,
        }
        self._start(np.flatnonzero(terminated | truncated))
        return self._observe(), reward, terminated, truncated, info


def make(seed=0, config=TINY):
    return Learner.create(LINE, ACTIONS, config, seed)


def trained(iterations, seed=0, config=TINY):
    learner = make(seed, config)
    records = list(train(FakeEnv(config.num_envs), learner, iterations * config.batch_size))
    return learner, records

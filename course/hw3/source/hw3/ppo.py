"""Proximal policy optimisation in five pieces.

Arrays of a rollout are **(N, T): one row per robot**, one column per step.
"""

from dataclasses import dataclass

from hw3.network import Policy

import numpy as np
import torch

RUNNING, TERMINATED, TRUNCATED = 0, 1, 2
"""How a step ended an episode: not at all; by a fall; by the time limit or the end of the course."""


@dataclass(frozen=True)
class Config:
    """Numbers of the update."""

    gamma: float = 0.99
    lam: float = 0.95
    clip: float = 0.2
    epochs: int = 4
    minibatches: int = 4
    entropy: float = 0.002
    max_grad_norm: float = 1.0
    target_kl: float = 0.02
    lowest_rate: float = 1e-4
    highest_rate: float = 3e-3


def gae(
    rewards: np.ndarray, values: np.ndarray, final_values: np.ndarray, ends: np.ndarray, gamma: float, lam: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return advantages and targets of the value function, both (N, T).

    What follows a step: after RUNNING, the next state with its value; after TERMINATED, nothing, so that nothing
    more is earned; after TRUNCATED, the state in which the episode was cut off, whose value is in
    ``final_values``.  Neither advantage crosses the end of an episode.

    Parameters
    ----------
    rewards : (N, T)
    values : (N, T + 1) value of the state before every step, and of the one after the last step.  After the end of an
        episode that is the first state of the next one
    final_values : (N, T) value of the true last state of an episode where it was TRUNCATED, **NaN elsewhere**
    ends : (N, T) RUNNING, TERMINATED or TRUNCATED
    """
    ### BEGIN SOLUTION
    following = np.select([ends == RUNNING, ends == TRUNCATED], [values[:, 1:], final_values], 0.0)
    # delta_t = r_t + gamma V(what follows) - V(s_t);  A_t = delta_t + gamma lam A_{t+1} within an episode
    delta = rewards + gamma * following - values[:, :-1]
    advantages = np.zeros(delta.shape)
    ahead = np.zeros(len(delta))
    for t in reversed(range(delta.shape[1])):
        ahead = delta[:, t] + gamma * lam * (ends[:, t] == RUNNING) * ahead
        advantages[:, t] = ahead
    return advantages, advantages + values[:, :-1]
    ### END SOLUTION


def surrogate(new: torch.Tensor, old: torch.Tensor, advantage: torch.Tensor, clip: float) -> torch.Tensor:
    """Clipped objective, **to be maximised**; a scalar, the mean over samples.

    Parameters
    ----------
    new, old : (n,) log probabilities of the actions under the policy that learns and the one that acted
    advantage : (n,)
    clip : how far the ratio may move from 1 before its gradient stops
    """
    ### BEGIN SOLUTION
    ratio = torch.exp(new - old)
    return torch.min(ratio * advantage, ratio.clamp(1 - clip, 1 + clip) * advantage).mean()
    ### END SOLUTION


def next_rate(rate: float, kl: float, config: Config) -> float:
    """Return the next step size: a **fifth more** where KL is below half of its target, a fifth less above twice of it.

    Less means divided by 1.2.  It stays between the lowest and the highest rate.
    """
    ### BEGIN SOLUTION
    if kl > 2 * config.target_kl:
        rate /= 1.2
    elif kl < config.target_kl / 2:
        rate *= 1.2
    return min(max(rate, config.lowest_rate), config.highest_rate)
    ### END SOLUTION


class Normaliser:
    """Running mean and variance of every number of an observation.

    Attributes
    ----------
    count : observations so far
    mean, variance : (size,) of all of them, as if they had been kept; 0 and 1 before the first
    """

    def __init__(self, size: int):
        self.count = 0
        self.mean, self.variance = np.zeros(size), np.ones(size)

    def update(self, batch: np.ndarray) -> None:
        """Take note of observations (n, size).

        Exact to seven digits for numbers like 1e4 + noise in float32 too.
        """
        ### BEGIN SOLUTION
        batch = np.asarray(batch, np.float64)
        n, mean, variance = len(batch), batch.mean(axis=0), batch.var(axis=0)
        total, delta = self.count + n, mean - self.mean
        # M2 = M2_a + M2_b + delta^2 n_a n_b / (n_a + n_b), Chan et al. 1979
        m2 = self.variance * self.count + variance * n + delta**2 * self.count * n / total
        self.mean, self.variance, self.count = self.mean + delta * n / total, m2 / total, total
        ### END SOLUTION

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Return (obs - mean) / sqrt(variance + 1e-4) within +-5, float32; takes note of nothing."""
        ### BEGIN SOLUTION
        return np.clip((obs - self.mean) / np.sqrt(self.variance + 1e-4), -5, 5).astype(np.float32)
        ### END SOLUTION


@dataclass
class Batch:
    """All samples of a rollout, the robots' steps one behind the other."""

    obs: torch.Tensor
    """(n, obs_dim), normalised."""
    action: torch.Tensor
    """(n, act_dim)."""
    log_prob: torch.Tensor
    """(n,) of the action when it was drawn."""
    advantage: torch.Tensor
    """(n,) as it comes from :func:`gae`."""
    target: torch.Tensor
    """(n,) of the value."""


def update(
    policy: Policy, optimiser: torch.optim.Optimizer, batch: Batch, config: Config, generator: torch.Generator
) -> float:
    """Improve policy and value; return the mean KL divergence of the last pass.

    The advantages are shifted and scaled, **over the whole batch**, to mean 0 and standard deviation 1 (add 1e-8 to
    the divisor).  In each of ``epochs`` passes the samples are shuffled and split into ``minibatches`` parts, so that
    each is used once per pass.  For each part: the loss

        -surrogate - entropy * policy.entropy() + mean((V - target)^2) / 2

    its gradient, scaled down to ``max_grad_norm`` where it is longer, and one step of the optimiser.  Then the step
    size of the optimiser follows :func:`next_rate`, with the KL divergence of the part before its step, estimated as
    the mean of (ratio - 1) - log(ratio).
    """
    ### BEGIN SOLUTION
    advantage = (batch.advantage - batch.advantage.mean()) / (batch.advantage.std() + 1e-8)
    kls: list[float] = []
    for _ in range(config.epochs):
        kls = []
        for part in torch.randperm(len(advantage), generator=generator).chunk(config.minibatches):
            new = policy.log_prob(batch.obs[part], batch.action[part])
            value = policy.value(batch.obs[part])
            gain = surrogate(new, batch.log_prob[part], advantage[part], config.clip)
            loss = -gain - config.entropy * policy.entropy() + ((value - batch.target[part]) ** 2).mean() / 2
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(policy.parameters(), config.max_grad_norm)
            optimiser.step()
            log_ratio = (new - batch.log_prob[part]).detach()
            kls.append(float((log_ratio.exp() - 1 - log_ratio).mean()))
            for group in optimiser.param_groups:
                group["lr"] = next_rate(group["lr"], kls[-1], config)
    return float(np.mean(kls))
    ### END SOLUTION

"""The policy and its value function.  Complete; nothing to do here."""

import math

import torch
from torch import nn


def _mlp(n_in: int, n_out: int, gain: float) -> nn.Sequential:
    layers = [nn.Linear(n_in, 64), nn.ELU(), nn.Linear(64, 64), nn.ELU(), nn.Linear(64, n_out)]
    for layer in layers[::2]:
        nn.init.orthogonal_(layer.weight, gain if layer is layers[-1] else 2**0.5)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(*layers)


class Policy(nn.Module):
    """A Gaussian over actions with a learned standard deviation, and a value function beside it."""

    def __init__(self, obs_dim: int, act_dim: int, std: float = 0.6):
        super().__init__()
        self.actor, self.critic = _mlp(obs_dim, act_dim, 0.01), _mlp(obs_dim, 1, 1.0)
        self.log_std = nn.Parameter(torch.full((act_dim,), math.log(std)))

    def mean(self, obs: torch.Tensor) -> torch.Tensor:
        """Return the mean action, (n, act_dim)."""
        return self.actor(obs)

    def value(self, obs: torch.Tensor) -> torch.Tensor:
        """Return V, (n,)."""
        return self.critic(obs).squeeze(-1)

    def log_prob(self, obs: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """Return the log density of actions, (n,)."""
        return torch.distributions.Normal(self.mean(obs), self.log_std.exp()).log_prob(action).sum(-1)

    def entropy(self) -> torch.Tensor:
        """Return the entropy, a scalar."""
        return (self.log_std + 0.5 * (1 + math.log(2 * math.pi))).sum()

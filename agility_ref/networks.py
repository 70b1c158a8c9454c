"""Networks: the actor-critic that PPO trains, and its observation normaliser.

The paper's low-level skills and its selector are trained by "the same PPO formulation"
(section 3.2.1), so one class serves both: a Gaussian over joint targets for the skills,
a categorical over skill indices for the selector.

In:  observations (n, obs_dim).  Out: distributions over actions, and values.
"""

import itertools
from collections.abc import Callable, Iterable

import numpy as np
import torch
from torch import nn

from agility_ref.policy import CLIP, VAR_FLOOR

LOG_2PI = float(np.log(2 * np.pi))


class Normalizer:
    """Running mean and variance per observation entry; part of every checkpoint.

    Entries in ``fixed`` keep mean 0 and the standard deviation they are given.  Scandots
    must: on flat ground their variance is next to nothing, and the first pit would then
    saturate the input.
    """

    def __init__(self, obs_dim: int, fixed: slice = slice(0, 0), fixed_std: float = 1.0):
        self.mean = np.zeros(obs_dim, np.float32)
        self.var = np.ones(obs_dim, np.float32)
        self.count = 0.0
        self.fixed = fixed
        self.var[fixed] = fixed_std**2

    def update(self, batch: np.ndarray) -> None:
        """Fold a batch (n, obs_dim) into the statistics."""
        free = np.ones(len(self.mean), bool)
        free[self.fixed] = False
        x = batch[:, free].astype(np.float64)
        mean, var, n = x.mean(axis=0), x.var(axis=0), len(x)
        total = self.count + n
        delta = mean - self.mean[free]
        # Chan et al. (1979): M2 = M2_a + M2_b + delta^2 n_a n_b / (n_a + n_b)
        m2 = self.var[free] * self.count + var * n + delta**2 * self.count * n / total
        self.mean[free] += delta * n / total
        self.var[free] = m2 / total
        self.count = total

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Return observations normalised and clipped to +-CLIP, float32."""
        return np.clip((observation - self.mean) / np.sqrt(self.var + VAR_FLOOR), -CLIP, CLIP)


def mlp(sizes: list[int], last_gain: float) -> nn.Sequential:
    """Linear layers with ELU between, orthogonal weights, zero biases."""
    modules: list[nn.Module] = []
    for i, (n_in, n_out) in enumerate(itertools.pairwise(sizes)):
        last = i == len(sizes) - 2
        linear = nn.Linear(n_in, n_out)
        nn.init.orthogonal_(linear.weight, last_gain if last else 2**0.5)
        nn.init.zeros_(linear.bias)
        modules += [linear] if last else [linear, nn.ELU()]
    return nn.Sequential(*modules)


def fit(
    parameters: Iterable[nn.Parameter],
    loss: Callable[[torch.Tensor], torch.Tensor],
    num_states: int,
    epochs: int,
    batch_size: int,
    learning_rate: float,
    generator: torch.Generator,
    anneal: bool = False,
) -> list[float]:
    """Minimise a loss over recorded states with Adam; return its mean in each epoch.

    Parameters
    ----------
    parameters : what may change
    loss : indices of states (n,) -> mean loss over them
    num_states : states there are
    epochs, batch_size, learning_rate, generator : passes, states a gradient step, step size, who shuffles
    anneal : let the step size fall to zero on a straight line
    """
    optimizer = torch.optim.Adam(parameters, learning_rate, fused=True)
    losses, done, total = [], 0, epochs * -(-num_states // batch_size)
    for _ in range(epochs):
        summed = 0.0
        for mb in torch.randperm(num_states, generator=generator).split(batch_size):
            if anneal:
                optimizer.param_groups[0]["lr"] = learning_rate * (1.0 - done / total)
            value = loss(mb)
            optimizer.zero_grad()
            value.backward()
            optimizer.step()
            done += 1
            summed += float(value.detach()) * len(mb)
        losses.append(summed / num_states)
    return losses


class ActorCritic(nn.Module):
    """Two separate MLPs: the actor's mean (or logits), and the value."""

    def __init__(self, obs_dim: int, act_dim: int, hidden: tuple[int, ...], init_std: float):
        super().__init__()
        # A last layer 100 times smaller starts every policy near the home pose.
        self.actor = mlp([obs_dim, *hidden, act_dim], 0.01)
        self.critic = mlp([obs_dim, *hidden, 1], 1.0)
        self.log_std = nn.Parameter(torch.full((act_dim,), float(np.log(init_std))))

    def value(self, obs: torch.Tensor) -> torch.Tensor:
        """Return V(obs), shape (n,)."""
        return self.critic(obs).squeeze(-1)


def gaussian_log_prob(action: torch.Tensor, mean: torch.Tensor, log_std: torch.Tensor) -> torch.Tensor:
    """Log density of a diagonal Gaussian, summed over the action: (n, a) -> (n,)."""
    # log N(a; m, s) = -((a - m) / s)^2 / 2 - log s - log(2 pi) / 2
    z = (action - mean) * torch.exp(-log_std)
    return (-0.5 * z**2 - log_std - 0.5 * LOG_2PI).sum(-1)


def gaussian_entropy(log_std: torch.Tensor) -> torch.Tensor:
    """Entropy of a diagonal Gaussian, summed over the action."""
    # H = log s + (1 + log(2 pi)) / 2
    return (log_std + 0.5 * (1.0 + LOG_2PI)).sum(-1)


def gaussian_kl(
    mean_old: torch.Tensor, log_std_old: torch.Tensor, mean_new: torch.Tensor, log_std_new: torch.Tensor
) -> torch.Tensor:
    """KL(old || new) of diagonal Gaussians, (n, a) -> (n,)."""
    # KL = log(s' / s) + (s^2 + (m - m')^2) / (2 s'^2) - 1/2
    ratio = (torch.exp(2 * log_std_old) + (mean_old - mean_new) ** 2) / (2 * torch.exp(2 * log_std_new))
    return (log_std_new - log_std_old + ratio - 0.5).sum(-1)


class Gaussian:
    """The action distribution of the skills: continuous joint offsets."""

    @staticmethod
    def parameters(net: ActorCritic, obs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return mean and log standard deviation, both (n, a); the latter is the same in every state."""
        mean = net.actor(obs)
        return mean, net.log_std.expand_as(mean)

    @staticmethod
    def sample(parameters: tuple, generator: torch.Generator) -> torch.Tensor:
        """Draw actions (n, a)."""
        mean, log_std = parameters
        return mean + torch.exp(log_std) * torch.randn(mean.shape, generator=generator)

    @staticmethod
    def log_prob(parameters: tuple, action: torch.Tensor) -> torch.Tensor:
        """Return the log density of actions (n, a), shape (n,)."""
        return gaussian_log_prob(action, *parameters)

    @staticmethod
    def entropy(parameters: tuple) -> torch.Tensor:
        """Return the entropy, mean over states."""
        return gaussian_entropy(parameters[1]).mean()

    @staticmethod
    def kl(old: tuple, new: tuple) -> torch.Tensor:
        """Return KL(old || new), shape (n,)."""
        return gaussian_kl(*old, *new)


class Categorical:
    """The action distribution of the selector: one skill index (paper section 3.2)."""

    @staticmethod
    def parameters(net: ActorCritic, obs: torch.Tensor) -> tuple[torch.Tensor]:
        """Return log probabilities (n, k)."""
        return (torch.log_softmax(net.actor(obs), -1),)

    @staticmethod
    def sample(parameters: tuple, generator: torch.Generator) -> torch.Tensor:
        """Draw indices (n,)."""
        return torch.multinomial(parameters[0].exp(), 1, generator=generator).squeeze(-1)

    @staticmethod
    def log_prob(parameters: tuple, action: torch.Tensor) -> torch.Tensor:
        """Return the log probability of indices (n,), shape (n,)."""
        return parameters[0].gather(-1, action.long()[:, None]).squeeze(-1)

    @staticmethod
    def entropy(parameters: tuple) -> torch.Tensor:
        """Return -sum p log p, mean over states."""
        (logp,) = parameters
        return -(logp.exp() * logp).sum(-1).mean()

    @staticmethod
    def kl(old: tuple, new: tuple) -> torch.Tensor:
        """Return KL(old || new), shape (n,)."""
        return (old[0].exp() * (old[0] - new[0])).sum(-1)

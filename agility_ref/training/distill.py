"""Distillation: one network that does what the oracle's specialists would do.

Paper section 5, future work: "all specialists and potentially the selector policy are distilled
into a unified generalist policy (referred to as post-generalist, in contrast with the
true-generalist)".  First the oracle acts and the student learns its actions; then the student
acts, the oracle says at every step what it would have done, and the student learns from all
that was seen (DAgger; Ross et al. 2011).  PPO then goes on from the student with smaller steps than
a beginner's: a new critic first learns alone, for its first values would ruin a good actor (Rudin
et al. 2025, "Parkour in the Wild", do the same).

In:  the frozen specialists, the oracle's region map, courses.
Out: observations with the actions asked for; a network of the generalists' size.

What is simplified: the student sees what its teachers see, scandots and true velocity, while the
paper would give it a camera; teachers are the deterministic specialists.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from agility_ref.env import Go1Env
from agility_ref.errors import require_at_least
from agility_ref.observation import ACTION_MIRROR, OBS_MIRROR, SCANDOT_STD, SCANDOTS
from agility_ref.selector import Hierarchy, Single, visit

import numpy as np

if TYPE_CHECKING:
    from agility_ref.ppo import PPOConfig


@dataclass(frozen=True)
class DistillConfig:
    """Training of the distilled policy."""

    dagger_rounds: int = 4
    """Rounds in which the student acts, after one in which the oracle does; usual 2 to 10."""
    action_noise: float = 0.2
    """Standard deviation of noise on the actions taken, in units of action; widens what is seen; usual 0 to 0.5."""
    epochs: int = 8
    """Passes over the data per round; usual 5 to 30."""
    batch_size: int = 1024
    """States per gradient step; usual 256 to 4096."""
    learning_rate: float = 1e-3
    """Adam's step size, falling to zero in each round."""

    def __post_init__(self):
        require_at_least(1, epochs=self.epochs, batch_size=self.batch_size)


@dataclass(frozen=True)
class FineTuneConfig:
    """What PPO does otherwise when it goes on from a distilled policy: smaller steps, from more data.

    A beginner gains by large steps in roughly the right direction.  They would undo in minutes
    what a distilled policy can do: docs/training.md has the figures.
    """

    std: float = 0.2
    """Exploration noise at the start; usual 0.1 to 0.3."""
    critic_steps: int = 500_000
    """Environment steps in which the new critic learns alone; usual 100,000 to 1,000,000."""
    critic_learning_rate: float = 5e-4
    """Step size of the critic, which does not follow the actor's small ones."""
    num_steps: int = 64
    """Control steps per robot and iteration, in place of ppo.num-steps."""
    target_kl: float = 0.01
    """KL divergence per minibatch, in place of ppo.target-kl; usual 0.003 to 0.01."""
    learning_rate_min: float = 1e-5
    """Floor of the adaptive rate, in place of ppo.learning-rate-min."""
    anneal_share: float = 1.0
    """KL target and floor fall to zero over this share of the steps, in place of ppo.anneal-share."""
    ent_coef: float = 0.0
    """Entropy bonus, in place of ppo.ent-coef: there is nothing to be found by wider noise."""

    def apply(self, ppo: "PPOConfig") -> "PPOConfig":
        """Return PPO's hyper-parameters for going on: ours where both have a field of the same name."""
        return replace(ppo, **{name: value for name, value in vars(self).items() if hasattr(ppo, name)})


def collect_actions(
    env: Go1Env, actor: Hierarchy | Single, oracle: Hierarchy, num_states: int, action_noise: float
) -> tuple[np.ndarray, np.ndarray]:
    """Run ``actor``, ask ``oracle``: observations (M, 184) and the actions asked for (M, 12).

    Actions are clipped as the environment clips them: beyond that they mean the same.
    """
    limit, seen = env.config.action_limit, []
    for observation in visit(env, actor, num_states, action_noise):
        wanted = oracle.execute(observation, oracle.choose(observation, env))
        seen.append((observation.copy(), np.clip(wanted, -limit, limit).astype(np.float32)))
    observations, actions = (np.concatenate(part) for part in zip(*seen, strict=True))
    return observations, actions


def fit_student(
    observations: np.ndarray, actions: np.ndarray, hidden: tuple[int, ...], config: DistillConfig, seed: int
) -> tuple[dict[str, np.ndarray], list[float]]:
    """Minimise the squared error of the actions; return the arrays of a checkpoint and the loss of each epoch.

    The normaliser is that of the states seen; PPO takes it over and goes on counting.
    """
    from agility_ref.networks import EquivariantMLP, Normalizer, fit

    import torch

    torch.set_num_threads(1)
    torch.manual_seed(seed)
    generator = torch.Generator().manual_seed(seed)
    normalizer = Normalizer(OBS_MIRROR, SCANDOTS, SCANDOT_STD)
    normalizer.update(observations)
    net = EquivariantMLP(OBS_MIRROR, hidden, ACTION_MIRROR, 0.01)

    def loss(mb: torch.Tensor) -> torch.Tensor:
        # L = mean over joints and states of (pi(s) - a)^2
        x = torch.from_numpy(normalizer(observations[mb.numpy()]))  # by the batch: all of it twice is gigabytes
        return ((net(net.parts(x)) - torch.from_numpy(actions[mb.numpy()])) ** 2).mean()

    losses = fit(
        net.parameters(), loss, len(actions), config.epochs, config.batch_size, config.learning_rate, generator,
        anneal=True,
    )  # fmt: skip
    arrays = {f"net.actor.{name}": p.detach().numpy().copy() for name, p in net.named_parameters()}
    arrays |= {f"actor.{name}": array for name, array in net.dense().items()}
    return arrays | {
        "normalizer.mean": normalizer.mean, "normalizer.var": normalizer.var,
        "normalizer.count": np.array(normalizer.count),
    }, losses  # fmt: skip

"""Imitation: selectors and generalists that learn what the oracle would do.

Paper section 3.2.3 trains a selector "supervised by an oracle"; section 5, future work: "all
specialists and potentially the selector policy are distilled into a unified generalist policy
(referred to as post-generalist, in contrast with the true-generalist)".  Both are done alike.  First
the oracle acts and the student learns its answers, the names of skills or the actions of the skills;
then the student acts, the oracle says at every step what it would have done, and the student learns
from all that was seen (DAgger; Ross et al. 2011).  PPO may go on from a distilled student with smaller
steps than a beginner's: a new critic first learns alone, for its first values would ruin a good actor
(Rudin et al. 2025, "Parkour in the Wild", do the same).

In:  the frozen specialists, the oracle's region map, courses.
Out: what was seen with what the oracle asked for; the arrays of a checkpoint.

What is simplified: the distilled student sees what its teachers see, scandots and true velocity, while
the paper would give it a camera; teachers are the deterministic specialists.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

from agility_ref.env import Go1Env
from agility_ref.errors import MANY, require_at_least, require_pairs
from agility_ref.networks import EquivariantMLP, Normalizer
from agility_ref.observation import ACTION_MIRROR, OBS_MIRROR, SCANDOT_MIRROR, SCANDOT_STD, SCANDOTS, Mirror
from agility_ref.ppo import PPOConfig
from agility_ref.selector import Hierarchy, Single

import numpy as np
import torch
from torch import nn
from tqdm import tqdm


@dataclass(frozen=True)
class SupervisedConfig:
    """Training of the supervised selector (paper section 3.2.3)."""

    dagger_rounds: int = 1  # rounds collected with the learner's own choices after the oracle's; 0 for the paper's
    epochs: int = 6  # passes over the data per round; usual 5 to 30
    batch_size: int = 1024  # states per gradient step; usual 256 to 4096
    learning_rate: float = 1e-3  # Adam's step size
    hidden: tuple[int, ...] = (128, 128)  # 132 x 128 x 128 x n in the paper; even numbers

    def __post_init__(self):
        _check_imitation(self)
        require_pairs(self.hidden)


@dataclass(frozen=True)
class DistillConfig:
    """Training of the distilled policy."""

    dagger_rounds: int = 4  # rounds in which the student acts, after one in which the oracle does; usual 2 to 10
    action_noise: float = 0.2
    """Standard deviation of noise on the actions taken, in units of action; widens what is seen; usual 0 to 0.5."""
    epochs: int = 8  # passes over the data per round; usual 5 to 30
    batch_size: int = 1024  # states per gradient step; usual 256 to 4096
    learning_rate: float = 1e-3  # Adam's step size, falling to zero in each round

    def __post_init__(self):
        _check_imitation(self)
        require_at_least(0, action_noise=self.action_noise)


def _check_imitation(config: SupervisedConfig | DistillConfig) -> None:
    require_at_least(1, MANY, epochs=config.epochs, batch_size=config.batch_size)
    require_at_least(0, MANY, dagger_rounds=config.dagger_rounds)
    require_at_least(1e-9, learning_rate=config.learning_rate)


@dataclass(frozen=True)
class FineTuneConfig:
    """What PPO does otherwise when it goes on from a distilled policy: smaller steps, from more data.

    A beginner gains by large steps in roughly the right direction.  They would undo in minutes
    what a distilled policy can do: docs/training.md has the figures.
    """

    std: float = 0.2  # exploration noise at the start; usual 0.1 to 0.3
    critic_steps: int = 500_000  # environment steps in which the new critic learns alone; usual 100,000 to 1,000,000
    critic_learning_rate: float = 5e-4  # step size of the critic, which does not follow the actor's small ones
    num_steps: int = 64  # steps per robot and iteration, in place of ppo.num-steps
    target_kl: float = 0.01  # KL divergence per minibatch, in place of ppo.target-kl; usual 0.003 to 0.01
    learning_rate_min: float = 1e-5  # floor of the adaptive rate, in place of ppo.learning-rate-min
    anneal_share: float = 1.0
    """KL target and floor fall to zero over this share of the steps, in place of ppo.anneal-share."""
    ent_coef: float = 0.0  # entropy bonus, in place of ppo.ent-coef: there is nothing to be found by wider noise

    def __post_init__(self):
        require_at_least(1e-9, std=self.std)

    def apply(self, ppo: PPOConfig) -> PPOConfig:
        """Return PPO's hyper-parameters for going on: ours where both have a field of the same name."""
        return replace(ppo, **{name: value for name, value in vars(self).items() if hasattr(ppo, name)})


def visit(env: Go1Env, actor: Hierarchy | Single, num_states: int, action_noise: float = 0.0) -> Iterator[np.ndarray]:
    """Run ``actor`` from new episodes on; yield the observation (N, 184) before each step, for at least ``num_states``."""
    observation, _ = env.reset()
    steps = range(-(-num_states // env.num_envs))
    for _ in tqdm(steps, desc=f"{actor.name} acts", unit="step", leave=False, delay=3, disable=None):
        yield observation
        action, _ = actor.act(observation, env)
        if action_noise:
            action = action + action_noise * env.rng.standard_normal(action.shape)
        observation = env.step(action)[0]


def collect_labels(env: Go1Env, actor: Hierarchy, oracle: Hierarchy, num_states: int) -> tuple[np.ndarray, np.ndarray]:
    """Run ``actor``, label with ``oracle``: scandots (M, 132) and skill indices (M,)."""
    seen = [(obs[:, SCANDOTS].copy(), oracle.choose(obs, env)) for obs in visit(env, actor, num_states)]
    scandots, labels = (np.concatenate(part) for part in zip(*seen, strict=True))
    return scandots, labels


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


def fit_selector(
    scandots: np.ndarray, labels: np.ndarray, num_skills: int, config: SupervisedConfig, seed: int
) -> tuple[dict[str, np.ndarray], list[float]]:
    """Minimise the cross-entropy; return the arrays of a checkpoint and the loss of each epoch.

    What is seen mirrored asks for the same skill, so the network is invariant.
    """
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    normalizer = Normalizer(SCANDOT_MIRROR, slice(0, scandots.shape[1]), SCANDOT_STD)
    net = EquivariantMLP(SCANDOT_MIRROR, config.hidden, Mirror.identity(num_skills), 0.01)
    x, y = net.parts(torch.from_numpy(normalizer(scandots))), torch.from_numpy(labels)
    losses = fit(net.parameters(), lambda mb: nn.functional.cross_entropy(net(x[mb]), y[mb]), len(x), config, seed)
    arrays = {f"actor.{name}": array for name, array in net.dense().items()}
    return arrays | {"normalizer.mean": normalizer.mean, "normalizer.var": normalizer.var}, losses


def fit_student(
    observations: np.ndarray, actions: np.ndarray, hidden: tuple[int, ...], config: DistillConfig, seed: int
) -> tuple[dict[str, np.ndarray], list[float]]:
    """Minimise the squared error of the actions; return the arrays of a checkpoint and the loss of each epoch.

    The normaliser is that of the states seen; PPO takes it over and goes on counting.
    """
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    normalizer = Normalizer(OBS_MIRROR, SCANDOTS, SCANDOT_STD)
    normalizer.update(observations)
    net = EquivariantMLP(OBS_MIRROR, hidden, ACTION_MIRROR, 0.01)

    def loss(mb: torch.Tensor) -> torch.Tensor:
        # L = mean over joints and states of (pi(s) - a)^2
        x = torch.from_numpy(normalizer(observations[mb.numpy()]))  # by the batch: all of it twice is gigabytes
        return ((net(net.parts(x)) - torch.from_numpy(actions[mb.numpy()])) ** 2).mean()

    losses = fit(net.parameters(), loss, len(actions), config, seed, anneal=True)
    arrays = {f"net.actor.{name}": p.detach().numpy().copy() for name, p in net.named_parameters()}
    arrays |= {f"actor.{name}": array for name, array in net.dense().items()}
    return arrays | {
        "normalizer.mean": normalizer.mean, "normalizer.var": normalizer.var,
        "normalizer.count": np.array(normalizer.count),
    }, losses  # fmt: skip


def fit(
    parameters: Iterable[nn.Parameter],
    loss: Callable[[torch.Tensor], torch.Tensor],
    num_states: int,
    config: SupervisedConfig | DistillConfig,
    seed: int,
    anneal: bool = False,
) -> list[float]:
    """Minimise a loss over recorded states with Adam; return its mean in each epoch.

    Parameters
    ----------
    parameters : what may change
    loss : indices of states (n,) -> mean loss over them
    num_states : states there are
    config : passes, states per gradient step, step size
    seed : of the shuffling
    anneal : let the step size fall to zero on a straight line
    """
    optimizer = torch.optim.Adam(parameters, config.learning_rate, fused=True)
    generator = torch.Generator().manual_seed(seed)
    losses, done, total = [], 0, config.epochs * -(-num_states // config.batch_size)
    for _ in tqdm(range(config.epochs), desc="fit", unit="epoch", leave=False, delay=3, disable=None):
        summed = 0.0
        for mb in torch.randperm(num_states, generator=generator).split(config.batch_size):
            if anneal:
                optimizer.param_groups[0]["lr"] = config.learning_rate * (1.0 - done / total)
            value = loss(mb)
            optimizer.zero_grad()
            value.backward()
            optimizer.step()
            done += 1
            summed += float(value.detach()) * len(mb)
        losses.append(summed / num_states)
    return losses

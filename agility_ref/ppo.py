"""PPO: the whole algorithm, for the skills and for the selector.

Paper section 3.2.1: the selector is "trained using the same PPO formulation used during
training of low-level skills".  In: a vector environment with Gymnasium's SAME_STEP
autoreset.  Out: a trained :class:`~agility_ref.networks.ActorCritic` and its normaliser, and
one record an iteration.

Two things are done here that many references get wrong: a truncated episode bootstraps
with the value of its **true final observation** and a terminated one does not bootstrap,
and the normaliser is part of the policy.  What is simplified: the value loss is not
clipped, and the normaliser changes between iterations, never within one.
"""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
import torch

from agility_ref.errors import UserError
from agility_ref.networks import ActorCritic, Gaussian, Normalizer
from agility_ref.observation import MIRROR_ACTION_INDEX, MIRROR_ACTION_SIGN, MIRROR_INDEX, MIRROR_SIGN, SCANDOT_STD


@dataclass(frozen=True)
class PPOConfig:
    """Hyper-parameters, the same for every policy of Table 1 unless said otherwise."""

    num_envs: int = 256
    """Robots simulated side by side; usual 64 to 4096."""
    num_steps: int = 16
    """Control steps per robot and iteration; usual 16 to 64."""
    update_epochs: int = 4
    """Passes over the batch per iteration; usual 3 to 10."""
    num_minibatches: int = 4
    """Minibatches per pass; usual 2 to 8."""
    gamma: float = 0.99
    """Discount per control step; usual 0.97 to 0.995."""
    gae_lambda: float = 0.95
    """Weight of longer returns in the advantage; usual 0.9 to 0.97."""
    clip_coef: float = 0.2
    """How far the policy ratio may move before its gradient stops; usual 0.1 to 0.3."""
    ent_coef: float = 0.005
    """Weight of the entropy bonus; usual 0 to 0.01."""
    max_grad_norm: float = 1.0
    """Gradients of actor and of critic are each scaled down to this norm; usual 0.5 to 1."""
    learning_rate: float = 1e-3
    """Start of the adaptive rate; usual 3e-4 to 1e-3."""
    learning_rate_min: float = 1.5e-4
    """Floor of the adaptive rate; 1e-5 stalls at batches of 4096."""
    learning_rate_max: float = 3e-3
    """Ceiling of the adaptive rate."""
    critic_learning_rate: float = 0.0
    """Step size of the critic; 0 for the actor's of the moment.  Set it where that becomes small; usual 5e-4 to 1e-3."""
    target_kl: float = 0.02
    """KL divergence per minibatch that the rate is steered to; usual 0.005 to 0.02."""
    init_std: float = 0.8
    """Standard deviation of the first policy; usual 0.5 to 1."""
    final_std: float = 0.2
    """The standard deviation may not exceed a line from init_std to this; usual 0.1 to 0.3, init_std for no limit."""
    anneal_share: float = 0.25
    """Last share of the steps in which KL target and lowest step size fall to zero; 0 for never."""
    mirror: bool = False
    """Learn from the mirror images, left for right, of every other robot's steps; skills only."""
    hidden: tuple[int, ...] = (256, 128)
    """Units of the hidden layers of actor and critic."""

    @property
    def batch_size(self) -> int:
        """Environment steps per iteration."""
        return self.num_envs * self.num_steps


@dataclass
class Learner:
    """What training changes: network, normaliser, optimiser, counters."""

    net: ActorCritic
    normalizer: Normalizer
    config: PPOConfig
    distribution: type = Gaussian
    seed: int = 0
    learning_rate: float = field(init=False)
    steps: int = 0
    """Environment steps so far, warm start included."""
    start: int = 0
    """Of these, the warm start's."""
    actor_start: int = 0
    """Environment steps up to which the critic learns alone, see :meth:`warm_start`."""
    anneal: float = 1.0
    """Factor of KL target and lowest step size; see :func:`schedule`."""

    def __post_init__(self):
        self.learning_rate = self.config.learning_rate
        # Actor and critic share no weights: each has its optimiser and its gradient norm, so the
        # weight of the value loss in the textbook's sum has nothing left to balance.
        actor = [*self.net.actor.parameters(), self.net.log_std]
        self.actor_optimizer = torch.optim.Adam(actor, self.learning_rate, fused=True)
        self.critic_optimizer = torch.optim.Adam(self.net.critic.parameters(), self.learning_rate, fused=True)
        self.generator = torch.Generator().manual_seed(self.seed)

    @property
    def actor_rests(self) -> bool:
        """Whether the critic still learns alone."""
        return self.steps < self.actor_start

    @classmethod
    def create(
        cls,
        obs_dim: int,
        act_dim: int,
        config: PPOConfig,
        seed: int,
        distribution: type = Gaussian,
        fixed: slice = slice(0, 0),
    ) -> "Learner":
        """Start from scratch; ``fixed`` observations are not normalised but divided by SCANDOT_STD."""
        torch.manual_seed(seed)
        net = ActorCritic(obs_dim, act_dim, config.hidden, config.init_std)
        return cls(net, Normalizer(obs_dim, fixed, SCANDOT_STD), config, distribution, seed)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the network and the normaliser, as checkpoints hold them."""
        n = self.normalizer
        arrays = {name: p.detach().numpy().copy() for name, p in self.net.named_parameters()}
        return arrays | {
            "normalizer.mean": n.mean.copy(), "normalizer.var": n.var.copy(), "normalizer.count": np.array(n.count)
        }  # fmt: skip

    def training_arrays(self) -> dict[str, np.ndarray]:
        """Return what resuming needs beyond :meth:`arrays`: Adam's moments, the rate, when the actor starts."""
        state = {
            "optimizer.learning_rate": np.array(self.learning_rate),
            "optimizer.actor_start": np.array(self.actor_start),
        }
        for name, parameter in self.net.named_parameters():
            for key, value in self._optimizer(name).state.get(parameter, {}).items():
                state[f"optimizer.{name}.{key}"] = value.numpy().copy()
        return state

    def _optimizer(self, parameter_name: str) -> torch.optim.Adam:
        return self.critic_optimizer if parameter_name.startswith("critic.") else self.actor_optimizer

    def load_arrays(self, arrays: dict[str, np.ndarray]) -> None:
        """Copy :meth:`arrays`, and :meth:`training_arrays` where present, into this learner.

        Raises
        ------
        UserError : the arrays are those of another network
        """
        with torch.no_grad():
            for name, parameter in self.net.named_parameters():
                shape = arrays[name].shape if name in arrays else None
                if shape != tuple(parameter.shape):
                    raise UserError(f"checkpoint has {name} of shape {shape}, this network {tuple(parameter.shape)}")
                parameter.copy_(torch.from_numpy(arrays[name]))
        n = self.normalizer
        n.mean[:], n.var[:] = arrays["normalizer.mean"], arrays["normalizer.var"]
        n.count = float(arrays["normalizer.count"])
        self.learning_rate = float(arrays.get("optimizer.learning_rate", self.learning_rate))
        self.actor_start = int(arrays.get("optimizer.actor_start", self.actor_start))
        for name, parameter in self.net.named_parameters():
            keys = ("step", "exp_avg", "exp_avg_sq")
            if f"optimizer.{name}.step" in arrays:
                self._optimizer(name).state[parameter] = {
                    key: torch.from_numpy(arrays[f"optimizer.{name}.{key}"].copy()) for key in keys
                }

    def warm_start(self, arrays: dict[str, np.ndarray], steps: int, std: float, critic_steps: int = 0) -> None:
        """Go on from another policy's network after its ``steps``, with a fresh optimiser and exploration noise ``std``.

        A policy that was not learned from rewards has no critic.  The values of a new one would
        ruin its actor, which therefore rests for the first ``critic_steps`` environment steps, and
        starts with small ones.
        """
        self.steps = self.start = self.actor_start = steps
        if not any(name.startswith("critic.") for name in arrays):
            self.actor_start += critic_steps
            self.learning_rate = self.config.learning_rate_min
        own = {name: array for name, array in self.arrays().items() if not name.startswith(("actor.", "normalizer."))}
        self.load_arrays(own | {name: a for name, a in arrays.items() if not name.startswith("optimizer.")})
        self.net.log_std.data.fill_(float(np.log(std)))


def gae(
    rewards: np.ndarray,
    values: np.ndarray,
    next_values: np.ndarray,
    terminated: np.ndarray,
    truncated: np.ndarray,
    gamma: float,
    gae_lambda: float,
) -> np.ndarray:
    """Generalised advantage estimation (Schulman et al. 2016), all arrays (T, N).

    Parameters
    ----------
    rewards : reward of step t
    values : V(s_t)
    next_values : V(s_{t+1}), where an episode ended of its true final observation
    terminated, truncated : bool, how step t ended an episode; on both, it terminated

    Returns
    -------
    advantages (T, N); advantages + values are the targets of the critic
    """
    # TD error: delta_t = r_t + gamma * V(s_{t+1}) * (1 - terminated_t) - V(s_t)
    delta = rewards + gamma * next_values * ~terminated - values
    # A_t = delta_t + gamma * lambda * A_{t+1}, cut where an episode ended either way
    carry = gamma * gae_lambda * ~(terminated | truncated)
    advantages = np.zeros_like(delta)
    following = np.zeros_like(delta[0])
    for t in reversed(range(len(delta))):
        following = delta[t] + carry[t] * following
        advantages[t] = following
    return advantages


def policy_loss(
    log_prob: torch.Tensor, old_log_prob: torch.Tensor, advantage: torch.Tensor, clip_coef: float
) -> torch.Tensor:
    """Clipped surrogate (Schulman et al. 2017, equation 7), to be minimised; inputs (n,)."""
    # r = pi(a|s) / pi_old(a|s);  L = -mean(min(r A, clip(r, 1 - eps, 1 + eps) A))
    ratio = torch.exp(log_prob - old_log_prob)
    clipped = torch.clamp(ratio, 1.0 - clip_coef, 1.0 + clip_coef)
    return -torch.min(ratio * advantage, clipped * advantage).mean()


def adapt_learning_rate(rate: float, kl: float, config: PPOConfig, anneal: float = 1.0) -> float:
    """Divide the rate by 1.5 where KL is above twice the target, multiply below half of it.

    ``anneal``, from 1 down to 0, scales the target and the lowest rate.
    """
    if kl > 2.0 * anneal * config.target_kl:
        rate /= 1.5
    elif kl < 0.5 * anneal * config.target_kl:
        rate *= 1.5
    return float(np.clip(rate, anneal * config.learning_rate_min, config.learning_rate_max))


def schedule(progress: float, config: PPOConfig) -> tuple[float, float]:
    """Return the largest standard deviation, and the factor ``anneal``, at a share of the run's own steps.

    Noise that finds the way up a step also throws the robot off it: first explore, then refine.
    """
    # std <= std_0 + (std_1 - std_0) p;  anneal = min(1, (1 - p) / share)
    std = config.init_std + (config.final_std - config.init_std) * progress
    anneal = min(1.0, (1.0 - progress) / config.anneal_share) if config.anneal_share else 1.0
    return std, anneal


@dataclass
class Rollout:
    """num_steps steps of every robot, arrays (T, N, ...)."""

    obs: torch.Tensor
    actions: torch.Tensor
    parameters: tuple[torch.Tensor, ...]
    """Of the distribution that each action was drawn from."""
    rewards: np.ndarray
    values: np.ndarray
    next_values: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    raw_obs: np.ndarray
    """(T, N, obs_dim) before normalisation, for the normaliser."""
    episodes: list[dict]
    """One entry per episode that ended: reward, length, waypoints, edge."""


@dataclass
class Batch:
    """A minibatch of n steps, arrays (n, ...)."""

    obs: torch.Tensor
    actions: torch.Tensor
    advantages: torch.Tensor
    returns: torch.Tensor
    """Targets of the critic."""
    old: tuple[torch.Tensor, ...]
    """Parameters of the distribution that each action was drawn from ..."""
    old_log_prob: torch.Tensor
    """... and what it gave the action."""


@torch.inference_mode()
def collect(env, learner: Learner, obs: np.ndarray) -> tuple[Rollout, np.ndarray]:
    """Run the policy for num_steps; return the rollout and the next observation (N, obs_dim)."""
    c, net, norm = learner.config, learner.net, learner.normalizer
    T, N = c.num_steps, c.num_envs
    raw_obs = np.zeros((T, N, obs.shape[1]), np.float32)
    normalized = torch.zeros(raw_obs.shape)
    rewards = np.zeros((T, N), np.float32)
    terminated, truncated = np.zeros((T, N), bool), np.zeros((T, N), bool)
    parameters, actions, episodes, cut_short = [], [], [], []
    for t in range(T):
        raw_obs[t] = obs
        normalized[t] = torch.from_numpy(norm(obs))
        parameters.append(learner.distribution.parameters(net, normalized[t]))
        action = learner.distribution.sample(parameters[t], learner.generator)
        actions.append(action)
        obs, rewards[t], terminated[t], truncated[t], info = env.step(action.numpy())
        done = np.flatnonzero(terminated[t] | truncated[t])
        episodes += [{key: value[i] for key, value in info["episode"].items()} for i in done]
        for i in np.flatnonzero(truncated[t]):
            cut_short.append((t, i, info["final_observation"][i]))
    values = net.value(normalized.flatten(0, 1)).view(T, N).numpy()
    next_values = np.concatenate([values[1:], net.value(torch.from_numpy(norm(obs))).numpy()[None]])
    if cut_short:
        t, i, final_obs = zip(*cut_short, strict=True)
        next_values[list(t), list(i)] = net.value(torch.from_numpy(norm(np.stack(final_obs)))).numpy()
    rollout = Rollout(
        normalized, torch.stack(actions), tuple(torch.stack(p) for p in zip(*parameters, strict=True)),
        rewards, values, next_values, terminated, truncated, raw_obs, episodes,
    )  # fmt: skip
    return rollout, obs


def update_actor(learner: Learner, batches: list[Batch]) -> dict[str, float]:
    """Take one gradient step on the policy per minibatch and pass; return mean losses, KL and clip fraction."""
    c, net, dist = learner.config, learner.net, learner.distribution
    sums = {"policy_loss": 0.0, "entropy": 0.0, "kl": 0.0, "clip_fraction": 0.0}
    for mb in [] if learner.actor_rests else batches * c.update_epochs:
        new = dist.parameters(net, mb.obs)
        log_prob = dist.log_prob(new, mb.actions)
        with torch.no_grad():
            kl = float(dist.kl(mb.old, new).mean())
            clip_fraction = ((log_prob - mb.old_log_prob).exp() - 1).abs().gt(c.clip_coef).float().mean()
        learner.learning_rate = adapt_learning_rate(learner.learning_rate, kl, c, learner.anneal)
        pg_loss = policy_loss(log_prob, mb.old_log_prob, mb.advantages, c.clip_coef)
        entropy = dist.entropy(new)
        _descend(learner.actor_optimizer, learner.learning_rate, pg_loss - c.ent_coef * entropy, c.max_grad_norm)
        for key, value in zip(sums, (pg_loss.detach(), entropy.detach(), kl, clip_fraction), strict=True):
            sums[key] += float(value) / (len(batches) * c.update_epochs)
    return sums


def update_critic(learner: Learner, batches: list[Batch], learning_rate: float) -> dict[str, float]:
    """Take one gradient step on the value per minibatch and pass; return the mean loss."""
    c, total = learner.config, 0.0
    for mb in batches * c.update_epochs:
        # L = mean((V(s) - R)^2) / 2
        loss = 0.5 * ((learner.net.value(mb.obs) - mb.returns) ** 2).mean()
        _descend(learner.critic_optimizer, learning_rate, loss, c.max_grad_norm)
        total += float(loss.detach()) / (len(batches) * c.update_epochs)
    return {"value_loss": total}


def _descend(optimizer: torch.optim.Adam, learning_rate: float, loss: torch.Tensor, max_grad_norm: float) -> None:
    (group,) = optimizer.param_groups
    group["lr"] = learning_rate
    optimizer.zero_grad()
    loss.backward()
    torch.nn.utils.clip_grad_norm_(group["params"], max_grad_norm)
    optimizer.step()


@torch.inference_mode()
def mirror_alternate(learner: Learner, rollout: Rollout) -> None:
    """Replace the steps of every other robot by their mirror images, left for right, in place.

    The robot and its courses have no handedness, so what was good on one side is good on the
    other: probabilities, advantages and values carry over (Mittal et al. 2024, "Symmetry
    considerations for learning task symmetric robot policies").
    """
    flipped = rollout.raw_obs[:, 1::2][:, :, MIRROR_INDEX] * MIRROR_SIGN
    rollout.obs[:, 1::2] = torch.from_numpy(learner.normalizer(flipped))
    mean, log_std = rollout.parameters
    sign = torch.from_numpy(MIRROR_ACTION_SIGN)
    for values, factor in ((rollout.actions, sign), (mean, sign), (log_std, 1.0)):
        values[:, 1::2] = values[:, 1::2][:, :, MIRROR_ACTION_INDEX] * factor


def update(learner: Learner, rollout: Rollout) -> dict[str, float]:
    """One PPO update; return the mean losses, KL and clip fraction.

    Actor and critic share no weights, so they learn side by side, each in a thread of its own:
    two cores stay busy, and the result does not depend on their timing.
    """
    c = learner.config
    advantages = gae(
        rollout.rewards, rollout.values, rollout.next_values,
        rollout.terminated, rollout.truncated, c.gamma, c.gae_lambda,
    )  # fmt: skip
    returns = torch.from_numpy(advantages + rollout.values).flatten()
    advantages = torch.from_numpy((advantages - advantages.mean()) / (advantages.std() + 1e-8)).flatten()
    if c.mirror:
        mirror_alternate(learner, rollout)
    obs, actions = rollout.obs.flatten(0, 1), rollout.actions.flatten(0, 1)
    old = tuple(p.flatten(0, 1) for p in rollout.parameters)
    old_log_prob = learner.distribution.log_prob(old, actions)
    # Dealt out once and not anew every pass: gathering rows of obs is a tenth of the update.
    batches = [
        Batch(obs[i], actions[i], advantages[i], returns[i], tuple(p[i] for p in old), old_log_prob[i])
        for i in torch.randperm(len(obs), generator=learner.generator).chunk(c.num_minibatches)
    ]
    with ThreadPoolExecutor(2) as pool:
        # The critic keeps the step size of the start, the actor steers it by the KL divergence.
        rate = c.critic_learning_rate or (c.learning_rate if learner.actor_rests else learner.learning_rate)
        critic = pool.submit(update_critic, learner, batches, rate)
        actor = pool.submit(update_actor, learner, batches)
    learner.normalizer.update(rollout.raw_obs.reshape(-1, rollout.raw_obs.shape[-1]))
    return actor.result() | critic.result()


def train(
    env,
    learner: Learner,
    total_steps: int,
    stop: Callable[[], bool] = lambda: False,
    obs: np.ndarray | None = None,
) -> Iterator[dict]:
    """Alternate :func:`collect` and :func:`update` until ``total_steps``; yield each iteration's record.

    A run that goes on starts from its last observation ``obs`` (N, obs_dim), others from new episodes.
    """
    torch.set_num_threads(1)  # two threads fight the simulation's and gain nothing at this size
    if obs is None:
        obs, _ = env.reset(learner.seed + learner.steps)
    while learner.steps < total_steps and not stop():
        start = time.perf_counter()
        rollout, obs = collect(env, learner, obs)
        max_std, learner.anneal = schedule(
            (learner.steps - learner.start) / (total_steps - learner.start), learner.config
        )
        losses = update(learner, rollout)
        learner.net.log_std.data.clamp_(max=float(np.log(max_std)))
        learner.steps += learner.config.batch_size
        seconds = time.perf_counter() - start
        yield {
            "steps": learner.steps,
            "steps_per_second": learner.config.batch_size / seconds,
            "learning_rate": learner.learning_rate,
            "std": float(learner.net.log_std.detach().exp().mean()),
            "episodes": rollout.episodes,
            **losses,
        }

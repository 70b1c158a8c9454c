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
from dataclasses import dataclass

import numpy as np
import torch

from agility_ref.learner import Learner
from agility_ref.observation import MIRROR_ACTION_INDEX, MIRROR_ACTION_SIGN, MIRROR_INDEX, MIRROR_SIGN
from agility_ref.policies import PPOConfig


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


def train(env, learner: Learner, total_steps: int, stop: Callable[[], bool] = lambda: False) -> Iterator[dict]:
    """Alternate :func:`collect` and :func:`update` until ``total_steps``; yield each iteration's record."""
    torch.set_num_threads(1)  # two threads fight the simulation's and gain nothing at this size
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

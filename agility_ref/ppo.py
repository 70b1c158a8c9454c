"""PPO: the whole algorithm, for the skills, the generalists and the selector.

Paper section 3.2.1: the selector is "trained using the same PPO formulation used during training
of low-level skills".  In: a vector environment with Gymnasium's SAME_STEP autoreset.  Out: a
trained :class:`Learner`, and one record per iteration.

Two things are done here that many references get wrong: a truncated episode bootstraps with the
value of its **true final observation** and a terminated one does not bootstrap, and the
normaliser is part of the policy.  What is simplified: the value loss is not clipped, and the
normaliser changes between iterations, never within one.
"""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

from agility_ref.errors import MANY, UserError, require_at_least, require_pairs
from agility_ref.networks import ActorCritic, Normalizer, kl_divergence, sample
from agility_ref.observation import SCANDOT_STD, Mirror

import numpy as np
import torch


@dataclass(frozen=True)
class PPOConfig:
    """Hyper-parameters, the same for every policy of Table 1 unless said otherwise."""

    num_envs: int = 256  # robots simulated side by side; usual 64 to 4096
    num_steps: int = 16  # steps per robot and iteration; usual 16 to 64
    update_epochs: int = 4  # passes over the batch per iteration; usual 3 to 10
    num_minibatches: int = 4  # minibatches per pass; usual 2 to 8
    gamma: float = 0.99  # discount per step of 40 ms, of all but walk (walk-gamma); usual 0.97 to 0.995
    gae_lambda: float = 0.95  # weight of longer returns in the advantage; usual 0.9 to 0.97
    clip_coef: float = 0.2  # how far the policy ratio may move before its gradient stops; usual 0.1 to 0.3
    ent_coef: float = 0.005  # weight of the entropy bonus; usual 0 to 0.01
    max_grad_norm: float = 1.0  # gradients of actor and of critic are each scaled down to this norm; usual 0.5 to 1
    learning_rate: float = 1e-3  # start of the adaptive step size; usual 3e-4 to 1e-3
    learning_rate_min: float = 1.5e-4  # its floor; 1e-5 stalls at batches of 4096
    learning_rate_max: float = 3e-3  # its ceiling
    critic_learning_rate: float = 0.0  # step size of the critic, usual 5e-4 to 1e-3; 0 for the actor's of the moment
    target_kl: float = 0.02  # KL divergence per minibatch that the step size is steered to; usual 0.005 to 0.02
    init_std: float = 0.8  # standard deviation of the first policy; usual 0.5 to 1
    final_std: float = 0.2  # the deviation may not exceed a line from init_std to this; usual 0.1 to 0.3
    anneal_share: float = 0.25  # last share of the steps in which KL target and floor fall to zero; 0 for never
    hidden: tuple[int, ...] = (256, 128)  # units per hidden layer of actor and critic; even numbers, usual 64 to 512

    def __post_init__(self):
        require_at_least(
            1, MANY, num_envs=self.num_envs, num_steps=self.num_steps, update_epochs=self.update_epochs,
            num_minibatches=self.num_minibatches,
        )  # fmt: skip
        require_at_least(1e-9, init_std=self.init_std, final_std=self.final_std, learning_rate=self.learning_rate)
        if self.num_minibatches > self.batch_size:
            raise UserError(f"num-minibatches must be at most {self.batch_size} steps, not {self.num_minibatches}")
        require_pairs(self.hidden)

    @property
    def batch_size(self) -> int:
        """Environment steps per iteration."""
        return self.num_envs * self.num_steps


@dataclass
class Learner:
    """What training changes: network, normaliser, optimisers, counters."""

    net: ActorCritic
    normalizer: Normalizer
    config: PPOConfig
    seed: int = 0
    learning_rate: float = field(init=False)
    steps: int = 0  # environment steps so far, warm start included
    start: int = 0  # of these, the warm start's
    actor_start: int = 0  # environment steps up to which the critic learns alone, after a start without critic
    anneal: float = 1.0  # factor of KL target and floor of the step size, see schedule

    def __post_init__(self):
        self.learning_rate = self.config.learning_rate
        # Actor and critic share no weights: each has its optimiser and its gradient norm, so the
        # weight of the value loss in the textbook's sum has nothing left to balance.
        actor = [*self.net.actor.parameters(), self.net.log_std]
        self.actor_optimizer = torch.optim.Adam(actor, self.learning_rate, fused=True)
        self.critic_optimizer = torch.optim.Adam(self.net.critic.parameters(), self.learning_rate, fused=True)
        self.generator = torch.Generator().manual_seed(self.seed)

    @classmethod
    def create(
        cls, obs_mirror: Mirror, act_mirror: Mirror, config: PPOConfig, seed: int,
        discrete: bool = False, fixed: slice = slice(0, 0),
    ) -> "Learner":  # fmt: skip
        """Start from scratch; ``fixed`` observations are not normalised but divided by SCANDOT_STD."""
        torch.manual_seed(seed)
        net = ActorCritic(obs_mirror, act_mirror, config.hidden, config.init_std, discrete)
        return cls(net, Normalizer(obs_mirror, fixed, SCANDOT_STD), config, seed)

    @property
    def actor_rests(self) -> bool:
        """Whether the critic still learns alone."""
        return self.steps < self.actor_start

    def observe(self, observation: np.ndarray) -> torch.Tensor:
        """Normalise observations (n, obs_dim) and split them into even and odd part, as the networks take them."""
        return self.net.actor.parts(torch.from_numpy(self.normalizer(observation)))


def gae(
    rewards: np.ndarray, values: np.ndarray, next_values: np.ndarray,
    terminated: np.ndarray, truncated: np.ndarray, gamma: float, gae_lambda: float,
) -> np.ndarray:  # fmt: skip
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


def normalize_advantages(advantages: np.ndarray, kinds: np.ndarray) -> np.ndarray:
    """Bring advantages (T, N) to mean 0 and variance 1 within each kind of course, ``kinds`` (T, N).

    Together, the kind on which rewards vary most would drown the others.
    """
    normalized = np.zeros_like(advantages)
    for kind in np.unique(kinds):
        a = advantages[kinds == kind]
        normalized[kinds == kind] = (a - a.mean()) / (a.std() + 1e-8)
    return normalized


def policy_loss(
    log_prob: torch.Tensor, old_log_prob: torch.Tensor, advantage: torch.Tensor, clip_coef: float
) -> torch.Tensor:
    """Clipped surrogate (Schulman et al. 2017, equation 7), to be minimised; inputs (n,)."""
    # r = pi(a|s) / pi_old(a|s);  L = -mean(min(r A, clip(r, 1 - eps, 1 + eps) A))
    ratio = torch.exp(log_prob - old_log_prob)
    clipped = torch.clamp(ratio, 1.0 - clip_coef, 1.0 + clip_coef)
    return -torch.min(ratio * advantage, clipped * advantage).mean()


def adapt_learning_rate(rate: float, kl: float, config: PPOConfig, anneal: float = 1.0) -> float:
    """Divide the step size by 1.5 where KL is above twice the target, multiply it below half of the target.

    ``anneal``, from 1 down to 0, scales the target and the lowest step size.
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

    observations: np.ndarray  # (T, N, obs_dim) before normalisation, for the normaliser
    parts: torch.Tensor  # even and odd part of the normalised observations
    outputs: torch.Tensor  # of the actor: the mean, or the logits, ...
    std: torch.Tensor  # ... and (act_dim,) the deviation with which each action was drawn
    actions: torch.Tensor
    rewards: np.ndarray
    values: np.ndarray
    next_values: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    kinds: np.ndarray  # kind of course of each step
    episodes: list[dict]  # one entry per episode that ended: reward, length, waypoints, edge


@dataclass
class Batch:
    """A minibatch of n steps, arrays (n, ...)."""

    parts: torch.Tensor
    actions: torch.Tensor
    advantages: torch.Tensor
    returns: torch.Tensor  # targets of the critic
    outputs: torch.Tensor  # of the actor that drew the actions ...
    log_prob: torch.Tensor  # ... and what it gave them


@torch.inference_mode()
def collect(env, learner: Learner, observation: np.ndarray) -> tuple[Rollout, np.ndarray]:
    """Run the policy for num_steps; return the rollout and the next observation (N, obs_dim)."""
    net, T, N = learner.net, learner.config.num_steps, learner.config.num_envs
    std = net.std()
    observations, rewards = np.zeros((T, *observation.shape), np.float32), np.zeros((T, N), np.float32)
    terminated, truncated, kinds = np.zeros((T, N), bool), np.zeros((T, N), bool), np.zeros((T, N), int)
    parts, outputs, actions, episodes, cut_short = [], [], [], [], []
    for t in range(T):
        observations[t] = observation
        parts.append(learner.observe(observation))
        outputs.append(net.actor(parts[t]))
        actions.append(sample(net.distribution(outputs[t], std), learner.generator))
        observation, rewards[t], terminated[t], truncated[t], info = env.step(actions[t].numpy())
        kinds[t] = info["kind"]
        for i in np.flatnonzero(terminated[t] | truncated[t]):
            episodes.append({key: value[i] for key, value in info["totals"].items()})
        cut_short += [(t, i, info["final_obs"][i]) for i in np.flatnonzero(truncated[t])]
    parts = torch.stack(parts)
    values = net.value(parts.flatten(0, 1)).view(T, N).numpy()
    next_values = np.concatenate([values[1:], net.value(learner.observe(observation)).numpy()[None]])
    if cut_short:
        t, i, final = zip(*cut_short, strict=True)
        next_values[list(t), list(i)] = net.value(learner.observe(np.stack(final))).numpy()
    rollout = Rollout(
        observations, parts, torch.stack(outputs), std, torch.stack(actions),
        rewards, values, next_values, terminated, truncated, kinds, episodes,
    )  # fmt: skip
    return rollout, observation


def update_actor(learner: Learner, batches: list[Batch], old_std: torch.Tensor) -> dict[str, float]:
    """Take one gradient step on the policy per minibatch and pass; return mean losses, KL and clip fraction."""
    c, net = learner.config, learner.net
    sums = {"policy_loss": 0.0, "entropy": 0.0, "kl": 0.0, "clip_fraction": 0.0}
    for mb in [] if learner.actor_rests else batches * c.update_epochs:
        new = net.distribution(net.actor(mb.parts), net.std())
        log_prob, entropy = new.log_prob(mb.actions), new.entropy().mean()
        with torch.no_grad():
            kl = float(kl_divergence(net.distribution(mb.outputs, old_std), new).mean())
            clip_fraction = ((log_prob - mb.log_prob).exp() - 1).abs().gt(c.clip_coef).float().mean()
        learner.learning_rate = adapt_learning_rate(learner.learning_rate, kl, c, learner.anneal)
        pg_loss = policy_loss(log_prob, mb.log_prob, mb.advantages, c.clip_coef)
        _descend(learner.actor_optimizer, learner.learning_rate, pg_loss - c.ent_coef * entropy, c.max_grad_norm)
        for key, value in zip(sums, (pg_loss.detach(), entropy.detach(), kl, clip_fraction), strict=True):
            sums[key] += float(value) / (len(batches) * c.update_epochs)
    return sums


def update_critic(learner: Learner, batches: list[Batch], learning_rate: float) -> dict[str, float]:
    """Take one gradient step on the value per minibatch and pass; return the mean loss."""
    c, total = learner.config, 0.0
    for mb in batches * c.update_epochs:
        # L = mean((V(s) - R)^2) / 2
        loss = 0.5 * ((learner.net.value(mb.parts) - mb.returns) ** 2).mean()
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


def update(learner: Learner, rollout: Rollout) -> dict[str, float]:
    """One PPO update; return the mean losses, KL and clip fraction.

    Actor and critic share no weights, so they learn side by side, each in a thread of its own, in
    which the libraries start no others: two cores stay busy, and their timing changes no bit.
    """
    c, r = learner.config, rollout
    advantages = gae(r.rewards, r.values, r.next_values, r.terminated, r.truncated, c.gamma, c.gae_lambda)
    returns = torch.from_numpy(advantages + r.values).flatten()
    advantages = torch.from_numpy(normalize_advantages(advantages, r.kinds)).flatten()
    parts, outputs, actions = (x.flatten(0, 1) for x in (r.parts, r.outputs, r.actions))
    log_prob = learner.net.distribution(outputs, r.std).log_prob(actions)
    # Dealt out once and not anew every pass: gathering rows is a tenth of the update.
    batches = [
        Batch(parts[i], actions[i], advantages[i], returns[i], outputs[i], log_prob[i])
        for i in torch.randperm(len(parts), generator=learner.generator).chunk(c.num_minibatches)
    ]
    with ThreadPoolExecutor(2, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        # The critic keeps the step size of the start, the actor steers it by the KL divergence.
        rate = c.critic_learning_rate or (c.learning_rate if learner.actor_rests else learner.learning_rate)
        critic = pool.submit(update_critic, learner, batches, rate)
        actor = pool.submit(update_actor, learner, batches, r.std)
    learner.normalizer.update(r.observations.reshape(-1, r.observations.shape[-1]))
    return actor.result() | critic.result()


def train(
    env, learner: Learner, total_steps: int, stop: Callable[[], bool] = lambda: False, obs: np.ndarray | None = None
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
        yield {
            "steps": learner.steps,
            "steps_per_second": learner.config.batch_size / (time.perf_counter() - start),
            "learning_rate": learner.learning_rate,
            "std": float(learner.net.std().detach().mean()),
            "episodes": rollout.episodes,
            **losses,
        }

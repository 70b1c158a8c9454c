"""PPO in one file, in the manner of CleanRL: read it from top to bottom.

    pip install "agility-ref[gym]"
    python examples/cleanrl_ppo.py --total-timesteps 2000000

The names are CleanRL's (docs/names.md).  Two things are done otherwise, on purpose: an episode that
ran out of time is continued with the value of its true last observation, and the normaliser of the
observations is part of the agent.
"""

import agility_ref.gym  # noqa: F401  registers the ids, and comes before numpy

# isort: split

import time
from collections import deque
from dataclasses import dataclass

from agility_ref.env import TRAINING
from agility_ref.terrain import NUM_WAYPOINTS

import gymnasium
import numpy as np
import torch
import tyro
from torch import nn


@dataclass(frozen=True)
class Args:
    """Train PPO, all in one file."""

    env_id: str = "Go1Walk-v0"
    """Environment; also Go1ClimbUp, Go1ClimbDown, Go1Climb, Go1Gap, Go1Beam and Go1ClimbGap, all -v0."""
    difficulty: tuple[float, float] = (0.0, 0.4)
    """Courses are spread evenly between these two."""
    total_timesteps: int = 2_000_000
    """Environment steps of all robots together."""
    seed: int = 0
    """Of episodes, networks and exploration."""
    num_envs: int = 256
    """Robots in the simulator."""
    num_steps: int = 16
    """Steps of every robot between two updates."""
    update_epochs: int = 4
    """Passes over a batch."""
    num_minibatches: int = 4
    """Minibatches of a pass."""
    learning_rate: float = 1e-3
    """Adam's at the start; it falls to zero on a straight line."""
    gamma: float = 0.98
    """Discount of a step."""
    gae_lambda: float = 0.95
    """Decay of the advantages' eligibility."""
    clip_coef: float = 0.2
    """The ratio of probabilities counts within 1 +- this."""
    ent_coef: float = 0.005
    """Weight of the entropy."""
    vf_coef: float = 0.5
    """Weight of the critic's loss."""
    target_kl: float = 0.1
    """The passes over a batch end when the policy has moved as far as this, in estimated KL divergence."""
    max_grad_norm: float = 1.0
    """Gradients are clipped to this length."""
    init_std: float = 0.2
    """First standard deviation of an action; an action of 1 is 1.2 rad."""


def layer_init(layer: nn.Linear, gain: float = 2**0.5) -> nn.Linear:
    """Draw orthogonal weights and set the bias to zero."""
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


class Agent(nn.Module):
    """Actor, critic, and running mean and variance of what they see."""

    def __init__(self, obs_dim: int, act_dim: int, init_std: float):
        super().__init__()
        self.register_buffer("mean", torch.zeros(obs_dim))
        self.register_buffer("var", torch.ones(obs_dim))
        self.register_buffer("count", torch.tensor(1e-4))
        self.actor, self.critic = (
            nn.Sequential(
                layer_init(nn.Linear(obs_dim, 256)), nn.ELU(),
                layer_init(nn.Linear(256, 128)), nn.ELU(),
                layer_init(nn.Linear(128, outputs), gain),
            )
            for outputs, gain in ((act_dim, 0.01), (1, 1.0))  # the first policy stays close to the home pose
        )  # fmt: skip
        self.log_std = nn.Parameter(torch.full((act_dim,), init_std).log())

    def update_normalizer(self, obs: torch.Tensor) -> None:
        """Join the mean and variance of a batch (n, obs_dim) to those so far."""
        n, delta = len(obs), obs.mean(0) - self.mean
        total = self.count + n
        # sum of squares of both parts, and of the distance between their means
        squares = self.var * self.count + obs.var(0, correction=0) * n + delta**2 * self.count * n / total
        self.mean, self.var, self.count = self.mean + delta * n / total, squares / total, total

    def normalize(self, obs: torch.Tensor) -> torch.Tensor:
        """Return observations as both networks see them."""
        # 0.1 m more under the root: on nearly flat ground the 132 scandots would else be blown up to noise of size 1
        return ((obs - self.mean) / (self.var + 0.1**2).sqrt()).clamp(-5, 5)

    def distribution(self, x: torch.Tensor) -> torch.distributions.Normal:
        """Return the policy at normalised observations."""
        return torch.distributions.Normal(self.actor(x), self.log_std.exp())

    def value(self, x: torch.Tensor) -> torch.Tensor:
        """Return V at normalised observations."""
        return self.critic(x).squeeze(-1)


def main(args: Args) -> float:
    """Train; return the waypoint fraction of the last 100 episodes."""
    torch.set_num_threads(1)
    torch.manual_seed(args.seed)
    envs = gymnasium.make_vec(
        args.env_id, num_envs=args.num_envs, difficulty=args.difficulty, config=TRAINING, autoreset_mode="SameStep"
    )
    agent = Agent(envs.single_observation_space.shape[0], envs.single_action_space.shape[0], args.init_std)
    optimizer = torch.optim.Adam(agent.parameters(), args.learning_rate, eps=1e-5)
    T, N = args.num_steps, args.num_envs
    obs = torch.zeros(T, N, len(agent.mean))  # normalised as they were when the robot acted
    actions = torch.zeros(T, N, len(agent.log_std))
    logprobs, rewards, values, next_values, terminations, dones = torch.zeros(6, T, N)
    waypoints: deque[float] = deque(maxlen=100)
    start, iterations = time.perf_counter(), max(1, args.total_timesteps // (T * N))

    seen = torch.from_numpy(envs.reset(seed=args.seed)[0])
    for iteration in range(1, iterations + 1):
        # --- rollout
        with torch.no_grad():
            for t in range(T):
                agent.update_normalizer(seen)
                obs[t] = agent.normalize(seen)
                policy = agent.distribution(obs[t])
                actions[t] = policy.sample()
                logprobs[t] = policy.log_prob(actions[t]).sum(-1)
                step = envs.step(actions[t].clamp(-1, 1).numpy())
                seen, rewards[t], terminations[t], truncations, info = map_arrays(step)
                dones[t] = torch.maximum(terminations[t], truncations.float())
                last = seen.clone()  # with the true last observations where an episode ended
                for i in np.flatnonzero(dones[t]):
                    last[i] = torch.from_numpy(info["final_obs"][i])
                    waypoints.append(info["final_info"]["totals"]["waypoints"][i] / NUM_WAYPOINTS)
                values[t], next_values[t] = agent.value(obs[t]), agent.value(agent.normalize(last))

            # --- advantages: delta = r + gamma V(s') (1 - terminated) - V(s), A = delta + gamma lambda (1 - done) A'
            advantages = torch.zeros(T, N)
            later = torch.zeros(N)
            for t in reversed(range(T)):
                delta = rewards[t] + args.gamma * next_values[t] * (1 - terminations[t]) - values[t]
                later = advantages[t] = delta + args.gamma * args.gae_lambda * (1 - dones[t]) * later
            returns = advantages + values

        # --- update
        optimizer.param_groups[0]["lr"] = args.learning_rate * (1 - (iteration - 1) / iterations)
        b_obs, b_actions, b_logprobs, b_advantages, b_returns = (
            x.flatten(0, 1) for x in (obs, actions, logprobs, advantages, returns)
        )
        for _ in range(args.update_epochs):
            for mb in torch.randperm(T * N).chunk(args.num_minibatches):
                policy = agent.distribution(b_obs[mb])
                logratio = policy.log_prob(b_actions[mb]).sum(-1) - b_logprobs[mb]
                ratio = logratio.exp()
                mb_advantages = (b_advantages[mb] - b_advantages[mb].mean()) / (b_advantages[mb].std() + 1e-8)
                clipped = ratio.clamp(1 - args.clip_coef, 1 + args.clip_coef)
                pg_loss = -torch.minimum(mb_advantages * ratio, mb_advantages * clipped).mean()
                v_loss = 0.5 * (agent.value(b_obs[mb]) - b_returns[mb]).pow(2).mean()
                entropy = policy.entropy().sum(-1).mean()
                optimizer.zero_grad()
                (pg_loss + args.vf_coef * v_loss - args.ent_coef * entropy).backward()
                nn.utils.clip_grad_norm_(agent.parameters(), args.max_grad_norm)
                optimizer.step()
            with torch.no_grad():
                if (ratio - 1 - logratio).mean() > args.target_kl:  # http://joschu.net/blog/kl-approx.html
                    break
        if iteration % 10 == 0 and waypoints:
            print(f"{iteration * T * N:9} steps   waypoints {np.mean(waypoints):.2f}", flush=True)
    reached = float(np.mean(waypoints)) if waypoints else 0.0
    print(f"{iterations * T * N} steps in {time.perf_counter() - start:.0f} s: waypoints {reached:.2f}")
    envs.close()
    return reached


def map_arrays(step: tuple) -> tuple:
    """Turn the arrays of a step into tensors; the info stays as it is."""
    return *(torch.from_numpy(x) for x in step[:-1]), step[-1]


if __name__ == "__main__":
    main(tyro.cli(Args))

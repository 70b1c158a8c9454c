"""A robot learns to walk with your pieces.  Complete; ``python -m hw3.train`` runs it.

The Go1 of ``agility_ref`` on level ground, blind (without scandots), without noise and pushes: a task that PPO solves in
minutes on two cores.
"""

from agility_ref.env import EnvConfig, Go1Env
from agility_ref.observation import SCANDOTS
from agility_ref.terrain import make_course
from agility_ref.world import World
from hw3.network import Policy
from hw3.ppo import Batch

import adapters  # before numpy: it imports agility_ref
import numpy as np
import torch

ROBOTS, STEPS = 256, 16
STEPS_IN_ALL = 600_000  # the grader's budget is in tests/training.csv
OBS, ACT = SCANDOTS.start, 12
TASK = EnvConfig(episode_seconds=8.0).clean()


def collect(env: Go1Env, policy: Policy, normaliser: adapters.Normaliser, obs: np.ndarray, generator, config):
    """Run the policy for STEPS; return the batch, all raw observations and the next one."""
    raw, seen, actions, log_probs, rewards, ends = [], [], [], [], [], []
    final_values = np.full((ROBOTS, STEPS), np.nan)
    std = policy.log_std.exp()
    with torch.no_grad():
        for t in range(STEPS):
            raw.append(obs)
            seen.append(torch.from_numpy(normaliser(obs)))
            mean = policy.mean(seen[-1])
            actions.append(mean + std * torch.randn(mean.shape, generator=generator))
            log_probs.append(policy.log_prob(seen[-1], actions[-1]))
            full, reward, terminated, truncated, info = env.step(actions[-1].numpy())
            obs = full[:, :OBS]
            rewards.append(reward)
            ends.append(np.select([terminated, truncated], [adapters.TERMINATED, adapters.TRUNCATED], adapters.RUNNING))
            if truncated.any():
                last = torch.from_numpy(normaliser(info["final_obs"][truncated][:, :OBS]))
                final_values[truncated, t] = policy.value(last).numpy()
        states = torch.stack([*seen, torch.from_numpy(normaliser(obs))], dim=1)  # (N, T + 1, OBS)
        values = policy.value(states.flatten(0, 1)).view(ROBOTS, -1).numpy()
    advantage, target = adapters.gae(
        np.stack(rewards, 1), values, final_values, np.stack(ends, 1), config.gamma, config.lam
    )
    flat = [torch.from_numpy(np.ascontiguousarray(a, np.float32)).flatten() for a in (advantage, target)]
    batch = Batch(
        states[:, :-1].flatten(0, 1), torch.stack(actions, 1).flatten(0, 1), torch.stack(log_probs, 1).flatten(), *flat
    )
    return batch, np.concatenate(raw), obs


def train(steps: int, seed: int, report=lambda **_: None) -> tuple[Policy, adapters.Normaliser, float]:
    """Train for a number of environment steps.

    Returns policy, normaliser, and how fast the robots went ahead in the last tenth of the training [m/s]: the mean
    over all of them, those that have just begun or fallen included, with the noise by which they explore.

    ``report`` is called after every iteration with what it did.
    """
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    generator = torch.Generator().manual_seed(seed)
    config = adapters.Config()
    env = Go1Env(World([make_course("walk", 0.0, seed)]), ROBOTS, TASK, seed=seed)
    policy, normaliser = Policy(OBS, ACT), adapters.Normaliser(OBS)
    optimiser = torch.optim.Adam(policy.parameters(), 1e-3)
    obs = env.reset(seed)[0][:, :OBS]
    normaliser.update(obs)
    speeds = []
    for done in range(0, steps, ROBOTS * STEPS):
        batch, raw, obs = collect(env, policy, normaliser, obs, generator, config)
        kl = adapters.update(policy, optimiser, batch, config, generator)
        normaliser.update(raw)
        speeds.append(raw[:, 0].mean())  # an observation begins with the trunk's velocity ahead
        with torch.no_grad():  # explore less and less
            policy.log_std.clamp_(max=float(np.log(0.6 - 0.35 * done / steps)))
        report(
            steps=done + ROBOTS * STEPS,
            kl=kl,
            rate=optimiser.param_groups[0]["lr"],
            policy=policy,
            normaliser=normaliser,
            speed=speeds[-1],
        )
    return policy, normaliser, float(np.mean(speeds[-(len(speeds) // 10) :]))


def distance(policy: Policy, normaliser: adapters.Normaliser, seed: int = 0) -> float:
    """Return how far the mean action gets within 8 s or until a fall [m], mean over 32 robots."""
    env = Go1Env(World([make_course("walk", 0.0, seed)]), 32, TASK, seed=seed)
    obs, _ = env.reset(seed)
    alive, start = np.ones(32, bool), env.base_pos[:, 0]
    x = start.copy()
    while alive.any():
        x[alive] = env.base_pos[alive, 0]
        with torch.no_grad():
            action = policy.mean(torch.from_numpy(normaliser(obs[:, :OBS]))).numpy()
        obs, _, terminated, truncated, _ = env.step(action)
        alive &= ~(terminated | truncated)
    return float((x - start).mean())


def main() -> None:
    """Train with the budget of the grader and say every twenty iterations how far the robot gets."""
    log = iter(range(10**6))

    def report(steps, kl, rate, policy, normaliser, speed):
        if next(log) % 20 == 19:
            print(
                f"{steps:8} steps  KL {kl:.4f}  step size {rate:.1e}  speed {speed:.3f} m/s  distance {distance(policy, normaliser):.2f} m",
                flush=True,
            )

    policy, normaliser, speed = train(STEPS_IN_ALL, 0, report)
    print(f"speed {speed:.3f} m/s, distance without noise {distance(policy, normaliser):.2f} m")


if __name__ == "__main__":
    main()

"""Hidden tests: the pieces against agility_ref and closed forms."""

from agility_ref import ppo

import adapters
import numpy as np
import pytest
import torch
from adapters import RUNNING, TERMINATED, TRUNCATED
from hw3.network import Policy
from hw3.ppo import Batch


def rollout(seed, robots=5, steps=40):
    rng = np.random.default_rng(seed)
    ends = rng.choice([RUNNING, TERMINATED, TRUNCATED], (robots, steps), p=[0.84, 0.08, 0.08])
    ends[:, -1] = (seed + np.arange(robots)) % 3
    final = np.where(ends == TRUNCATED, rng.normal(size=(robots, steps)), np.nan)
    return rng.normal(size=(robots, steps)), rng.normal(size=(robots, steps + 1)), final, ends


def test_gae_of_random_rollouts(seed):
    rewards, values, final, ends = rollout(seed)
    advantage, target = adapters.gae(rewards, values, final, ends, 0.97, 0.9)
    following = np.where(ends == TRUNCATED, final, values[:, 1:])
    expected = ppo.gae(
        rewards.T, values[:, :-1].T, following.T, (ends == TERMINATED).T, (ends == TRUNCATED).T, 0.97, 0.9
    ).T
    assert np.isfinite(advantage).all(), "final_values is NaN where no episode was truncated: NaN times 0 is NaN"
    wrong = np.argwhere(~np.isclose(advantage, expected))
    assert not len(wrong), (
        f"{len(wrong)} of 200 advantages differ, last of robot and step {wrong[-1]}, which ended {ends[tuple(wrong[-1])]}"
    )
    assert np.allclose(target, expected + values[:, :-1]), "targets are advantages + values"


def test_gae_of_lambda_one(seed):
    """With lambda = 1 the target is the discounted return."""
    rewards, values, final, ends = rollout(seed, robots=3, steps=6)
    ends[:], final[:] = RUNNING, np.nan
    _, target = adapters.gae(rewards, values, final, ends, 0.9, 1.0)
    expected = (rewards * 0.9 ** np.arange(6)).sum(axis=1) + 0.9**6 * values[:, -1]
    assert np.allclose(np.asarray(target)[:, 0], expected), (
        "with lambda 1 the first target is the discounted sum of what was earned"
    )


def test_surrogate_at_random(seed):
    g = torch.Generator().manual_seed(seed)
    new, old, advantage = (torch.randn(500, generator=g) * scale for scale in (0.3, 0.3, 1.0))
    new.requires_grad_()
    got = adapters.surrogate(new, old, advantage, 0.15)
    expected = -ppo.policy_loss(new, old, advantage, 0.15)
    value, right = float(got.detach()), float(expected.detach())
    assert value == pytest.approx(right, abs=1e-5), f"{value:.5f}, not {right:.5f}"
    got.backward()
    ratio = (new - old).exp().detach()
    stopped = ((ratio > 1.15) & (advantage > 0)) | ((ratio < 0.85) & (advantage < 0))
    assert new.grad is not None and bool((new.grad[stopped] == 0).all()), (
        "no gradient where the ratio has moved far enough"
    )
    assert bool((new.grad[~stopped] != 0).all()), (
        "a ratio that moved the wrong way must be pulled back: its gradient is 0"
    )


def test_rate_stays_inside(seed):
    rng = np.random.default_rng(seed)
    c = adapters.Config(target_kl=0.01, lowest_rate=2e-5, highest_rate=5e-3)
    rate = 1e-3
    for kl in 10 ** rng.uniform(-4, 0, 200):
        new = adapters.next_rate(rate, kl, c)
        factor = 1 / 1.2 if kl > 0.02 else 1.2 if kl < 0.005 else 1.0
        expected = min(max(rate * factor, 2e-5), 5e-3)
        assert new == pytest.approx(expected), (
            f"KL {kl:.4f}, target 0.01, step size {rate:.2e}: {expected:.2e}, not {new:.2e}"
        )
        rate = new


def test_normaliser_of_batches(seed):
    rng = np.random.default_rng(seed)
    data = rng.normal(rng.normal(size=6) * 5, rng.uniform(0.1, 3, 6), (1000, 6))
    n = adapters.Normaliser(6)
    for part in np.split(data, [1, 10, 400, 650]):
        n.update(part)
    assert n.count == 1000 and np.allclose(n.mean, data.mean(axis=0)), (
        "batches of 1, 9, 390, 250, 350: the mean is not that of all"
    )
    assert np.allclose(n.variance, data.var(axis=0)), (
        f"batches of 1, 9, 390, 250, 350: variance {n.variance[0]:.4f}, of all {data.var(axis=0)[0]:.4f}; do means of batches differ, too?"
    )


def test_normaliser_of_large_numbers(seed):
    data = (1e4 + np.random.default_rng(seed).normal(size=(6000, 3))).astype(np.float32)
    n = adapters.Normaliser(3)
    for part in np.split(data, 20):
        n.update(part)
    expected = data.astype(np.float64).var(axis=0)
    assert np.allclose(n.variance, expected, rtol=1e-6), (
        f"numbers around 1e4 with variance {expected[0]:.5f} seem to have {n.variance[0]:.5f}: float64, and no difference of large squares"
    )


def problem(seed, n=240):
    """Actions in one state; better the nearer they are to (1, -1)."""
    torch.manual_seed(seed)
    policy = Policy(3, 2)
    obs = torch.randn(n, 3)
    with torch.no_grad():
        action = policy.mean(obs) + policy.log_std.exp() * torch.randn(n, 2)
        log_prob = policy.log_prob(obs, action)
    advantage = -((action - torch.tensor([1.0, -1.0])) ** 2).sum(-1)
    return policy, dict(obs=obs, action=action, log_prob=log_prob, advantage=advantage, target=3 + obs[:, 0])


def run(seed, optimiser=None, spy=None, config=None, **changes):
    policy, fields = problem(seed)
    if spy:
        spy(policy, fields)
    optimiser = (optimiser or (lambda p: torch.optim.Adam(p, 1e-3)))(policy.parameters())
    kl = adapters.update(
        policy, optimiser, Batch(**fields | changes), config or adapters.Config(), torch.Generator().manual_seed(seed)
    )
    return policy, fields, optimiser, kl


def test_update_uses_every_sample(seed):
    seen = []

    def spy(policy, fields):
        original = policy.log_prob
        policy.log_prob = lambda obs, action: (seen.append(obs[:, 0].detach().clone()), original(obs, action))[1]

    _, fields, _, _ = run(seed, spy=spy, config=adapters.Config(epochs=3, minibatches=4))
    assert len(seen) == 12, f"3 passes of 4 minibatches are 12 steps, not {len(seen)}"
    assert all(len(part) == 60 for part in seen), f"240 samples in 4 minibatches: {[len(part) for part in seen]}"
    passes = [torch.cat(seen[k : k + 4]) for k in (0, 4, 8)]
    everything = fields["obs"][:, 0].sort().values
    assert all(torch.equal(p.sort().values, everything) for p in passes), "in a pass each sample is used exactly once"
    assert not torch.equal(passes[0], passes[1]), "shuffle anew in each pass"


def test_update_normalises_advantages(seed):
    _, fields, _, _ = run(seed)
    plain, scaled = (
        run(seed, advantage=a)[0].actor[4].weight for a in (fields["advantage"], 50 * fields["advantage"] + 700)
    )
    assert torch.allclose(plain, scaled, atol=1e-4), (
        "50 A + 700 says the same as A: normalise advantages over the batch"
    )


def test_update_clips_gradients(seed):
    def norm(policy, before):
        return sum(((p - b) ** 2).sum() for p, b in zip(policy.parameters(), before, strict=True)).sqrt()

    before = []
    config = adapters.Config(epochs=1, minibatches=1, max_grad_norm=0.01)
    policy, _, _, _ = run(
        seed,
        lambda p: torch.optim.SGD(p, 1.0),
        lambda policy, _: before.extend(p.detach().clone() for p in policy.parameters()),
        config,
    )
    got = float(norm(policy, before))
    assert got == pytest.approx(0.01, rel=0.01), (
        f"one step of size 1 along a gradient cut to 0.01 moves by 0.01, not by {got:.4f}"
    )


def test_update_improves(seed):
    policy, fields, _, _ = run(seed, config=adapters.Config(epochs=30, target_kl=1.0, entropy=0.0))
    start, _ = problem(seed)
    with torch.no_grad():
        moved = (policy.mean(fields["obs"]) - start.mean(fields["obs"])).mean(dim=0)
        before, after = (((p.value(fields["obs"]) - fields["target"]) ** 2).mean() for p in (start, policy))
    assert moved[0] > 0.02 and moved[1] < -0.02, (
        f"good actions lie at (1, -1), but the mean moved by {moved.numpy().round(3)}"
    )
    assert after < 0.8 * before, f"the error of the value goes from {before:.3f} to {after:.3f}"


def test_update_steers_the_step_size(seed):
    _, _, optimiser, kl = run(seed, config=adapters.Config(target_kl=10.0))
    rate = optimiser.param_groups[0]["lr"]
    assert rate == pytest.approx(3e-3), (
        f"far below the target of KL the step size rises to its highest, 3e-3, not {rate:.2e}"
    )
    assert 0 < kl < 10, f"the KL divergence of the last pass is above 0 and small, not {kl}"
    _, _, optimiser, _ = run(seed, config=adapters.Config(target_kl=1e-9))
    rate = optimiser.param_groups[0]["lr"]
    assert rate < 4e-4, f"far above the target of KL the step size falls at every step, from 1e-3 to {rate:.2e}"

from copy import deepcopy
from dataclasses import replace

from agility_ref.errors import UserError
from agility_ref.observation import Mirror
from agility_ref.policy import Policy
from agility_ref.ppo import (
    Batch,
    Learner,
    PPOConfig,
    adapt_learning_rate,
    collect,
    gae,
    normalize_advantages,
    policy_loss,
    schedule,
    train,
    update,
    update_actor,
)
from agility_ref.training.state import learner_state, policy_arrays

import numpy as np
import pytest
import torch
from line import ACTIONS, CHOICES, LINE, TINY, FakeEnv, make, trained

torch.set_num_threads(1)
YES, NO = True, False


def column(*values):
    return np.array(values, float)[:, None]


def flags(*values):
    return np.array(values, bool)[:, None]


# --- generalised advantage estimation, by hand -----------------------------------------
# Three steps, gamma = 0.9, lambda = 0.5, so gamma lambda = 0.45.
#   r  = 1, 2, 3     V = 10, 20, 30     V(s') = 20, 30, 40 (40 follows the rollout)
#   delta_t = r_t + 0.9 V(s'_t) - V(s_t)
#   delta = 1 + 18 - 10, 2 + 27 - 20, 3 + 36 - 30 = 9, 9, 9

R, V, NEXT = column(1, 2, 3), column(10, 20, 30), column(20, 30, 40)


def by_hand(terminated, truncated, next_values=NEXT):
    return gae(R, V, next_values, flags(*terminated), flags(*truncated), 0.9, 0.5)[:, 0]


def test_gae_without_an_end():
    # A2 = 9
    # A1 = 9 + 0.45 * 9     = 13.05
    # A0 = 9 + 0.45 * 13.05 = 14.8725
    np.testing.assert_allclose(by_hand((NO, NO, NO), (NO, NO, NO)), [14.8725, 13.05, 9.0])


def test_gae_terminated_in_the_middle():
    # A2 = 9
    # A1 = 2 - 20           = -18     no bootstrap, nothing carried over
    # A0 = 9 + 0.45 * (-18) = 0.9
    np.testing.assert_allclose(by_hand((NO, YES, NO), (NO, NO, NO)), [0.9, -18.0, 9.0])


def test_gae_truncated_in_the_middle():
    # V of the true final observation is 25 where the next row's V, of a new episode, is 30
    # A2 = 9
    # A1 = 2 + 0.9 * 25 - 20 = 4.5    bootstrap, nothing carried over
    # A0 = 9 + 0.45 * 4.5    = 11.025
    advantages = by_hand((NO, NO, NO), (NO, YES, NO), column(20, 25, 40))
    np.testing.assert_allclose(advantages, [11.025, 4.5, 9.0])


def test_gae_both_on_one_step_is_terminated():
    both = by_hand((NO, YES, NO), (NO, YES, NO), column(20, 25, 40))
    np.testing.assert_allclose(both, [0.9, -18.0, 9.0])


def test_gae_terminated_on_the_last_step():
    # A2 = 3 - 30 = -27;  A1 = 9 + 0.45 * (-27) = -3.15;  A0 = 9 + 0.45 * (-3.15) = 7.5825
    np.testing.assert_allclose(by_hand((NO, NO, YES), (NO, NO, NO)), [7.5825, -3.15, -27.0])


# --- generalised advantage estimation, by property -------------------------------------


@pytest.fixture
def episode_ends():
    rng = np.random.default_rng(0)
    T, N = 20, 6
    rewards, values, next_values = rng.standard_normal((3, T, N))
    return rewards, values, next_values, rng.random((T, N)) < 0.15, rng.random((T, N)) < 0.15


def test_gae_equals_the_naive_double_sum(episode_ends):
    rewards, values, next_values, terminated, truncated = episode_ends
    gamma, lam = 0.97, 0.9
    T, N = rewards.shape
    expected = np.zeros((T, N))
    for n in range(N):
        for t in range(T):
            for k in range(t, T):  # A_t = sum_k (gamma lambda)^(k - t) delta_k to the end of the episode
                bootstrap = 0.0 if terminated[k, n] else gamma * next_values[k, n]
                expected[t, n] += (gamma * lam) ** (k - t) * (rewards[k, n] + bootstrap - values[k, n])
                if terminated[k, n] or truncated[k, n]:
                    break
    np.testing.assert_allclose(gae(*episode_ends, gamma, lam), expected, rtol=1e-10, atol=1e-12)


def test_gae_lambda_one_is_discounted_returns_minus_values():
    rng = np.random.default_rng(1)
    rewards, values = rng.standard_normal((2, 10, 1))
    after = 0.7
    next_values = np.append(values[1:, 0], after)[:, None]
    never = np.zeros((10, 1), bool)
    # G_t = r_t + gamma G_{t+1}, G_T = V(s_T)
    returns, following = np.zeros(10), after
    for t in reversed(range(10)):
        following = returns[t] = rewards[t, 0] + 0.95 * following
    advantages = gae(rewards, values, next_values, never, never, 0.95, 1.0)
    np.testing.assert_allclose(advantages[:, 0], returns - values[:, 0], rtol=1e-10)


def test_gae_lambda_zero_is_the_td_error(episode_ends):
    rewards, values, next_values, terminated, _ = episode_ends
    td = rewards - values + 0.97 * np.where(terminated, 0.0, next_values)
    np.testing.assert_allclose(gae(*episode_ends, 0.97, 0.0), td, rtol=1e-10)


def test_gae_robots_are_independent(episode_ends):
    together = gae(*episode_ends, 0.97, 0.9)
    alone = [gae(*(x[:, n : n + 1] for x in episode_ends), 0.97, 0.9) for n in range(6)]
    np.testing.assert_array_equal(together, np.concatenate(alone, axis=1))


# --- rollout ---------------------------------------------------------------------------


def test_collect_bootstraps_with_the_true_final_observation():
    learner, env = make(), FakeEnv(limit=5)
    obs, _ = env.reset(0)
    finals = []
    step = env.step

    def noting(action):
        out = step(action)
        finals.append(out[4]["final_obs"])
        return out

    env.step = noting
    rollout, after = collect(env, learner, obs)

    def value(x):
        with torch.no_grad():
            return learner.net.value(learner.observe(x)).numpy()

    assert rollout.truncated.sum() > 8
    for t in range(TINY.num_steps):
        following = rollout.observations[t + 1] if t + 1 < TINY.num_steps else after
        expected = np.where(rollout.truncated[t], value(finals[t]), value(following))
        np.testing.assert_allclose(rollout.next_values[t], expected, atol=1e-6)
        cut = rollout.truncated[t]
        assert (np.abs(value(finals[t]) - value(following))[cut] > 1e-6).all()  # and the two differ


def test_collect_returns_what_happened():
    learner, env = make(), FakeEnv(limit=5)
    obs, _ = env.reset(0)
    rollout, after = collect(env, learner, obs)
    assert rollout.parts.shape == (16, 8, 2) and rollout.actions.shape == (16, 8, 2)
    np.testing.assert_array_equal(rollout.observations[0], obs)
    np.testing.assert_array_equal(after, env._observe())
    assert len(rollout.episodes) == (rollout.terminated | rollout.truncated).sum()
    assert {"reward", "length"} <= set(rollout.episodes[0])
    np.testing.assert_array_equal(rollout.kinds, np.tile(np.arange(8) % 3, (16, 1)))
    np.testing.assert_allclose(
        rollout.rewards,
        -((rollout.actions.numpy() - rollout.observations[:, :, :1]) ** 2).mean(axis=2),
        rtol=1e-4,
        atol=1e-6,
    )


def test_collect_draws_from_the_policy():
    config = replace(TINY, num_envs=500, num_steps=2, init_std=0.3)
    learner, env = make(config=config), FakeEnv(500)
    learner.normalizer.update(np.random.default_rng(0).normal(0.3, 2.0, (100, 2)))
    rollout, _ = collect(env, learner, env.reset(0)[0])
    policy = Policy.from_arrays(policy_arrays(learner), {})
    means = policy(rollout.observations.reshape(-1, 2)).reshape(2, 500, 2)
    np.testing.assert_allclose(rollout.outputs, means, atol=1e-5)
    noise = rollout.actions.numpy() - means
    np.testing.assert_allclose(noise.std(axis=(0, 1)), 0.3, atol=0.02)
    np.testing.assert_allclose(noise.mean(axis=(0, 1)), 0.0, atol=0.03)


def test_normaliser_is_frozen_during_a_rollout_and_updated_after():
    learner, env = make(), FakeEnv()
    obs, _ = env.reset(0)
    rollout, _ = collect(env, learner, obs)
    assert learner.normalizer.count == 0
    update(learner, rollout)
    assert learner.normalizer.count == TINY.batch_size
    seen = rollout.observations.reshape(-1, 2)
    both = np.concatenate([seen, LINE(seen)])
    np.testing.assert_allclose(learner.normalizer.mean, both.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(learner.normalizer.var, both.var(axis=0), rtol=1e-4)


# --- advantages by kind of course ---------------------------------------------------------


def test_normalized_advantages_by_hand():
    # kind 0: 1, 3, 5 with mean 3 and variance 8/3; kind 2: 10, 30 with mean 20 and deviation 10
    advantages, kinds = np.array([[1.0, 10.0, 3.0], [30.0, 5.0, 7.0]]), np.array([[0, 2, 0], [2, 0, 1]])
    a = 2 / np.sqrt(8 / 3)
    expected = [[-a, -1.0, 0.0], [1.0, a, 0.0]]  # the only step of kind 1 is its mean
    np.testing.assert_allclose(normalize_advantages(advantages, kinds), expected, atol=1e-7)
    np.testing.assert_array_equal(advantages, [[1.0, 10.0, 3.0], [30.0, 5.0, 7.0]])  # the critic's targets need them


def test_each_kind_has_mean_zero_and_variance_one():
    rng = np.random.default_rng(0)
    kinds = rng.integers(0, 4, (16, 64))
    found = normalize_advantages(rng.normal(kinds, 10.0**kinds), kinds)
    for kind in range(4):
        assert found[kinds == kind].mean() == pytest.approx(0.0, abs=1e-9)
        assert found[kinds == kind].std() == pytest.approx(1.0)


# --- settings --------------------------------------------------------------------------


@pytest.mark.parametrize("change, message", [
    ({"num_envs": 0}, "num-envs must be a number of at least 1, not 0"),
    ({"num_steps": 0}, "num-steps must be a number of at least 1, not 0"),
    ({"update_epochs": 0}, "update-epochs must be a number of at least 1, not 0"),
    ({"num_minibatches": 0}, "num-minibatches must be a number of at least 1, not 0"),
    ({"init_std": 0.0}, "init-std must be a number of at least 1e-09, not 0.0"),
    ({"final_std": float("nan")}, "final-std must be a number of at least 1e-09, not nan"),
    ({"num_envs": 2, "num_steps": 3, "num_minibatches": 7}, "num-minibatches must be at most 6 steps, not 7"),
    ({"hidden": (8, 5)}, "hidden must be one or more even numbers of units, for they come in pairs, not (8, 5)"),
    ({"hidden": (0,)}, "hidden must be one or more even numbers of units, for they come in pairs, not (0,)"),
])  # fmt: skip
def test_settings_that_cannot_be_trained_with_are_refused(change, message):
    with pytest.raises(UserError) as refusal:
        replace(TINY, **change)
    assert str(refusal.value) == message


# --- losses ----------------------------------------------------------------------------


def test_policy_loss_at_ratio_one_is_minus_the_mean_advantage():
    log_prob, advantage = torch.tensor([-1.0, -2.0, 0.3]), torch.tensor([1.0, -4.0, 6.0])
    assert policy_loss(log_prob, log_prob, advantage, 0.2).item() == pytest.approx(-1.0)


def test_policy_loss_by_hand():
    # ratio 1.5, A = 2: min(3.0, 1.2 * 2) = 2.4;  ratio 1.5, A = -2: min(-3.0, -2.4) = -3.0
    ratio, advantage = torch.tensor([1.5, 1.5]), torch.tensor([2.0, -2.0])
    assert policy_loss(ratio.log(), torch.zeros(2), advantage, 0.2).item() == pytest.approx(-(2.4 - 3.0) / 2)


@pytest.mark.parametrize("ratio, advantage, flows", [
    (1.3, 1.0, False),  # already more likely than allowed, and good: stop
    (0.7, -1.0, False),  # already less likely than allowed, and bad: stop
    (1.3, -1.0, True),  # more likely and bad: come back
    (0.7, 1.0, True),  # less likely and good: come back
    (1.1, 1.0, True),
    (0.9, -1.0, True),
])  # fmt: skip
def test_policy_gradient_stops_outside_the_clip_range(ratio, advantage, flows):
    log_prob = torch.tensor([float(np.log(ratio))], requires_grad=True)
    policy_loss(log_prob, torch.zeros(1), torch.tensor([advantage]), 0.2).backward()
    # d(-r A) / d log r = -r A
    assert log_prob.grad.item() == pytest.approx(-ratio * advantage if flows else 0.0)


C = PPOConfig(target_kl=0.01, learning_rate_min=1e-4, learning_rate_max=1e-2)


@pytest.mark.parametrize("kl, expected", [
    (0.021, 1e-3 / 1.5),  # above twice the target
    (0.019, 1e-3),
    (0.006, 1e-3),
    (0.004, 1e-3 * 1.5),  # below half of it
])  # fmt: skip
def test_learning_rate_follows_the_kl(kl, expected):
    assert adapt_learning_rate(1e-3, kl, C) == pytest.approx(expected)


@pytest.mark.parametrize("rate, kl, expected", [(1.1e-4, 1.0, 1e-4), (9e-3, 0.0, 1e-2)])
def test_learning_rate_has_a_floor_and_a_ceiling(rate, kl, expected):
    assert adapt_learning_rate(rate, kl, C) == expected


def test_annealing_lowers_the_target_and_the_floor():
    # target 0.01 / 4 = 0.0025: 0.006 is above twice that; floor 1e-4 / 4
    assert adapt_learning_rate(1e-3, 0.006, C, anneal=0.25) == pytest.approx(1e-3 / 1.5)
    assert adapt_learning_rate(2.6e-5, 1.0, C, anneal=0.25) == pytest.approx(2.5e-5)


@pytest.mark.parametrize("progress, std, anneal", [
    (0.0, 0.8, 1.0),
    (0.5, 0.5, 1.0),  # half way from 0.8 to 0.2
    (0.75, 0.35, 1.0),
    (0.875, 0.275, 0.5),  # half of the last quarter is left
    (1.0, 0.2, 0.0),
])  # fmt: skip
def test_schedule(progress, std, anneal):
    config = PPOConfig(init_std=0.8, final_std=0.2, anneal_share=0.25)
    assert schedule(progress, config) == pytest.approx((std, anneal))


def test_schedule_can_be_turned_off():
    config = PPOConfig(init_std=0.8, final_std=0.8, anneal_share=0.0)
    assert schedule(1.0, config) == (0.8, 1.0)


def test_training_ends_below_the_final_std():
    config = replace(TINY, init_std=0.8, final_std=0.1)
    _, records = trained(4, config=config)
    # The largest values after the updates that begin at 0, 1/4, 1/2 and 3/4 of the steps, for a policy of 0.8.
    assert (np.array([r["std"] for r in records]) <= [0.8 + 1e-6, 0.625 + 1e-6, 0.45 + 1e-6, 0.275 + 1e-6]).all()
    assert records[-1]["std"] == pytest.approx(0.275, abs=0.01)


def test_schedule_counts_the_runs_own_steps():
    learner = make(config=replace(TINY, init_std=0.8, final_std=0.2))
    learner.steps = learner.start = 10 * TINY.batch_size
    stds = [r["std"] for r in train(FakeEnv(), learner, 12 * TINY.batch_size)]
    # Updates at 0 and at 1/2 of the two iterations that are the run's own.
    assert stds[0] > 0.75 and stds[1] <= 0.5 + 1e-6


# --- determinism -----------------------------------------------------------------------


def test_same_seed_same_weights():
    a, b = (learner_state(trained(3)[0]) for _ in range(2))
    assert a.keys() == b.keys()
    for name in a:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def test_other_seed_other_weights():
    a, b = (learner_state(trained(3, seed)[0]) for seed in (0, 1))
    for name in ("net.actor.own.0.weight", "net.actor.other.0.weight", "net.critic.own.0.weight"):
        assert not np.array_equal(a[name], b[name])


def test_training_changes_every_parameter():
    before, after = learner_state(make()), learner_state(trained(3)[0])
    weights = [name for name in before if name.startswith("net.")]
    assert len(weights) == 12  # log_std; W_e, b and W_o for two layers of two networks, but a value has no odd part
    assert all((before[name] != after[name]).any() for name in weights)
    assert (policy_arrays(make())["actor.0.weight"] != policy_arrays(trained(3)[0])["actor.0.weight"]).all()


# --- training --------------------------------------------------------------------------


def test_train_counts_steps_and_reports():
    learner, records = trained(3)
    assert [r["steps"] for r in records] == [TINY.batch_size * k for k in (1, 2, 3)]
    assert learner.steps == 3 * TINY.batch_size
    for key in ("policy_loss", "value_loss", "entropy", "kl", "clip_fraction", "learning_rate", "std"):
        assert np.isfinite([r[key] for r in records]).all(), key


def test_train_stops_when_asked():
    learner = make()
    records = list(train(FakeEnv(), learner, 10**9, stop=lambda: learner.steps >= 2 * TINY.batch_size))
    assert len(records) == 2


def test_train_goes_on_from_the_steps_done():
    learner = make()
    learner.steps = 2 * TINY.batch_size
    assert len(list(train(FakeEnv(), learner, 3 * TINY.batch_size))) == 1


def mean_return(records):
    return np.mean([e["reward"] / e["length"] for r in records for e in r["episodes"]])


def test_ppo_learns_to_follow_a_point():
    # A blind policy earns at best -var(U(-1, 1)) = -1/3 a step; its own noise costs std^2 more.
    config = replace(TINY, num_envs=64, num_steps=16, update_epochs=4, ent_coef=0.0, gamma=0.5)
    _, records = trained(60, config=config)
    assert mean_return(records[:3]) < -0.6
    assert mean_return(records[-5:]) > -0.2


def test_ppo_learns_to_choose():
    class Choice(FakeEnv):
        """Index 1 is right where x > 0, index 0 elsewhere."""

        def step(self, action):
            right = action == (self.x > 0)
            obs, _, terminated, truncated, info = super().step(np.zeros((self.num_envs, 2)))
            return obs, np.where(right, 1.0, -1.0), terminated, truncated, info

    config = replace(TINY, num_envs=64, num_steps=16, update_epochs=4, gamma=0.5)
    learner = Learner.create(LINE, CHOICES, config, 0, discrete=True)
    list(train(Choice(64), learner, 40 * config.batch_size))
    x = np.linspace(-1, 1, 41, dtype=np.float32)
    obs = np.column_stack([x, np.full(41, 0.4, np.float32)])
    chosen = Policy.from_arrays(policy_arrays(learner), {})(obs).argmax(-1)
    assert (chosen == (x > 0))[np.abs(x) > 0.1].all()


# --- left and right --------------------------------------------------------------------


@pytest.mark.parametrize("mirror, discrete", [(ACTIONS, False), (CHOICES, True)])
def test_training_keeps_a_policy_exactly_equivariant(mirror, discrete):
    class Both(FakeEnv):
        def step(self, action):
            return super().step(np.tile(action.reshape(self.num_envs, -1)[:, :1], (1, 2)))

    learner = Learner.create(LINE, mirror, replace(TINY, hidden=(16, 8)), 0, discrete)
    start = policy_arrays(learner)
    list(train(Both(), learner, 20 * TINY.batch_size))
    x = np.random.default_rng(0).standard_normal((100, 2)).astype(np.float32)
    policy, before = Policy.from_arrays(policy_arrays(learner), {}), Policy.from_arrays(start, {})
    assert np.abs(policy(x) - before(x)).max() > 0.1
    np.testing.assert_allclose(policy(LINE(x)), mirror(policy(x)), atol=1e-5)
    with torch.no_grad():
        values, image = (learner.net.value(learner.observe(obs)) for obs in (x, LINE(x)))
    assert np.ptp(values.numpy()) > 0.1
    np.testing.assert_allclose(image, values, atol=1e-5)


@pytest.mark.filterwarnings("ignore:Initializing zero-element tensors")  # of the odd part, which is empty
def test_a_task_without_handedness_can_be_learned():
    config = replace(TINY, num_envs=64, update_epochs=4, ent_coef=0.0, gamma=0.5)
    learner = Learner.create(Mirror.identity(2), Mirror.identity(2), config, 0)
    records = list(train(FakeEnv(64), learner, 60 * config.batch_size))
    assert mean_return(records[-5:]) > -0.2


# --- the whole update ---------------------------------------------------------------------


def test_an_update_equals_one_written_in_a_piece():
    """The same minibatches through torch.distributions, autograd and two plain Adams."""
    config = replace(TINY, ent_coef=0.1, max_grad_norm=0.05, target_kl=1e-4, learning_rate=2e-3)
    learner = make(seed=3, config=config)
    learner.anneal = 0.5
    env = FakeEnv(config.num_envs)
    rollout, _ = collect(env, learner, env.reset(0)[0])
    net, generator = deepcopy(learner.net), torch.Generator()
    generator.set_state(learner.generator.get_state())

    advantages = gae(
        rollout.rewards, rollout.values, rollout.next_values, rollout.terminated, rollout.truncated, 0.99, 0.95
    )
    returns = torch.from_numpy(advantages + rollout.values).reshape(-1)
    for robots in ([0, 3, 6], [1, 4, 7], [2, 5]):  # the three kinds of course
        a = advantages[:, robots]
        advantages[:, robots] = (a - a.mean()) / a.std()
    advantages = torch.from_numpy(advantages).reshape(-1)
    parts, actions = rollout.parts.reshape(-1, 2), rollout.actions.reshape(-1, 2)
    old = torch.distributions.Normal(rollout.outputs.reshape(-1, 2), rollout.std)
    actor = [*net.actor.parameters(), net.log_std]
    critic = list(net.critic.parameters())
    adam, critic_adam = torch.optim.Adam(actor), torch.optim.Adam(critic, 2e-3)  # the critic keeps the first rate
    rate, clipped = 2e-3, []

    def descend(optimizer, parameters, loss):
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(parameters, 0.05)
        optimizer.step()

    order = torch.randperm(len(parts), generator=generator).chunk(2)
    for i in (*order, *order):  # two epochs
        new = torch.distributions.Normal(net.actor(parts[i]), net.log_std.exp().expand(2))  # one deviation for both
        old_i = torch.distributions.Normal(old.mean[i], old.stddev[i])
        kl = torch.distributions.kl_divergence(old_i, new).sum(-1).mean().item()
        rate = rate / 1.5 if kl > 1e-4 else rate * 1.5 if kl < 0.25e-4 else rate  # half of 2e-4, half of 0.5e-4
        rate = min(max(rate, 0.5 * 1.5e-4), 3e-3)
        ratio = (new.log_prob(actions[i]) - old_i.log_prob(actions[i])).sum(-1).exp()
        clipped.append(((ratio < 0.8) | (ratio > 1.2)).float().mean().item())
        gain = torch.minimum(ratio * advantages[i], ratio.clamp(0.8, 1.2) * advantages[i]).mean()
        adam.param_groups[0]["lr"] = rate
        descend(adam, actor, -gain - 0.1 * new.entropy().sum(-1).mean())
        descend(critic_adam, critic, ((net.value(parts[i]) - returns[i]) ** 2).mean() / 2)

    losses = update(learner, rollout)
    assert learner.learning_rate == pytest.approx(rate) and rate != pytest.approx(2e-3)
    assert losses["clip_fraction"] == pytest.approx(np.mean(clipped))
    for (name, ours), theirs in zip(learner.net.named_parameters(), net.parameters(), strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-6, msg=name)


def test_a_critic_with_a_rate_of_its_own():
    learner = make(config=replace(TINY, critic_learning_rate=7e-4))
    env = FakeEnv()
    update(learner, collect(env, learner, env.reset(0)[0])[0])
    assert learner.critic_optimizer.param_groups[0]["lr"] == 7e-4
    assert learner.actor_optimizer.param_groups[0]["lr"] == learner.learning_rate


def batch(learner, n=6, advantage=0.0, std=1.0, log_ratio=0.0, off=0.0):
    """n steps whose policy had ``std`` times the learner's spread, and whose returns are ``off`` its values."""
    parts = torch.randn(n, 2, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        outputs = learner.net.actor(parts)
        actions = outputs + 0.5
        log_prob = learner.net.distribution(outputs, learner.net.std()).log_prob(actions) - torch.as_tensor(log_ratio)
        values = learner.net.value(parts)
        old_std = std * learner.net.std()
    return Batch(parts, actions, torch.full((n,), advantage), values + off, outputs, log_prob), old_std


def test_one_pass_of_the_actor_by_hand():
    learner = make(config=replace(TINY, update_epochs=1, ent_coef=0.1, target_kl=0.1, learning_rate=1e-3))
    before = learner.net.log_std.item()
    ratios = torch.log(torch.tensor([0.7, 0.85, 1.0, 1.15, 1.3, 1.5]))  # three beyond 1 +- 0.2
    one, old_std = batch(learner, std=2.0, log_ratio=ratios)
    found = update_actor(learner, [one], old_std)
    # KL(2 s || s) = log(1/2) + 4/2 - 1/2, of two actions
    assert found["kl"] == pytest.approx(2 * (np.log(0.5) + 1.5), abs=1e-5)
    assert found["clip_fraction"] == pytest.approx(0.5)
    assert learner.learning_rate == pytest.approx(1e-3 / 1.5)  # 1.61 is above twice the target
    # nothing to gain but entropy: Adam's first step widens the policy by the step size
    assert learner.net.log_std.item() - before == pytest.approx(1e-3 / 1.5, rel=1e-3)


def test_the_end_of_training_aims_at_no_divergence():
    learner = make(config=replace(TINY, update_epochs=1, target_kl=10.0))
    learner.anneal = 0.0
    one, old_std = batch(learner, std=2.0)
    update_actor(learner, [one], old_std)
    assert learner.learning_rate == pytest.approx(1e-3 / 1.5)


def test_a_resumed_run_meets_other_starts():
    class Noting(FakeEnv):
        def reset(self, seed=None):
            seeds.append(seed)
            return super().reset(seed)

    seeds = []
    for steps in (0, TINY.batch_size):
        learner = make()
        learner.steps = steps
        list(train(Noting(), learner, steps + TINY.batch_size))
    assert seeds[0] != seeds[1]


def test_the_seed_decides_network_and_exploration():
    a, b = make(0), make(1)
    assert not np.array_equal(policy_arrays(a)["actor.0.weight"], policy_arrays(b)["actor.0.weight"])
    assert a.generator.initial_seed() != b.generator.initial_seed()

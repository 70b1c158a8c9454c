from copy import deepcopy
from dataclasses import replace

from agility_ref.networks import Categorical, Gaussian
from agility_ref.observation import OBS_DIM
from agility_ref.ppo import (
    Batch,
    Learner,
    PPOConfig,
    Rollout,
    adapt_learning_rate,
    collect,
    gae,
    mirror_alternate,
    policy_loss,
    schedule,
    train,
    update,
    update_actor,
)

import numpy as np
import pytest
import torch

torch.set_num_threads(1)
TINY = PPOConfig(num_envs=8, num_steps=16, hidden=(16,), update_epochs=2, num_minibatches=2)
YES, NO = True, False


class FakeEnv:
    """Points on a line that earn -(a - x)^2; the best action is what is observed.

    ``limit`` steps truncate an episode; a point that starts at x > 0.95 ends terminated
    after one step.  The API is that of Go1Env, SAME_STEP autoreset included.
    """

    def __init__(self, num_envs=8, limit=5, obs_dim=2):
        self.num_envs, self.limit, self.obs_dim = num_envs, limit, obs_dim

    def _start(self, ids):
        self.x[ids] = self.rng.uniform(-1, 1, len(ids))
        self.age[ids] = 0
        self.total[ids] = 0.0

    def _observe(self):
        obs = np.zeros((self.num_envs, self.obs_dim), np.float32)
        obs[:, 0], obs[:, 1] = self.x, self.age / self.limit
        return obs

    def reset(self, seed=None):
        self.rng = np.random.default_rng(seed)
        self.x, self.total = np.zeros(self.num_envs), np.zeros(self.num_envs)
        self.age = np.zeros(self.num_envs, int)
        self._start(np.arange(self.num_envs))
        return self._observe(), {}

    def step(self, action):
        a = np.asarray(action, float).reshape(self.num_envs, -1)[:, 0]
        reward = -((a - self.x) ** 2)
        terminated = self.x > 0.95
        self.age += 1
        self.total += reward
        truncated = ~terminated & (self.age >= self.limit)
        final = self._observe()
        episode = {"reward": self.total.copy(), "length": self.age.copy()}
        self._start(np.flatnonzero(terminated | truncated))
        return self._observe(), reward, terminated, truncated, {"final_observation": final, "episode": episode}


def make(seed=0, config=TINY, act_dim=1, distribution=Gaussian):
    return Learner.create(2, act_dim, config, seed, distribution)


def trained(iterations, seed=0, config=TINY):
    learner = make(seed, config)
    records = list(train(FakeEnv(config.num_envs), learner, iterations * config.batch_size))
    return learner, records


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
        finals.append(out[4]["final_observation"])
        return out

    env.step = noting
    rollout, after = collect(env, learner, obs)

    def value(x):
        with torch.no_grad():
            return learner.net.value(torch.from_numpy(learner.normalizer(x))).numpy()

    assert rollout.truncated.sum() > 8
    for t in range(TINY.num_steps):
        following = rollout.raw_obs[t + 1] if t + 1 < TINY.num_steps else after
        expected = np.where(rollout.truncated[t], value(finals[t]), value(following))
        np.testing.assert_allclose(rollout.next_values[t], expected, atol=1e-6)
        cut = rollout.truncated[t]
        assert (np.abs(value(finals[t]) - value(following))[cut] > 1e-6).all()  # and the two differ


def test_collect_returns_what_happened():
    learner, env = make(), FakeEnv(limit=5)
    obs, _ = env.reset(0)
    rollout, after = collect(env, learner, obs)
    assert rollout.obs.shape == (16, 8, 2) and rollout.actions.shape == (16, 8, 1)
    np.testing.assert_array_equal(rollout.raw_obs[0], obs)
    np.testing.assert_array_equal(after, env._observe())
    assert len(rollout.episodes) == (rollout.terminated | rollout.truncated).sum()
    assert {"reward", "length"} <= set(rollout.episodes[0])
    np.testing.assert_allclose(
        rollout.rewards, -((rollout.actions.numpy()[:, :, 0] - rollout.raw_obs[:, :, 0]) ** 2), rtol=1e-4, atol=1e-6
    )


def test_normaliser_is_frozen_during_a_rollout_and_updated_after():
    learner, env = make(), FakeEnv()
    obs, _ = env.reset(0)
    rollout, _ = collect(env, learner, obs)
    assert learner.normalizer.count == 0
    update(learner, rollout)
    assert learner.normalizer.count == TINY.batch_size
    np.testing.assert_allclose(learner.normalizer.mean, rollout.raw_obs.reshape(-1, 2).mean(axis=0), atol=1e-6)


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


# --- determinism, saving, resuming -----------------------------------------------------


def test_same_seed_same_weights():
    a, b = (trained(3)[0].arrays() for _ in range(2))
    assert a.keys() == b.keys()
    for name in a:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def test_other_seed_other_weights():
    a, b = (trained(3, seed)[0].arrays() for seed in (0, 1))
    assert not np.array_equal(a["actor.0.weight"], b["actor.0.weight"])
    assert not np.array_equal(a["critic.0.weight"], b["critic.0.weight"])


def test_training_changes_every_parameter():
    before, after = make().arrays(), trained(3)[0].arrays()
    assert all((before[name] != after[name]).any() for name in before)


def resumed(learner, config=TINY):
    other = make(seed=99, config=config)
    other.load_arrays(learner.arrays() | learner.training_arrays())
    return other


def test_resumed_learner_goes_on_identically():
    original, _ = trained(3)
    copy = resumed(original)
    assert copy.learning_rate == original.learning_rate
    env = FakeEnv()
    obs, _ = env.reset(5)
    rollout, _ = collect(env, original, obs)
    for learner in (original, copy):
        learner.generator.manual_seed(0)  # the same minibatches
        update(learner, rollout)
    a, b = original.arrays(), copy.arrays()
    for name in a:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def without_critic(learner):
    return {name: array for name, array in learner.arrays().items() if not name.startswith(("critic.", "log_std"))}


def test_a_start_without_a_critic_rests_the_actor():
    source, learner = make(seed=1), make(seed=2)
    new = learner.arrays()
    learner.warm_start(without_critic(source), steps=100, std=0.25, critic_steps=3 * TINY.batch_size)
    started = learner.arrays()
    np.testing.assert_array_equal(started["actor.0.weight"], source.arrays()["actor.0.weight"])
    np.testing.assert_array_equal(started["critic.0.weight"], new["critic.0.weight"])
    np.testing.assert_allclose(started["log_std"], np.log(0.25))
    moved = []
    for _ in train(FakeEnv(), learner, 100 + 5 * TINY.batch_size):
        now = learner.arrays()
        moved.append(
            [not np.array_equal(now[f"{net}.0.weight"], started[f"{net}.0.weight"]) for net in ("actor", "critic")]
        )
    assert moved == [[False, True]] * 3 + [[True, True]] * 2


def test_a_start_with_a_critic_rests_nobody():
    learner = make(seed=2)
    learner.warm_start(make(seed=1).arrays(), steps=100, std=0.25, critic_steps=1000)
    assert not learner.actor_rests and learner.learning_rate == TINY.learning_rate


def test_a_resumed_learner_rests_as_long():
    learner = make()
    learner.warm_start(without_critic(make(seed=1)), steps=100, std=0.25, critic_steps=1000)
    copy = resumed(learner)
    assert copy.actor_start == 1100


def test_resuming_needs_adams_moments():
    # Without them the next step differs: the round trip above is not vacuous.
    original, _ = trained(3)
    copy = make(seed=99)
    copy.load_arrays(original.arrays())
    env = FakeEnv()
    obs, _ = env.reset(5)
    rollout, _ = collect(env, original, obs)
    for learner in (original, copy):
        learner.learning_rate = 1e-3
        learner.generator.manual_seed(0)
        update(learner, rollout)
    assert not np.array_equal(original.arrays()["actor.0.weight"], copy.arrays()["actor.0.weight"])


def test_arrays_are_copies():
    learner = make()
    kept = learner.arrays()
    value = kept["actor.0.weight"].copy()
    list(train(FakeEnv(), learner, TINY.batch_size))
    np.testing.assert_array_equal(kept["actor.0.weight"], value)


def test_loading_copies_too():
    a, b = make(0), make(1)
    arrays = a.arrays()
    b.load_arrays(arrays)
    list(train(FakeEnv(), b, TINY.batch_size))
    np.testing.assert_array_equal(arrays["normalizer.mean"], a.arrays()["normalizer.mean"])
    np.testing.assert_array_equal(arrays["actor.0.weight"], a.arrays()["actor.0.weight"])


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
            obs, _, terminated, truncated, info = super().step(np.zeros(self.num_envs))
            return obs, np.where(right, 1.0, -1.0), terminated, truncated, info

    config = replace(TINY, num_envs=64, num_steps=16, update_epochs=4, gamma=0.5)
    learner = make(config=config, act_dim=2, distribution=Categorical)
    list(train(Choice(64), learner, 40 * config.batch_size))
    x = np.linspace(-1, 1, 41, dtype=np.float32)
    obs = learner.normalizer(np.column_stack([x, np.full(41, 0.4, np.float32)]))
    with torch.no_grad():
        chosen = learner.net.actor(torch.from_numpy(obs)).argmax(-1).numpy()
    assert (chosen == (x > 0))[np.abs(x) > 0.1].all()


# --- mirror images ---------------------------------------------------------------------


def test_mirrored_samples_keep_their_probabilities():
    learner = Learner.create(OBS_DIM, 12, replace(TINY, mirror=True), 0)
    rng, gen = np.random.default_rng(0), torch.Generator().manual_seed(0)
    raw = rng.normal(size=(3, 4, OBS_DIM)).astype(np.float32)
    obs = torch.from_numpy(learner.normalizer(raw))
    with torch.no_grad():
        learner.net.log_std[:] = torch.linspace(-1.0, 1.0, 12)
        parameters = tuple(p.clone() for p in Gaussian.parameters(learner.net, obs))
        actions = Gaussian.sample(parameters, gen)
    before = Gaussian.log_prob(parameters, actions)
    zeros, flags = np.zeros((3, 4), np.float32), np.zeros((3, 4), bool)
    rollout = Rollout(obs.clone(), actions.clone(), parameters, zeros, zeros, zeros, flags, flags, raw, [])
    mirror_alternate(learner, rollout)
    torch.testing.assert_close(Gaussian.log_prob(rollout.parameters, rollout.actions), before)
    assert torch.equal(rollout.actions[:, ::2], actions[:, ::2]) and torch.equal(rollout.obs[:, ::2], obs[:, ::2])
    # The heading error (entries 9 and 10) changes sign, the command (11) does not.
    assert torch.equal(rollout.obs[:, 1::2, 9:11], -obs[:, 1::2, 9:11])
    assert torch.equal(rollout.obs[:, 1::2, 11], obs[:, 1::2, 11])
    # The left front thigh (entry 4) does what the right one (entry 1) did, the hip (0, 3) the opposite.
    assert torch.equal(rollout.actions[:, 1::2, 4], actions[:, 1::2, 1])
    assert torch.equal(rollout.actions[:, 1::2, 3], -actions[:, 1::2, 0])


# --- the whole update ---------------------------------------------------------------------


def test_an_update_equals_one_written_in_a_piece():
    """The same minibatches through torch.distributions, autograd and two plain Adams."""
    config = replace(TINY, ent_coef=0.1, max_grad_norm=0.05, target_kl=1e-4, learning_rate=2e-3)
    learner = make(seed=3, config=config, act_dim=2)
    learner.anneal = 0.5
    env = FakeEnv(config.num_envs)
    rollout, _ = collect(env, learner, env.reset(0)[0])
    net, generator = deepcopy(learner.net), torch.Generator()
    generator.set_state(learner.generator.get_state())

    advantages = gae(
        rollout.rewards, rollout.values, rollout.next_values, rollout.terminated, rollout.truncated, 0.99, 0.95
    )
    returns = torch.from_numpy(advantages + rollout.values).reshape(-1)
    advantages = torch.from_numpy((advantages - advantages.mean()) / advantages.std()).reshape(-1)
    obs, actions = rollout.obs.reshape(-1, 2), rollout.actions.reshape(-1, 2)
    mean, log_std = (p.reshape(-1, 2) for p in rollout.parameters)
    old = torch.distributions.Normal(mean, log_std.exp())
    actor = [*net.actor.parameters(), net.log_std]
    critic = list(net.critic.parameters())
    adam, critic_adam = torch.optim.Adam(actor), torch.optim.Adam(critic, 2e-3)  # the critic keeps the first rate
    rate, clipped = 2e-3, []

    def descend(optimizer, parameters, loss):
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(parameters, 0.05)
        optimizer.step()

    order = torch.randperm(len(obs), generator=generator).chunk(2)
    for i in (*order, *order):  # two epochs
        new = torch.distributions.Normal(net.actor(obs[i]), net.log_std.exp())
        old_i = torch.distributions.Normal(old.mean[i], old.stddev[i])
        kl = torch.distributions.kl_divergence(old_i, new).sum(-1).mean().item()
        rate = rate / 1.5 if kl > 1e-4 else rate * 1.5 if kl < 0.25e-4 else rate  # half of 2e-4, half of 0.5e-4
        rate = min(max(rate, 0.5 * 1.5e-4), 3e-3)
        ratio = (new.log_prob(actions[i]) - old_i.log_prob(actions[i])).sum(-1).exp()
        clipped.append(((ratio < 0.8) | (ratio > 1.2)).float().mean().item())
        gain = torch.minimum(ratio * advantages[i], ratio.clamp(0.8, 1.2) * advantages[i]).mean()
        adam.param_groups[0]["lr"] = rate
        descend(adam, actor, -gain - 0.1 * new.entropy().sum(-1).mean())
        descend(critic_adam, critic, ((net.value(obs[i]) - returns[i]) ** 2).mean() / 2)

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


def test_mirror_is_part_of_the_update(monkeypatch):
    seen = []
    monkeypatch.setattr("agility_ref.ppo.mirror_alternate", lambda learner, rollout: seen.append(rollout))
    for mirror in (False, True):
        learner, env = make(config=replace(TINY, mirror=mirror)), FakeEnv()
        update(learner, collect(env, learner, env.reset(0)[0])[0])
    assert len(seen) == 1


def batch(learner, n=6, advantage=0.0, std=1.0, log_ratio=0.0, off=0.0):
    """n steps whose policy had ``std`` times the learner's spread, and whose returns are ``off`` its values."""
    obs = torch.randn(n, 2, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        mean, log_std = Gaussian.parameters(learner.net, obs)
        actions = mean + 0.5
        log_prob = Gaussian.log_prob((mean, log_std), actions) - torch.as_tensor(log_ratio)
        values = learner.net.value(obs)
    return Batch(
        obs, actions, torch.full((n,), advantage), values + off, (mean, log_std + float(np.log(std))), log_prob
    )


def test_one_pass_of_the_actor_by_hand():
    learner = make(config=replace(TINY, update_epochs=1, ent_coef=0.1, target_kl=0.1, learning_rate=1e-3))
    before = learner.net.log_std.item()
    ratios = torch.log(torch.tensor([0.7, 0.85, 1.0, 1.15, 1.3, 1.5]))  # three beyond 1 +- 0.2
    found = update_actor(learner, [batch(learner, std=2.0, log_ratio=ratios)])
    # KL(2 s || s) = log(1/2) + 4/2 - 1/2
    assert found["kl"] == pytest.approx(np.log(0.5) + 1.5, abs=1e-5) and found["clip_fraction"] == pytest.approx(0.5)
    assert learner.learning_rate == pytest.approx(1e-3 / 1.5)  # 0.81 is above twice the target
    # nothing to gain but entropy: Adam's first step widens the policy by the step size
    assert learner.net.log_std.item() - before == pytest.approx(1e-3 / 1.5, rel=1e-3)


def test_the_end_of_training_aims_at_no_divergence():
    learner = make(config=replace(TINY, update_epochs=1, target_kl=10.0))
    learner.anneal = 0.0
    update_actor(learner, [batch(learner, std=2.0)])
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
    assert not np.array_equal(a.arrays()["actor.0.weight"], b.arrays()["actor.0.weight"])
    assert a.generator.initial_seed() != b.generator.initial_seed()


def test_a_start_without_a_critic_begins_with_small_steps():
    learner = make()
    learner.warm_start(without_critic(make(seed=1)), steps=100, std=0.25, critic_steps=1000)
    assert learner.learning_rate == TINY.learning_rate_min

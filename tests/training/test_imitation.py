from dataclasses import replace

from agility_ref.env import ACTION_DIM, EnvConfig, Go1Env
from agility_ref.observation import ACTION_MIRROR, NUM_SCANDOTS, OBS_DIM, OBS_MIRROR, SCANDOT_MIRROR, SCANDOTS
from agility_ref.policy import Policy
from agility_ref.ppo import Learner, PPOConfig
from agility_ref.selector import Hierarchy, Single, oracle_hierarchy
from agility_ref.terrain import make_course
from agility_ref.training import imitation
from agility_ref.training.imitation import (
    DistillConfig,
    FineTuneConfig,
    SupervisedConfig,
    collect_actions,
    collect_labels,
    fit,
    fit_selector,
    fit_student,
    visit,
)
from agility_ref.training.state import policy_arrays, warm_start
from agility_ref.world import World

import numpy as np
import pytest
import torch

SMALL = DistillConfig(epochs=20, batch_size=64, learning_rate=3e-3)


@pytest.fixture
def env():
    """Three robots, each on its own course: walk, gap, beam."""
    world = World([make_course(kind, 0.5, 0) for kind in ("walk", "gap", "beam")])
    return Go1Env(world, 3, EnvConfig(), lambda ids, fraction: ids)


def states(n, seed=0):
    return np.random.default_rng(seed).standard_normal((n, OBS_DIM)).astype(np.float32)


def policy_of(observations, actions, config=SMALL, hidden=(32,), seed=0):
    arrays, losses = fit_student(observations, actions, hidden, config, seed)
    return Policy.from_arrays(arrays, {"policy": "distilled", "act_dim": ACTION_DIM}), losses


# --- what is collected -----------------------------------------------------------------


def test_as_many_states_as_asked_for_and_no_step_more(env, five_skills):
    observations, actions = collect_actions(
        env, oracle_hierarchy("o", five_skills), oracle_hierarchy("o", five_skills), 10, 0.0
    )
    # 3 robots: 3, 6, 9, 12 states
    assert observations.shape == (12, OBS_DIM) and actions.shape == (12, ACTION_DIM)
    assert observations.dtype == actions.dtype == np.float32


def test_labels_are_the_teachers_actions_whoever_acts(five_skills, make_policy):
    env = Go1Env(World([make_course("gap", 0.5, 0)]), 3, EnvConfig(action_limit=1.0))
    teacher = Hierarchy("leap", tuple(five_skills.values()), lambda obs, env: np.full(len(obs), 3), np.arange(5))
    student = Single("student", make_policy(9))
    observations, actions = collect_actions(env, student, teacher, 30, 0.5)
    wanted = five_skills["leap"](observations)
    np.testing.assert_allclose(actions, np.clip(wanted, -1.0, 1.0), atol=1e-5)
    assert np.abs(wanted).max() > 1.0  # the clip does something


def test_each_state_is_labelled_by_the_skill_of_its_region(env, five_skills):
    for robot, course in enumerate(env.world.courses):
        env._qpos[robot, 0] = course.obstacles[0].x0 if course.obstacles else 5.0
    oracle = oracle_hierarchy("o", five_skills)
    env.reset = lambda: (np.zeros((3, OBS_DIM), np.float32), {})  # the robots stay where they were put
    _, actions = collect_actions(env, oracle, oracle, 3, 0.0)
    nothing = np.zeros((1, OBS_DIM), np.float32)
    for action, skill in zip(actions, ("walk", "leap", "beam"), strict=True):
        np.testing.assert_allclose(action, np.clip(five_skills[skill](nothing)[0], -4, 4), atol=1e-5)


def test_noise_changes_what_is_seen_next_and_not_the_first_state(five_skills):
    oracle, seen = oracle_hierarchy("o", five_skills), []
    for noise in (0.0, 0.5):
        world = World([make_course("walk", 0.5, 0)])
        seen.append(collect_actions(Go1Env(world, 2, EnvConfig().clean()), oracle, oracle, 4, noise)[0])
    np.testing.assert_array_equal(seen[0][:2], seen[1][:2])
    assert not np.array_equal(seen[0][2:], seen[1][2:])


# --- what is learned -------------------------------------------------------------------


def test_a_student_learns_a_linear_teacher():
    x = states(2000)
    weights = np.random.default_rng(1).standard_normal((OBS_DIM, ACTION_DIM)) / OBS_DIM**0.5
    weights = (weights + OBS_MIRROR(ACTION_MIRROR(weights).T).T) / 2  # a teacher that knows left from right: W M = M' W
    # Scandots are scaled by 1 / 0.3 and would be clipped at +-5: small ones here.
    x[:, SCANDOTS] *= 0.2
    y = (x @ weights).astype(np.float32)
    student, losses = policy_of(x, y)
    fresh = states(500, 2)
    fresh[:, SCANDOTS] *= 0.2
    error = ((student(fresh) - fresh @ weights) ** 2).mean()
    assert losses[-1] < 0.1 * losses[0] and error < 0.15 * y.var()


def test_the_normaliser_is_that_of_the_states_seen():
    x = 3.0 + 2.0 * states(400)
    arrays, _ = fit_student(x, np.zeros((400, ACTION_DIM), np.float32), (8,), DistillConfig(epochs=1), 0)
    free = np.delete(np.arange(OBS_DIM), np.r_[SCANDOTS])
    both = np.concatenate([x, OBS_MIRROR(x)])[:, free]
    np.testing.assert_allclose(arrays["normalizer.mean"][free], both.mean(axis=0), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(arrays["normalizer.var"][free], both.var(axis=0), rtol=1e-5)
    np.testing.assert_allclose(arrays["normalizer.mean"][SCANDOTS], 0.0)
    np.testing.assert_allclose(arrays["normalizer.var"][SCANDOTS], 0.09)
    assert arrays["normalizer.count"] == 400


def test_a_student_knows_left_from_right():
    x, y = states(300), states(300, 1)[:, :ACTION_DIM]  # whatever the teacher does
    student, _ = policy_of(x, y)
    assert np.abs(student(x)).max() > 0.1
    np.testing.assert_allclose(student(OBS_MIRROR(x)), ACTION_MIRROR(student(x)), atol=1e-5)


def test_a_student_is_a_start_without_a_critic():
    arrays, _ = fit_student(states(50), states(50, 1)[:, :ACTION_DIM], (8,), DistillConfig(epochs=1), 0)
    learner = Learner.create(OBS_MIRROR, ACTION_MIRROR, PPOConfig(hidden=(8,)), 1, fixed=SCANDOTS)
    critic = {name: p.detach().clone() for name, p in learner.net.critic.named_parameters()}
    warm_start(learner, arrays, 50, 0.3, critic_steps=100)
    for name, array in policy_arrays(learner).items():
        np.testing.assert_array_equal(array, arrays[name], err_msg=name)
    assert all(p.equal(critic[name]) for name, p in learner.net.critic.named_parameters())
    assert learner.actor_start == 150 and learner.actor_rests and learner.normalizer.count == 50


def test_a_seed_decides_the_student():
    x, y = states(200), states(200, 1)[:, :ACTION_DIM]
    first, again, other = (policy_of(x, y, seed=seed)[0] for seed in (0, 0, 1))
    assert first.digest() == again.digest() != other.digest()


def test_fine_tuning_replaces_what_both_have():
    ppo = FineTuneConfig(std=0.3, num_steps=7, target_kl=0.004, ent_coef=0.2).apply(PPOConfig())
    expected = replace(
        PPOConfig(),
        num_steps=7,
        target_kl=0.004,
        ent_coef=0.2,
        critic_learning_rate=5e-4,
        learning_rate_min=1e-5,
        anneal_share=1.0,
    )
    assert ppo == expected


def test_the_students_step_size_falls(monkeypatch):
    seen, fit = [], imitation.fit
    monkeypatch.setattr(imitation, "fit", lambda *a, **k: seen.append(k) or fit(*a, **k))
    x = np.zeros((8, 184), np.float32)
    fit_student(x, x[:, :12], (4,), DistillConfig(epochs=1), 0)
    assert seen == [{"anneal": True}]


# --- the supervised selector ------------------------------------------------------------


def separable(n, seed):
    """Scandots whose label is the sector that two of them point to, in the middle of the first and the second row."""
    x = np.random.default_rng(seed).uniform(-1, 1, (n, NUM_SCANDOTS)).astype(np.float32)
    return x, np.where(x[:, 5] > 0.3, 2, np.where(x[:, 16] > 0, 1, 0))


def test_fit_selector_learns_a_separable_problem():
    config = SupervisedConfig(epochs=15, batch_size=64, hidden=(32,))
    arrays, losses = fit_selector(*separable(3000, 0), 3, config, seed=0)
    assert losses[0] > 3 * losses[-1]
    selector = Policy.from_arrays(arrays, {"policy": "ps-sl", "act_dim": 3})
    assert selector.obs_dim == NUM_SCANDOTS
    x, label = separable(1000, 1)
    assert (selector(x).argmax(axis=1) == label).mean() > 0.9


def test_a_selector_chooses_alike_for_what_is_mirrored():
    arrays, _ = fit_selector(*separable(500, 0), 3, SupervisedConfig(epochs=5, batch_size=64, hidden=(16,)), seed=0)
    selector = Policy.from_arrays(arrays, {})
    x, _ = separable(200, 1)
    assert np.ptp(selector(x)) > 0.5
    np.testing.assert_allclose(selector(SCANDOT_MIRROR(x)), selector(x), atol=1e-5)


def test_fit_selector_is_reproducible():
    config = SupervisedConfig(epochs=2, batch_size=64, hidden=(8,))
    data = separable(200, 0)
    a, b, other = (fit_selector(*data, 3, config, seed)[0] for seed in (0, 0, 1))
    np.testing.assert_array_equal(a["actor.0.weight"], b["actor.0.weight"])
    assert (a["actor.0.weight"] != other["actor.0.weight"]).any()


def test_first_loss_is_that_of_guessing():
    # a new network is near uniform over 3 skills: -log(1/3)
    config = SupervisedConfig(epochs=1, batch_size=10_000, hidden=(8,))
    _, losses = fit_selector(*separable(500, 0), 3, config, seed=0)
    assert losses[0] == pytest.approx(np.log(3), abs=0.05)


def test_collected_labels_are_the_oracles(env, five_skills):
    oracle = oracle_hierarchy("oracle", five_skills)
    wanted = []

    class Noting(Hierarchy):
        """An actor that always walks, and writes down what the oracle would do."""

        def act(self, observation, env):
            wanted.append(env.oracle_skill())
            return super().act(observation, env)

    actor = Noting("walker", tuple(five_skills.values()), lambda o, env: np.zeros(len(o), int), np.arange(5))
    scandots, labels = collect_labels(env, actor, oracle, 38)
    assert scandots.shape == (39, NUM_SCANDOTS)  # thirteen steps of three robots
    np.testing.assert_array_equal(labels, np.concatenate(wanted))


def test_action_noise_is_drawn_anew(env, five_skills, monkeypatch):
    taken, step = [], env.step
    monkeypatch.setattr(env, "step", lambda action: taken.append(action) or step(action))
    still = Single("still", lambda o: np.zeros((len(o), 12)))
    list(visit(env, still, 400, 0.5))
    assert np.mean(taken) == pytest.approx(0.0, abs=0.05) and np.std(taken) == pytest.approx(0.5, abs=0.05)


def test_a_selectors_normaliser_is_that_of_the_scandots():
    arrays, _ = fit_selector(*separable(50, 0), 3, SupervisedConfig(epochs=1, hidden=(4,)), 0)
    assert not arrays["normalizer.mean"].any()
    np.testing.assert_allclose(arrays["normalizer.var"], 0.09)


# --- gradient steps ---------------------------------------------------------------------


def test_fit_takes_adams_steps():
    # Adam's first step is the step size times the sign of the gradient: 1 - 0.1, then further down.
    x = torch.nn.Parameter(torch.tensor([1.0]))
    config = DistillConfig(epochs=1, batch_size=1, learning_rate=0.1)
    assert fit([x], lambda mb: (x**2).sum(), 1, config, seed=0) == [1.0]
    np.testing.assert_allclose(x.detach(), [0.9], atol=1e-6)


def test_fit_meets_every_state_once_an_epoch_and_averages_over_them():
    seen = []
    x = torch.nn.Parameter(torch.zeros(1))

    def loss(mb):
        seen.append(mb.tolist())
        return mb.float().mean() + 0.0 * x.sum()

    losses = fit([x], loss, 5, DistillConfig(epochs=2, batch_size=2, learning_rate=0.1), seed=0)
    assert [len(mb) for mb in seen] == [2, 2, 1] * 2
    for epoch in (seen[:3], seen[3:]):
        assert sorted(state for mb in epoch for state in mb) == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(losses, [2.0, 2.0])  # (0 + 1 + 2 + 3 + 4) / 5, though batches differ in size


def test_an_annealed_fit_ends_with_small_steps():
    # A constant gradient makes each of Adam's steps the step size: 0.1 (1 + 3/4 + 2/4 + 1/4) = 0.25
    for anneal, expected in ((False, -0.4), (True, -0.25)):
        x = torch.nn.Parameter(torch.zeros(1))
        config = DistillConfig(epochs=1, batch_size=1, learning_rate=0.1)
        fit([x], lambda mb, x=x: x.sum(), 4, config, seed=0, anneal=anneal)
        np.testing.assert_allclose(x.detach(), [expected], atol=1e-6)

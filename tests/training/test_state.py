"""A learner as arrays: written, read, gone on from, and started from."""

from copy import deepcopy
from dataclasses import replace

from agility_ref.errors import UserError
from agility_ref.policy import Policy
from agility_ref.ppo import collect, train, update
from agility_ref.training.state import learner_state, load_learner, policy_arrays, warm_start

import numpy as np
import pytest
import torch
from line import TINY, FakeEnv, make, trained


def all_arrays(learner):
    return policy_arrays(learner) | learner_state(learner)


def assert_same(a, b):
    assert a.keys() == b.keys()
    for name in a:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def resumed(learner, config=TINY):
    other = make(seed=99, config=config)
    load_learner(other, all_arrays(learner))
    return other


def test_state_round_trip():
    original, _ = trained(3)
    assert_same(all_arrays(resumed(original)), all_arrays(original))


def test_resumed_learner_goes_on_identically():
    original, _ = trained(3)
    copy = resumed(original)
    assert copy.learning_rate == original.learning_rate
    for learner in (original, copy):
        env = FakeEnv()
        update(learner, collect(env, learner, env.reset(5)[0])[0])
    assert_same(all_arrays(copy), all_arrays(original))


def test_resuming_needs_adams_moments():
    # Without them the next step differs: the round trip above is not vacuous.
    original, _ = trained(3)
    copy = make(seed=99)
    load_learner(copy, {name: a for name, a in all_arrays(original).items() if not name.endswith((".step", "exp_avg"))})
    for learner in (original, copy):
        env = FakeEnv()
        update(learner, collect(env, learner, env.reset(5)[0])[0])
    assert not np.array_equal(policy_arrays(original)["actor.0.weight"], policy_arrays(copy)["actor.0.weight"])


def test_arrays_are_copies():
    learner = trained(1)[0]
    kept = all_arrays(learner)
    values = deepcopy(kept)
    list(train(FakeEnv(), learner, 2 * TINY.batch_size))
    assert_same(kept, values)
    assert not np.array_equal(kept["actor.0.weight"], all_arrays(learner)["actor.0.weight"])


def test_loading_copies_too():
    arrays = all_arrays(trained(1)[0])
    values, other = deepcopy(arrays), make(1)
    load_learner(other, arrays)
    list(train(FakeEnv(), other, TINY.batch_size))
    assert_same(arrays, values)


def test_a_policy_file_is_what_the_network_does():
    learner = trained(3)[0]
    x = np.random.default_rng(0).standard_normal((40, 2)).astype(np.float32)
    with torch.no_grad():
        expected = learner.net.actor(learner.observe(x)).numpy()
    assert np.abs(expected).max() > 0.01
    np.testing.assert_allclose(Policy.from_arrays(policy_arrays(learner), {})(x), expected, atol=1e-5)


@pytest.mark.parametrize("spoil, message", [
    (lambda arrays: all_arrays(make(config=replace(TINY, hidden=(8,)))),
     "checkpoint has net.actor.own.0.weight of shape (4, 1), this network (8, 1)"),
    (lambda arrays: {name: a for name, a in arrays.items() if not name.startswith("net.critic.")},
     "checkpoint has net.critic.own.0.weight of shape None, this network (8, 1)"),
])  # fmt: skip
def test_another_network_is_refused(spoil, message):
    with pytest.raises(UserError) as refusal:
        load_learner(make(), spoil(all_arrays(make())))
    assert str(refusal.value) == message


# --- warm starts -----------------------------------------------------------------------


def without_critic(learner):
    """Return the arrays of a distilled policy: what acts, the actor's blocks, and how many states were seen."""
    arrays = all_arrays(learner)
    return {
        name: a for name, a in arrays.items()
        if name.startswith(("actor.", "net.actor.", "normalizer."))
    }  # fmt: skip


def test_a_start_takes_over_everything_but_noise_and_moments():
    source, learner = trained(3, seed=1)[0], make(seed=2)
    warm_start(learner, all_arrays(source), steps=100, std=0.25, critic_steps=1000)
    assert_same(policy_arrays(learner), policy_arrays(source))
    found, expected = learner_state(learner), learner_state(source)
    for name in expected:
        if name.startswith("net.") and name != "net.log_std":
            np.testing.assert_array_equal(found[name], expected[name], err_msg=name)
    assert found["normalizer.count"] == expected["normalizer.count"] == 3 * TINY.batch_size
    np.testing.assert_allclose(learner.net.std().detach(), 0.25, rtol=1e-6)
    assert not any(name.endswith("exp_avg") for name in found)
    assert learner.steps == learner.start == 100


def test_a_start_without_a_critic_rests_the_actor():
    source, learner = trained(3, seed=1)[0], make(seed=2)
    new = learner_state(learner)
    warm_start(learner, without_critic(source), steps=100, std=0.25, critic_steps=3 * TINY.batch_size)
    started = learner_state(learner)
    assert_same(policy_arrays(learner), policy_arrays(source))
    for name in new:
        if name.startswith("net.critic."):
            np.testing.assert_array_equal(started[name], new[name])
    np.testing.assert_allclose(started["net.log_std"], np.log(0.25), rtol=1e-6)
    moved = []
    for _ in train(FakeEnv(), learner, 100 + 5 * TINY.batch_size):
        now = learner_state(learner)
        moved.append(
            [
                not np.array_equal(now[f"net.{net}.own.0.weight"], started[f"net.{net}.own.0.weight"])
                for net in ("actor", "critic")
            ]
        )
    assert moved == [[False, True]] * 3 + [[True, True]] * 2


def test_a_start_with_a_critic_rests_nobody():
    learner = make(seed=2)
    warm_start(learner, all_arrays(make(seed=1)), steps=100, std=0.25, critic_steps=1000)
    assert not learner.actor_rests and learner.learning_rate == TINY.learning_rate


def test_a_resumed_learner_rests_as_long():
    learner = make()
    warm_start(learner, without_critic(make(seed=1)), steps=100, std=0.25, critic_steps=1000)
    copy = resumed(learner)
    assert copy.actor_start == 1100


def test_a_start_without_a_critic_begins_with_small_steps():
    learner = make()
    warm_start(learner, without_critic(make(seed=1)), steps=100, std=0.25, critic_steps=1000)
    assert learner.learning_rate == TINY.learning_rate_min


def test_a_start_from_another_network_is_refused():
    source = make(config=replace(TINY, hidden=(8,)))
    with pytest.raises(UserError, match=r"net\.actor\.own\.0\.weight of shape \(4, 1\), this network \(8, 1\)"):
        warm_start(make(), all_arrays(source), steps=100, std=0.25)

"""Public tests: three steps of two robots, by hand."""

import adapters
import numpy as np
import pytest
import torch
from adapters import RUNNING, TERMINATED, TRUNCATED

NAN = np.nan


def advantages(rewards, values, final_values, ends, lam=0.5):
    rewards, values = np.array(rewards, float), np.array(values, float)
    got = adapters.gae(rewards, values, np.array(final_values, float), np.array(ends), 0.5, lam)
    assert np.shape(got) == (2, *rewards.shape), "gae returns advantages and targets, both (N, T): one row per robot"
    assert np.allclose(got[1] - got[0], values[:, :-1], equal_nan=True), (
        "a target is the advantage plus the value of the state"
    )
    return np.asarray(got[0])


def test_gae_by_hand():
    # gamma = lambda = 1/2.  delta = 1 + 2 - 2, 1 + 1 - 4, 1 + 4 - 2 = 1, -2, 3; A = 1 - 1/2 + 3/16, -2 + 3/4, 3
    got = advantages([[1, 1, 1]], [[2, 4, 2, 8]], [[NAN] * 3], [[RUNNING] * 3])
    expected = np.array([[0.6875, -1.25, 3.0]])
    assert np.allclose(got, expected), f"an episode that goes on: {expected}, not {got}"
    got = advantages([[1, 1, 1]], [[2, 4, 2, 8]], [[NAN] * 3], [[RUNNING, TERMINATED, RUNNING]])
    expected = np.array([[0.25, -3.0, 3.0]])
    assert np.allclose(got, expected), f"a fall in step 1: nothing follows, {expected}, not {got}"


def test_gae_truncated_by_hand():
    got = advantages([[1, 1, 1]], [[2, 4, 2, 8]], [[NAN, 6, NAN]], [[RUNNING, TRUNCATED, RUNNING]])
    expected = np.array([[1.0, 0.0, 3.0]])
    assert np.allclose(got, expected), (
        f"cut off in step 1 in a state of value 6: delta = 1 + 6/2 - 4 = 0, so {expected}, not {got}; "
        "the value of the next episode's first state has no business there"
    )


def test_surrogate_by_hand():
    new, old = torch.log(torch.tensor([1.5, 1.5, 0.5, 1.1])), torch.zeros(4)
    got = float(adapters.surrogate(new, old, torch.tensor([1.0, -1.0, 1.0, 2.0]), 0.2))
    expected = (1.2 - 1.5 + 0.5 + 2.2) / 4
    assert got != pytest.approx(-expected), "the objective is to be maximised: the sign is the other one"
    assert got == pytest.approx(expected), f"(1.2 - 1.5 + 0.5 + 2.2) / 4 = {expected:.3f}, not {got:.3f}"


def test_rate_by_hand():
    c = adapters.Config(target_kl=0.02, lowest_rate=1e-4, highest_rate=1e-3)
    for kl, rate, expected in [
        (0.02, 5e-4, 5e-4),
        (0.05, 6e-4, 5e-4),
        (0.005, 5e-4, 6e-4),
        (0.001, 9e-4, 1e-3),
        (0.9, 1.1e-4, 1e-4),
    ]:
        got = adapters.next_rate(rate, kl, c)
        assert got == pytest.approx(expected), f"KL {kl}, target 0.02, step size {rate}: {expected}, not {got}"


def test_normaliser_by_hand():
    n = adapters.Normaliser(2)
    n.update(np.array([[0.0, 5.0], [2.0, 5.0]]))
    n.update(np.array([[7.0, 5.0]]))
    assert n.count == 3 and np.allclose(n.mean, [3, 5]), f"of 0, 2, 7 the mean is 3, not {n.mean[0]}"
    assert np.allclose(n.variance, [26 / 3, 0]), f"of 0, 2, 7 the variance is 26/3 (divide by n), not {n.variance[0]}"
    got = n(np.array([[3.0, 5.0], [1e9, 5.1]]))
    assert got.dtype == np.float32 and np.allclose(got, [[0, 0], [5, 5]]), f"within +-5, float32: not {got}"
    assert n.count == 3, "normalising takes note of nothing: only update does"

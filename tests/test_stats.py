import doctest
import importlib
import pkgutil

import numpy as np
import pytest

import agility_ref
from agility_ref.stats import bootstrap_interval, iqm, paired_difference, wilson_interval


def modules():
    return [f"agility_ref.{m.name}" for m in pkgutil.iter_modules(agility_ref.__path__) if m.name != "__main__"]


@pytest.mark.parametrize("name", modules())
def test_doctests(name):
    assert doctest.testmod(importlib.import_module(name)).failed == 0


def test_stats_has_doctests():
    assert doctest.testmod(importlib.import_module("agility_ref.stats")).attempted > 0


def test_iqm_by_hand():
    # 8 numbers: the lowest two and the highest two go; (2 + 3 + 4 + 5) / 4
    assert iqm(np.array([100.0, 5.0, -50.0, 3.0, 0.0, 4.0, 2.0, 99.0])) == 3.5


def test_iqm_ignores_outliers():
    scores = np.arange(20.0)
    wild = scores.copy()
    wild[-1] = 1e9
    assert iqm(wild) == iqm(scores)


def test_iqm_pools_all_axes():
    scores = np.random.default_rng(0).standard_normal((3, 8))
    assert iqm(scores) == iqm(scores.ravel())


def test_iqm_of_one_score():
    assert iqm(np.array([3.0])) == 3.0


def test_bootstrap_interval_of_a_constant():
    assert bootstrap_interval(np.full((2, 5), 3.0), resamples=50) == (3.0, 3.0)


def test_bootstrap_interval_is_reproducible():
    scores = np.random.default_rng(0).standard_normal((3, 10))
    assert bootstrap_interval(scores, seed=1) == bootstrap_interval(scores, seed=1)
    assert bootstrap_interval(scores, seed=1) != bootstrap_interval(scores, seed=2)


def test_bootstrap_frozen_values():
    # Guards published intervals against a silent change of the resampling.
    scores = np.array([[0.0, 1.0, 2.0, 3.0], [1.0, 2.0, 3.0, 10.0]])
    assert iqm(scores) == 2.0  # 0 1 | 1 2 2 3 | 3 10
    low, high = bootstrap_interval(scores)
    assert (low, high) == pytest.approx((0.75, 5.75625), abs=1e-12)


def test_bootstrap_interval_of_a_known_distribution():
    # Seeds (0, 1) and (10, 12), means.  The first seed is drawn twice with probability 1/4, and then
    # the mean is 0 with 1/16 and 0.25 with 4/16: 1.6 % lie at 0, 7.8 % at or below 0.25, where the
    # 2.5th percentile is.  Twice the second: 12 with 1.6 %, 11.5 at or above with 7.8 %.
    scores = np.array([[0.0, 1.0], [10.0, 12.0]])
    assert bootstrap_interval(scores, np.mean, resamples=20_000) == (0.25, 11.5)


def test_bootstrap_interval_agrees_with_a_loop():
    # One resample at a time, from another stream of random numbers.
    scores = np.random.default_rng(1).standard_normal((3, 12)) + np.arange(3)[:, None]
    rng, values = np.random.default_rng(2), []
    for _ in range(8000):
        rows = [scores[s] for s in rng.choice(3, 3)]
        values.append(iqm(np.concatenate([rng.choice(row, 12) for row in rows])))
    assert bootstrap_interval(scores, resamples=8000) == pytest.approx(np.percentile(values, [2.5, 97.5]), abs=0.08)


def test_iqm_along_an_axis():
    scores = np.random.default_rng(0).standard_normal((4, 3, 10))
    for axis in range(3):
        rows = np.moveaxis(scores, axis, -1).reshape(-1, scores.shape[axis])
        np.testing.assert_allclose(iqm(scores, axis).ravel(), [iqm(row) for row in rows])


def test_bootstrap_interval_covers_the_mean():
    # 95 % intervals of 150 data sets: the true mean 0 lies outside of 5 % or so
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(150):
        low, high = bootstrap_interval(rng.standard_normal(40), np.mean, resamples=200)
        hits += low <= 0.0 <= high
    assert 0.88 <= hits / 150 <= 0.99


def test_bootstrap_level_widens():
    scores = np.random.default_rng(0).standard_normal((4, 20))
    low90, high90 = bootstrap_interval(scores, level=0.9)
    low99, high99 = bootstrap_interval(scores, level=0.99)
    assert low99 < low90 < high90 < high99


def test_spread_between_seeds_counts():
    # Equal pooled scores; rows that disagree leave more doubt than rows that agree.
    agree = np.tile(np.arange(8.0), (4, 1))
    disagree = np.sort(agree.ravel()).reshape(4, 8)
    widths = [np.diff(bootstrap_interval(s, np.mean))[0] for s in (agree, disagree)]
    assert widths[1] > 1.5 * widths[0]


def test_paired_difference_by_hand():
    # 3 - 1, 5 - 2, 7 - 6: mean (2 + 3 + 1) / 3
    mean, low, high = paired_difference(np.array([3.0, 5.0, 7.0]), np.array([1.0, 2.0, 6.0]))
    assert mean == pytest.approx(2.0)
    assert 1.0 <= low <= mean <= high <= 3.0


def test_pairing_removes_the_common_part():
    rng = np.random.default_rng(0)
    difficulty = 10.0 * rng.standard_normal((1, 50))
    a = difficulty + 1.0 + 0.1 * rng.standard_normal((1, 50))
    mean, low, high = paired_difference(a, difficulty)
    assert mean == pytest.approx(1.0, abs=0.05)
    assert 0.9 < low < high < 1.1


def test_paired_difference_changes_sign_with_its_arguments():
    rng = np.random.default_rng(0)
    a, b = rng.standard_normal((2, 3, 10))
    mean, low, high = paired_difference(a, b)
    assert paired_difference(b, a) == pytest.approx((-mean, -high, -low), abs=0.02)


@pytest.mark.parametrize("successes, trials, low, high", [
    (0, 10, 0.0, 0.2775),  # 3.8416 / 13.8416
    (10, 10, 0.7225, 1.0),
    (50, 100, 0.4038, 0.5962),
])  # fmt: skip
def test_wilson_reference_values(successes, trials, low, high):
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=1e-4)

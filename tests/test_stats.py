import doctest
import importlib
import pkgutil

import agility_ref
from agility_ref.stats import bootstrap_interval, iqm, paired_difference, t_interval, wilson_interval

import numpy as np
import pytest


def modules():
    found = pkgutil.walk_packages(agility_ref.__path__, "agility_ref.")
    return [module.name for module in found if module.name != "agility_ref.__main__"]


@pytest.mark.parametrize("name", modules())
def test_doctests(name):
    if name == "agility_ref.gym":
        pytest.importorskip("gymnasium")
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
    assert (low, high) == pytest.approx((0.5, 6.5), abs=1e-12)


def test_bootstrap_interval_of_a_known_distribution():
    # Seeds (0, 1) and (10, 12), means.  The first seed is drawn twice with probability 1/4 and its first
    # episode twice with 1/4: 6.25 % of the resamples have a mean of 0, more than the 2.5 % below the
    # interval.  As many have the second seed and its second episode alone.  (With episodes drawn anew for
    # each seed it would be 1/4 x 1/16 = 1.6 %, and the interval 0.25 to 11.5.)
    scores = np.array([[0.0, 1.0], [10.0, 12.0]])
    assert bootstrap_interval(scores, np.mean, resamples=20_000) == (0.0, 12.0)


def test_bootstrap_interval_agrees_with_a_loop():
    # One resample at a time, from another stream of random numbers.
    scores = np.random.default_rng(1).standard_normal((3, 12)) + np.arange(3)[:, None]
    rng, values = np.random.default_rng(2), []
    for _ in range(8000):
        columns = rng.choice(12, 12)
        values.append(iqm(np.concatenate([scores[s][columns] for s in rng.choice(3, 3)])))
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


@pytest.mark.parametrize("seeds, covered", [(2, 0.50), (3, 0.73), (5, 0.84)])
def test_few_seeds_are_covered_as_the_docstring_says(seeds, covered):
    rng = np.random.default_rng(0)
    intervals = [bootstrap_interval(rng.standard_normal((seeds, 1)), np.mean, resamples=500) for _ in range(500)]
    assert np.mean([low <= 0.0 <= high for low, high in intervals]) == pytest.approx(covered, abs=0.05)


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
    assert widths[1] > 1.3 * widths[0]


def test_courses_shared_by_the_seeds_are_not_counted_once_a_seed():
    # Seeds that agree to the last bit say no more than one of them.
    one = np.random.default_rng(0).standard_normal((1, 30))
    low, high = bootstrap_interval(one, np.mean)
    assert bootstrap_interval(np.tile(one, (5, 1)), np.mean) == pytest.approx((low, high), abs=0.05)


def test_t_interval_covers_the_mean_of_three():
    # 95 % of 2000 triples; a percentile bootstrap of three would cover 75 %
    rng = np.random.default_rng(0)
    inside = [low < 0.0 < high for low, high in (t_interval(rng.standard_normal(3)) for _ in range(2000))]
    assert 0.93 < np.mean(inside) < 0.97
    assert t_interval(np.array([1.0])) == (-np.inf, np.inf)


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


def test_wilson_never_leaves_0_to_1():
    for n in range(1, 300):
        assert 0.0 <= wilson_interval(0, n)[0] < 1e-12 and 1.0 - 1e-12 < wilson_interval(n, n)[1] <= 1.0


@pytest.mark.parametrize("n", range(2, 13))  # as many as the table has
def test_student_quantiles_against_the_density(n):
    """The density (1 + x^2 / f)^(-(f + 1) / 2), summed up to the half width over s / sqrt(n), holds 95 %."""
    values = np.arange(n, dtype=float)
    low, high = t_interval(values)
    t = (high - low) / 2 / (values.std(ddof=1) / np.sqrt(n))
    x = np.tan((np.arange(200_000) + 0.5) / 200_000 * np.pi / 2)  # dx = (1 + x^2) du: the tail is finite
    weight = (1 + x**2 / (n - 1)) ** (-n / 2) * (1 + x**2)
    assert weight[x <= t].sum() / weight.sum() == pytest.approx(0.95, abs=2e-4)


def test_paired_difference_is_of_means():
    """One episode in ten is better by 1: the middle half, on which an IQM stands, is not."""
    a = np.tile([1.0] + [0.0] * 9, 10)
    mean, low, high = paired_difference(a, np.zeros(100))
    assert mean == pytest.approx(0.1) and 0.03 < low < 0.1 < high < 0.2


def test_iqm_rounds_the_quarter_down():
    assert iqm(np.array([0.0, 1, 2, 3, 4, 5, 20])) == 3.0  # of 7 one goes at each end: (1 + 2 + 3 + 4 + 5) / 5

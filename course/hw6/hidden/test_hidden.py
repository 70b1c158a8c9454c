"""Hidden tests: closed forms, and coverage by simulation."""

from agility_ref import stats

import adapters
import numpy as np
import pytest
from adapters import Interval


def width(interval):
    return interval.high - interval.low


def test_iqm_weighs_half(seed):
    rng = np.random.default_rng(seed)
    quarters = rng.normal(size=4 * rng.integers(3, 9))
    assert adapters.iqm(quarters) == pytest.approx(stats.iqm(quarters)), (
        "sort the scores, then n / 4 come off either end"
    )
    for n in rng.integers(5, 40, 6):
        # each score four times over: the weights become whole numbers
        scores = rng.normal(size=n)
        expected = stats.iqm(np.repeat(scores, 4))
        got = adapters.iqm(scores)
        assert got == pytest.approx(expected), (
            f"of {n} scores the middle half weighs {n / 2:g}: {expected:.4f}, not {got:.4f}; do scores at its borders "
            "count with a fraction, and are the scores sorted?"
        )


def test_bootstrap_width(seed):
    """One seed: the standard error of a mean of E episodes is std / sqrt(E)."""
    scores = np.random.default_rng(seed).normal(size=(200, 1))
    got = adapters.bootstrap(scores, np.mean, np.random.default_rng(seed), 2000)
    assert got.value == pytest.approx(scores.mean()), "value is the statistic of the scores themselves"
    ratio = width(got) / (2 * 1.96 * scores.std() / np.sqrt(200))
    assert 0.9 < ratio < 1.1, f"the interval of a mean is {ratio:.2f} times as wide as 2 x 1.96 standard errors"
    narrow = adapters.bootstrap(scores, np.mean, np.random.default_rng(seed), 2000, level=0.5)
    ratio = width(narrow) / (2 * 0.674 * scores.std() / np.sqrt(200))
    assert 0.88 < ratio < 1.12, f"at level 0.5 it is {ratio:.2f} times as wide as 2 x 0.674 standard errors"


def test_bootstrap_resamples_whole_episodes(seed):
    """Five copies of one seed know no more than that seed."""
    rng = np.random.default_rng(seed)
    one = rng.normal(size=(100, 1))
    single = width(adapters.bootstrap(one, np.mean, np.random.default_rng(seed), 1000))
    copies = width(adapters.bootstrap(np.repeat(one, 5, axis=1), np.mean, np.random.default_rng(seed), 1000))
    assert 0.8 < copies / single < 1.25, (
        f"five identical seeds make the interval {copies / single:.2f} times as wide as one: draw episodes as whole rows"
    )


def test_bootstrap_resamples_whole_seeds(seed):
    """If only seeds differ, more episodes tell nothing."""
    rng = np.random.default_rng(seed)
    seeds = rng.normal(size=(1, 8))
    few, many = (
        width(adapters.bootstrap(np.repeat(seeds, n, axis=0), np.mean, np.random.default_rng(seed), 1000))
        for n in (3, 90)
    )
    expected = 2 * 1.96 * seeds.std() / np.sqrt(8)
    assert 0.75 < few / expected < 1.2, (
        f"where only seeds differ the interval is {few / expected:.2f} times as wide as it should"
    )
    assert 0.8 < many / few < 1.25, (
        f"30 times the episodes, and the interval is {many / few:.2f} times as wide: draw whole seeds"
    )


def test_bootstrap_uses_the_statistic(seed):
    scores = np.random.default_rng(seed).normal(size=(60, 3))
    scores[0] = 1e6
    got = adapters.bootstrap(scores, lambda x: float(np.median(x)), np.random.default_rng(seed), 300)
    assert got.high < 1.0, f"the interval of a median reaches {got.high:.3g}: use the statistic that is handed in"


def test_paired_is_new_minus_old(seed):
    rng = np.random.default_rng(seed)
    old = rng.normal(size=(50, 3))
    new = old + 0.3
    got = adapters.paired(old, new, np.random.default_rng(seed), 200)
    assert got.value > 0, "paired(old, new) is new - old: positive where the new one is better"
    assert got.value == pytest.approx(0.3), f"every score is 0.3 higher, the difference is {got.value:.3f}"
    assert width(got) < 1e-9, (
        f"every episode differs by 0.3, yet the interval is {width(got):.3f} wide: pair before resampling"
    )


def test_paired_is_the_mean(seed):
    rng = np.random.default_rng(seed)
    old, new = rng.normal(size=(40, 3)), rng.exponential(size=(40, 3))
    got = adapters.paired(old, new, np.random.default_rng(seed), 400)
    expected = stats.paired_difference(new.T, old.T)
    assert got.value == pytest.approx(expected[0]), "the difference of the means, of all scores"
    ratio = width(got) / (expected[2] - expected[1])
    assert 0.8 < ratio < 1.25, f"the interval is {ratio:.2f} times as wide as it should be"


def test_verdict_at_the_border(seed):
    margin = float(np.random.default_rng(seed).uniform(0.05, 0.5))
    for interval, claim in [
        ((0.1, 0.0, 0.2), "better"),
        ((-0.1, -0.2, 0.0), "better"),
        ((-0.1, -0.2, 0.0), "worse"),
        ((0.0, -margin, margin), "alike"),
        ((2 * margin, margin, 3 * margin), "alike"),
    ]:
        got = adapters.verdict(Interval(*interval), claim, margin, 9)
        assert got == "open", f"{claim}, and an end of the interval on the border settles nothing: open, not {got}"
    got = adapters.verdict(Interval(0.0, -margin / 2, margin * 0.9), "alike", margin, 3)
    assert got == "supported", f"alike means within +-margin, with an interval around 0 inside it: supported, not {got}"


def test_verdict_refuses_other_claims(seed):
    adapters.verdict(Interval(0.1, 0.05, 0.2), "better", 0.1, 3)
    with pytest.raises(ValueError, match="larger"):
        adapters.verdict(Interval(0.1, 0.05, 0.2), "larger", 0.1, seed + 1)


def test_coverage_counts(seed):
    """An interval of a known quantile covers with a known probability."""

    def fixed(scores, rng):
        return Interval(0.0, float(scores.min()), float(scores.max()))

    # the median lies between the extremes of n numbers with probability 1 - 2^(1 - n)
    got = adapters.coverage(lambda rng: rng.normal(size=(3, 1)), fixed, 0.0, np.random.default_rng(seed), 2000)
    assert 0.71 < got < 0.79, f"the extremes of 3 numbers hold the median in 75 % of all experiments, not in {got:.0%}"
    ends = adapters.coverage(lambda rng: np.zeros((3, 1)), fixed, 0.0, np.random.default_rng(seed), 5)
    assert ends == 1.0, "a truth that lies on an end of the interval is inside"


def test_coverage_of_the_bootstrap(seed):
    """With many seeds the interval holds what it promises; with three it does not."""
    rng = np.random.default_rng(seed)

    def experiment(seeds):
        return lambda rng: rng.normal(size=(1, seeds))

    def interval(scores, rng):
        return adapters.bootstrap(scores, np.mean, rng, 100)

    many = adapters.coverage(experiment(30), interval, 0.0, rng, 100)
    few = adapters.coverage(experiment(3), interval, 0.0, rng, 100)
    assert many > 0.8, f"with 30 seeds the 95 % interval covers {many:.0%}"
    assert few < 0.88, f"with 3 seeds the bootstrap covers too rarely, about 73 %; yours {few:.0%}: is it too wide?"

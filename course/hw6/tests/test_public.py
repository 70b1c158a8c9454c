"""Public tests: what can be worked out by hand."""

import adapters
import numpy as np
import pytest
from adapters import Interval


def test_iqm_by_hand():
    assert adapters.iqm(np.arange(8)) == pytest.approx(3.5), "the middle half of 0 ... 7 is 2, 3, 4, 5"
    got = adapters.iqm(np.array([0.0, 1.0, 2.0, 3.0, 10.0]))
    assert got == pytest.approx(2.0), f"of 5 scores the weights are 0, 3/4, 1, 3/4, 0, so 2.0 and not {got}"
    got = adapters.iqm(np.array([[5.0, 0.0], [1.0, 2.0], [900.0, 3.0]]))
    assert got == pytest.approx(2.6666667), (
        f"of 0, 1, 2, 3, 5, 900 the weights are 0, 1/2, 1, 1, 1/2, 0: 8/3 and not {got}; all scores count, of any shape"
    )
    assert adapters.iqm(np.array([4.0])) == pytest.approx(4.0), "of one score it is the score itself"


def test_verdict_table():
    cases = [
        ((0.1, 0.05, 0.2), "better", 3, "supported"),
        ((-0.1, -0.2, -0.05), "better", 3, "refuted"),
        ((0.1, -0.05, 0.2), "better", 5, "open"),
        ((-0.1, -0.2, -0.05), "worse", 3, "supported"),
        ((0.01, -0.02, 0.03), "alike", 3, "supported"),
        ((0.2, 0.11, 0.3), "alike", 3, "refuted"),
        ((0.1, 0.05, 0.2), "alike", 3, "open"),
        ((0.1, 0.05, 0.2), "better", 2, "open"),
    ]
    for interval, claim, seeds, expected in cases:
        got = adapters.verdict(Interval(*interval), claim, 0.1, seeds)
        assert got == expected, (
            f"{claim} with [{interval[1]}, {interval[2]}], margin 0.1, {seeds} seeds: {expected}, not {got}"
        )


def test_bootstrap_of_one_score():
    try:
        got = adapters.bootstrap(np.full((6, 2), 3.0), np.mean, np.random.default_rng(0), 50)
    except TypeError as error:
        pytest.fail(f"bootstrap(scores, statistic, rng, resamples, level) takes a Generator, no axis or seed: {error}")
    assert isinstance(got, Interval), f"return Interval(value, low, high), not {type(got).__name__}"
    assert tuple(got) == (3.0, 3.0, 3.0), "if all scores are alike the interval is a point"

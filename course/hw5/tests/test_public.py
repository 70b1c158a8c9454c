"""Public tests: labels and choices by hand, and a first fit."""

import time

import adapters
import numpy as np
from hw5.runners import Runners


def test_labels_by_hand():
    regions = np.array([[0, 0, 1, 1, 4], [3, 3, 3, 0, 2]])  # agility_ref: walk, climb-up, climb-down, leap, beam
    course, x = np.array([0, 0, 0, 1, 1, 1]), np.array([0.1, 0.9, 9.0, -1.0, 0.5, 1.9])
    got = np.asarray(adapters.label(regions, 0.4, course, x))
    assert got.shape == (6, 5), f"labels are one-hot rows (n, 5), not {got.shape}"
    names = [adapters.SKILLS[k] for k in got.argmax(axis=1)]
    expected = ["walk", "climb-up", "beam", "leap", "leap", "climb-down"]
    assert names == expected, f"{names}, expected {expected}: the oracle's numbers and ours have different orders"
    assert np.all(np.sort(got, axis=1) == [0, 0, 0, 0, 1]), "one-hot: a single 1 in each row"


def test_choose_by_hand():
    probabilities = np.array([[0.5, 0.4, 0.1, 0, 0], [0.5, 0.4, 0.1, 0, 0], [0.5, 0.4, 0.1, 0, 0], [0.2, 0.8, 0, 0, 0]])
    got = np.asarray(adapters.choose(probabilities, np.array([1, 2, -1, 0]), 0.2)).tolist()
    expected = [1, 0, 0, 1]
    assert got == expected, f"0.5 is not 0.2 above 0.4: keep 1; it is above 0.1: take 0; nothing held: take 0; {got}"


def test_recall_by_hand():
    labels = np.eye(5)[[4, 4, 4, 4, 2, 2, 0]]
    got = np.asarray(adapters.recall(labels, np.array([4, 4, 2, 2, 2, 4, 0])))
    expected = np.array([1.0, np.nan, 0.5, np.nan, 0.5])
    assert np.allclose(got, expected, equal_nan=True), (
        f"of 4 states to walk, 2 are walked, and so on: {got}, not {expected}"
    )


def test_fit_is_quick_and_repeatable(seed):
    runners = Runners(64, seed)
    scandots, labels = adapters.collect(runners, 40, None, np.random.default_rng(seed))
    start = time.process_time()
    first = adapters.Selector().fit(scandots, labels, seed).probabilities(scandots)
    assert time.process_time() - start < 5, "fitting 2560 states takes more than 5 s of processor time"
    assert np.shape(first) == (2560, 5) and np.allclose(np.sum(first, axis=1), 1, atol=1e-4), (
        "rows (n, 5) that sum to 1"
    )
    again = adapters.Selector().fit(scandots, labels, seed).probabilities(scandots)
    assert np.array_equal(first, again), (
        "the same data and seed give other probabilities: seed everything that is random"
    )

"""From the scores of a table to what may be said about them.

Scores are arrays (E, S): one **row per episode**, one **column per training seed**.  All seeds play the
same episodes.  Every random number comes from the ``rng`` that a function is given.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np


class Interval(NamedTuple):
    """An estimate and its interval."""

    value: float
    low: float
    high: float


def iqm(scores: np.ndarray) -> float:
    """Interquartile mean of all scores: the mean of the middle half.

    Of n scores the middle half weighs n / 2, whatever n is.  Where n is no multiple of 4, the lowest and
    the highest score of the middle half count in part: the five scores 0, 1, 2, 3, 10 have the weights
    0, 3/4, 1, 3/4, 0.

    Parameters
    ----------
    scores : array of any shape, n >= 1 numbers
    """
    ### BEGIN SOLUTION
    ordered = np.sort(np.ravel(scores))
    n = len(ordered)
    # score i covers the stretch [i, i + 1] of [0, n]; its weight is what lies in [n/4, 3n/4]
    i = np.arange(n)
    weight = np.minimum(i + 1, 0.75 * n) - np.maximum(i, 0.25 * n)
    weight = np.maximum(weight, 0.0)
    return float((weight * ordered).sum() / weight.sum())
    ### END SOLUTION


def bootstrap(
    scores: np.ndarray,
    statistic: Callable[[np.ndarray], float],
    rng: np.random.Generator,
    resamples: int = 1000,
    level: float = 0.95,
) -> Interval:
    """Percentile interval of a statistic; episodes and seeds are drawn anew, each as a whole.

    A resample draws E episodes and S seeds, both with replacement, and takes the score of every drawn
    seed in every drawn episode: (E, S) scores again.  Its interval runs between those percentiles of the
    resampled statistics that leave half of ``1 - level`` on either side.

    Parameters
    ----------
    scores : (E, S)
    statistic : takes (E, S) scores
    """
    ### BEGIN SOLUTION
    episodes, seeds = scores.shape
    drawn = np.empty(resamples)
    for r in range(resamples):
        rows = rng.integers(0, episodes, episodes)
        columns = rng.integers(0, seeds, seeds)
        drawn[r] = statistic(scores[np.ix_(rows, columns)])
    tail = 50.0 * (1.0 - level)
    low, high = np.percentile(drawn, [tail, 100.0 - tail])
    return Interval(float(statistic(scores)), float(low), float(high))
    ### END SOLUTION


def paired(old: np.ndarray, new: np.ndarray, rng: np.random.Generator, resamples: int = 1000) -> Interval:
    """By how much the mean of ``new`` is higher than that of ``old``, with a 95 % interval.

    Both played the same episodes: the difference is taken episode by episode **before** anything is
    resampled, so that how hard an episode was drops out.

    Parameters
    ----------
    old, new : (E, S)
    """
    ### BEGIN SOLUTION
    return bootstrap(new - old, np.mean, rng, resamples)
    ### END SOLUTION


def verdict(difference: Interval, claim: str, margin: float, seeds: int) -> str:
    """Judge a claim about a difference: "supported", "refuted" or "open".

    Parameters
    ----------
    difference : new - old
    claim : "better", that the difference is above 0; "worse", that it is below 0; or "alike", that it
        lies within +-margin
    margin : for "alike" alone
    seeds : training seeds behind the difference; with fewer than three everything is "open"

    A claim is supported if the whole interval agrees with it, refuted if the whole interval disagrees.
    An end of the interval that lies exactly on 0, or on the margin, settles nothing.

    Raises
    ------
    ValueError : unknown claim; the message names it
    """
    ### BEGIN SOLUTION
    low, high = difference.low, difference.high
    if claim == "better":
        agrees, disagrees = low > 0, high < 0
    elif claim == "worse":
        agrees, disagrees = high < 0, low > 0
    elif claim == "alike":
        agrees, disagrees = -margin < low and high < margin, low > margin or high < -margin
    else:
        raise ValueError(f"unknown claim {claim!r}: better, worse or alike")
    if seeds < 3:
        return "open"
    return "supported" if agrees else "refuted" if disagrees else "open"
    ### END SOLUTION


def coverage(
    draw: Callable[[np.random.Generator], np.ndarray],
    interval: Callable[[np.ndarray, np.random.Generator], Interval],
    truth: float,
    rng: np.random.Generator,
    trials: int = 200,
) -> float:
    """Share of simulated experiments whose interval contains the truth.

    Parameters
    ----------
    draw : makes the scores (E, S) of one experiment
    interval : from scores to an interval, for instance your bootstrap
    truth : what the interval should contain; an end of it counts as inside
    """
    ### BEGIN SOLUTION
    inside = 0
    for _ in range(trials):
        found = interval(draw(rng), rng)
        inside += found.low <= truth <= found.high
    return inside / trials
    ### END SOLUTION

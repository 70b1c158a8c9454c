"""Statistics of a table: what may be said about a mean, and how surely.

Agarwal et al. 2021 ("Deep RL at the edge of the statistical precipice") for the
interquartile mean and the stratified bootstrap; Wilson 1927 for success rates.

In:  scores as arrays (seeds, episodes) or counts.  Out: numbers and intervals.
"""

from collections.abc import Callable

import numpy as np


def iqm(scores: np.ndarray) -> float:
    """Interquartile mean: the mean without the lowest and the highest quarter.

    >>> iqm(np.arange(8))
    3.5
    """
    ordered = np.sort(np.ravel(scores))
    cut = len(ordered) // 4
    return float(ordered[cut : len(ordered) - cut].mean())


def bootstrap_interval(
    scores: np.ndarray,
    statistic: Callable[[np.ndarray], float] = iqm,
    level: float = 0.95,
    resamples: int = 2000,
    seed: int = 0,
) -> tuple[float, float]:
    """Percentile interval of a statistic from a stratified bootstrap.

    Parameters
    ----------
    scores : (S, E) one row a training seed.  Rows are resampled first, then episodes within
        each row drawn, so that the spread between seeds counts and a row never mixes with
        another.  With one seed the interval covers the episodes alone.
    statistic : function of the resampled scores
    level : coverage
    """
    scores = np.atleast_2d(scores)
    rng = np.random.default_rng(seed)
    num_seeds, episodes = scores.shape
    values = np.empty(resamples)
    for k in range(resamples):
        rows = rng.integers(0, num_seeds, num_seeds)
        columns = rng.integers(0, episodes, (num_seeds, episodes))
        values[k] = statistic(scores[rows[:, None], columns])
    tail = 50.0 * (1.0 - level)
    low, high = np.percentile(values, [tail, 100.0 - tail])
    return float(low), float(high)


def paired_difference(a: np.ndarray, b: np.ndarray, level: float = 0.95, seed: int = 0) -> tuple[float, float, float]:
    """Mean of a - b and its interval; a and b (S, E) played the same episodes."""
    difference = np.atleast_2d(a) - np.atleast_2d(b)
    low, high = bootstrap_interval(difference, lambda x: float(x.mean()), level, seed=seed)
    return float(difference.mean()), low, high


def wilson_interval(successes: int, trials: int, z: float = 1.96) -> tuple[float, float]:
    """Wilson score interval of a success rate; z = 1.96 for 95 %.

    >>> [round(x, 4) for x in wilson_interval(8, 10)]
    [0.4902, 0.9433]
    """
    # (p + z^2/2n +- z sqrt(p(1-p)/n + z^2/4n^2)) / (1 + z^2/n)
    p, n = successes / trials, trials
    centre = p + z**2 / (2 * n)
    half = z * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    return float((centre - half) / (1 + z**2 / n)), float((centre + half) / (1 + z**2 / n))

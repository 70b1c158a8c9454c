"""Statistics of a table: what may be said about a mean, and how surely.

Agarwal et al. 2021 ("Deep RL at the edge of the statistical precipice") for the
interquartile mean and the stratified bootstrap; Wilson 1927 for success rates.

In:  scores as arrays (seeds, episodes) or counts.  Out: numbers and intervals.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np


def iqm(scores: np.ndarray, axis: int | None = None) -> float | np.ndarray:
    """Interquartile mean: the mean without the lowest and the highest quarter.

    Over all scores, or along one axis.

    >>> iqm(np.arange(8))
    3.5
    """
    ordered = np.sort(np.ravel(scores) if axis is None else np.moveaxis(scores, axis, -1), axis=-1)
    n = ordered.shape[-1]
    cut = n // 4
    middle = ordered[..., cut : n - cut].mean(axis=-1)
    return float(middle) if axis is None else middle


@lru_cache(maxsize=4)
def _resamples(num_seeds: int, episodes: int, resamples: int, seed: int) -> np.ndarray:
    """Draw which scores make up each resample: (R, S E) indices into the flattened (S, E) scores.

    Kept, because the many numbers of a table share them: each is then resampled alike.
    """
    rng = np.random.default_rng(seed)
    rows = rng.integers(0, num_seeds, (resamples, num_seeds, 1))
    columns = rng.integers(0, episodes, (resamples, num_seeds, episodes))
    drawn = (rows * episodes + columns).reshape(resamples, -1)
    drawn.flags.writeable = False
    return drawn


def bootstrap_interval(
    scores: np.ndarray,
    statistic: Callable = iqm,
    level: float = 0.95,
    resamples: int = 2000,
    seed: int = 0,
) -> tuple[float, float]:
    """Percentile interval of a statistic from a stratified bootstrap.

    Parameters
    ----------
    scores : (S, E) one row a training seed.  Rows are resampled first, then episodes within
        each row drawn, so that the spread between seeds counts and a row never mixes with
        another.  With one seed the interval covers the episodes alone; with few, resampling
        knows little of the spread between them and the interval is rather too short.
    statistic : takes an array and ``axis``, such as iqm and np.mean
    level : coverage
    """
    scores = np.atleast_2d(scores)
    drawn = scores.ravel()[_resamples(*scores.shape, resamples, seed)]  # (R, S E)
    tail = 50.0 * (1.0 - level)
    low, high = np.percentile(statistic(drawn, axis=1), [tail, 100.0 - tail])
    return float(low), float(high)


def paired_difference(a: np.ndarray, b: np.ndarray, level: float = 0.95, seed: int = 0) -> tuple[float, float, float]:
    """Mean of a - b and its interval; a and b (S, E) played the same episodes."""
    difference = np.atleast_2d(a) - np.atleast_2d(b)
    low, high = bootstrap_interval(difference, np.mean, level, seed=seed)
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

"""Statistics of a table: what may be said about a mean, and how surely.

Agarwal et al. 2021 ("Deep RL at the edge of the statistical precipice") for the
interquartile mean and bootstrap intervals of it; Owen 2007 ("The pigeonhole bootstrap") for
resampling training seeds and episodes crosswise; Wilson 1927 for success rates.

In:  scores as arrays (seeds, episodes) or counts.  Out: numbers and intervals.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

# 97.5 % quantiles of Student's t with 1, 2, ... degrees of freedom; the last serves all above.
T_975 = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201)


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
    columns = rng.integers(0, episodes, (resamples, 1, episodes))  # every training seed plays the same courses
    drawn = (rows * episodes + columns).reshape(resamples, -1)
    drawn.flags.writeable = False
    return drawn


def bootstrap_interval(
    scores: np.ndarray, statistic: Callable = iqm, level: float = 0.95, resamples: int = 2000, seed: int = 0
) -> tuple[float, float]:
    """Percentile interval of a statistic from a bootstrap over training seeds and episodes.

    Parameters
    ----------
    scores : (S, E) one row per training seed, one column per episode that all of them play.  Rows
        and columns are resampled, each as a whole: a hard course is hard for every seed, and
        drawing it anew for each would count one chance several times.  With one seed the
        interval covers the episodes alone.  With few it is too short, for resampling knows
        little of the spread between them: where only seeds differ, an interval of "95 %" of the
        mean covers about 50 % with 2 seeds, 73 % with 3, 84 % with 5 and 91 % with 10.
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


def t_interval(values: np.ndarray) -> tuple[float, float]:
    """95 % interval of the mean of a few independent values (S,), by Student's t; infinite for one.

    >>> [round(x, 3) for x in t_interval(np.array([1.0, 2.0, 3.0]))]
    [-0.484, 4.484]
    """
    # mean +- t_{S - 1} s / sqrt(S), s with S - 1 in its denominator
    n = len(values)
    t = T_975[min(n - 2, len(T_975) - 1)] if n > 1 else np.inf
    half = t * np.std(values, ddof=1) / np.sqrt(n) if n > 1 else np.inf
    return float(np.mean(values) - half), float(np.mean(values) + half)


def wilson_interval(successes: float, trials: int, z: float = 1.96) -> tuple[float, float]:
    """Wilson score interval of a success rate; z = 1.96 for 95 %.

    >>> [round(x, 4) for x in wilson_interval(8, 10)]
    [0.4902, 0.9433]
    """
    # (p + z^2/2n +- z sqrt(p(1-p)/n + z^2/4n^2)) / (1 + z^2/n)
    p, n = successes / trials, trials
    centre = p + z**2 / (2 * n)
    half = z * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    low, high = (centre - half) / (1 + z**2 / n), (centre + half) / (1 + z**2 / n)
    return max(float(low), 0.0), min(float(high), 1.0)  # rounding alone would pass either end

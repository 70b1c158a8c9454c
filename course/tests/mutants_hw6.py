"""Wrong answers to assignment 6."""

from mutants import Mutant

FILE = "hw6/claims.py"
MUTANTS = (
    Mutant(
        "whole scores cut off",
        FILE,
        (("    weight = np.maximum(weight, 0.0)\n", "    weight = (i >= n // 4) & (i < n - n // 4)\n"),),
        "test_iqm_weighs_half",
        "count with a fraction",
    ),
    Mutant(
        "median instead of the middle half",
        FILE,
        (("    return float((weight * ordered).sum() / weight.sum())", "    return float(np.median(ordered))"),),
        "test_iqm_by_hand",
        "not 2.5|of 0, 1, 2, 3, 5, 900",
    ),
    Mutant(
        "scores left unsorted",
        FILE,
        (("np.sort(np.ravel(scores))", "np.ravel(scores)"),),
        "test_iqm_weighs_half",
        "sort the scores",
    ),
    Mutant(
        "all scores drawn independently",
        FILE,
        (
            (
                "statistic(scores[np.ix_(rows, columns)])",
                "statistic(rng.choice(scores.ravel(), scores.shape))",
            ),
        ),
        "test_bootstrap_resamples_whole_episodes",
        "whole rows",
    ),
    Mutant(
        "seeds never drawn anew",
        FILE,
        (("columns = rng.integers(0, seeds, seeds)", "columns = np.arange(seeds)"),),
        "test_bootstrap_resamples_whole_seeds",
        "where only seeds differ|whole seeds",
    ),
    Mutant(
        "a tail of 5 % on either side",
        FILE,
        (("tail = 50.0 * (1.0 - level)", "tail = 100.0 * (1.0 - level)"),),
        "test_bootstrap_width",
        "times as wide as 2 x",
    ),
    Mutant(
        "always the mean",
        FILE,
        (("drawn[r] = statistic(", "drawn[r] = np.mean("),),
        "test_bootstrap_uses_the_statistic",
        "statistic that is handed in",
    ),
    Mutant(
        "old minus new",
        FILE,
        (("bootstrap(new - old, np.mean", "bootstrap(old - new, np.mean"),),
        "test_paired_is_new_minus_old",
        "new - old",
    ),
    Mutant(
        "resampled apart",
        FILE,
        (
            (
                "    return bootstrap(new - old, np.mean, rng, resamples)",
                "    a, b = bootstrap(old, np.mean, rng, resamples), bootstrap(new, np.mean, rng, resamples)\n"
                "    return Interval(b.value - a.value, b.low - a.high, b.high - a.low)",
            ),
        ),
        "test_paired_is_new_minus_old",
        "pair before resampling",
    ),
    Mutant(
        "judged by the value alone",
        FILE,
        (("agrees, disagrees = low > 0, high < 0", "agrees, disagrees = difference.value > 0, difference.value < 0"),),
        "test_verdict_table",
        "better with .* open",
    ),
    Mutant(
        "no difference found means alike",
        FILE,
        (("agrees, disagrees = -margin < low and high < margin,", "agrees, disagrees = low <= 0 <= high,"),),
        "test_verdict_at_the_border",
        "on the border",
    ),
    Mutant(
        "agility_ref's own functions",
        FILE,
        (
            ("    ordered = np.sort(np.ravel(scores))\n", "    from agility_ref import stats\n\n    return stats.iqm(scores)\n"),
            ("    episodes, seeds = scores.shape\n", "    from agility_ref import stats\n\n    return stats.bootstrap_interval(scores, statistic, level, resamples, rng)\n"),
        ),
        "test_bootstrap_of_one_score",
        "return Interval",
    ),
)  # fmt: skip

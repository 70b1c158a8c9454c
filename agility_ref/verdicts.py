"""Verdicts: from a paired difference to *reproduced*, *not reproduced* or *undecided*.

One rule for every claim.  A claim is made of comparisons, each put so that the claimed side is
positive:

    reproduced       the 95 % interval of the difference lies entirely above 0
    not reproduced   it lies entirely below 0
    undecided        it covers 0
    not measured     there is nothing to compare

A claim that says "and" is reproduced if all its comparisons are, and not reproduced if one
of them is not; a claim that says "or" the other way round.  Intervals are 95 % each, without
correction for their number.

In:  scores (S, E), one row a training seed.  Out: :class:`Comparison`, :class:`Finding`, and
both as text.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from math import isnan, nan
from statistics import mode

import numpy as np

from agility_ref.stats import paired_difference, t_interval

REPRODUCED, NOT_REPRODUCED = "reproduced", "not reproduced"
UNDECIDED, NOT_MEASURED = "undecided", "not measured"
ONE_SEED = "the intervals cover the episodes alone.  Another training could turn any of them round."
MIN_SEEDS = 3  # an interval over training seeds alone needs this many
MIN_EPISODES = 10  # ... and one over episodes this many


@dataclass(frozen=True)
class Comparison:
    """One difference, positive where the claim holds."""

    text: str
    """What is subtracted from what."""
    difference: float = nan
    low: float = nan
    high: float = nan
    """Ends of the 95 % interval; NaN without one."""
    seeds: int = 0
    """Training seeds behind it."""
    paper: float = nan
    """The same difference of the paper's means; NaN where it prints none."""
    margin: float | None = None
    """The claim is that the difference lies within +- this; None for above 0."""

    @property
    def verdict(self) -> str:
        """Apply the rule."""
        if self.seeds == 0:
            return NOT_MEASURED
        if isnan(self.low):
            return UNDECIDED
        if self.margin is None:
            inside, outside = self.low > 0, self.high < 0
        else:
            inside = -self.margin < self.low and self.high < self.margin
            outside = self.low > self.margin or self.high < -self.margin
        return REPRODUCED if inside else NOT_REPRODUCED if outside else UNDECIDED

    def __str__(self) -> str:
        """Return difference and interval."""
        if self.seeds == 0:
            return "-"
        interval = "" if isnan(self.low) else f" [{self.low:+.2f}, {self.high:+.2f}]"
        return f"{self.difference:+.2f}{interval}"


@dataclass(frozen=True)
class Finding:
    """One claim of the paper and what our figures say about it."""

    claim: str
    section: str
    """Where the paper makes it."""
    measure: str
    """How it is measured here."""
    comparisons: tuple[Comparison, ...] = field(default_factory=tuple)
    any_of: bool = False
    """The claim says "or"."""

    @property
    def verdict(self) -> str:
        """Combine the verdicts of the comparisons."""
        found = [comparison.verdict for comparison in self.comparisons]
        # "or": one that is reproduced suffices; "and": one that is not reproduced is too many.
        suffices, needs_all = (REPRODUCED, NOT_REPRODUCED) if self.any_of else (NOT_REPRODUCED, REPRODUCED)
        if suffices in found:
            return suffices
        if found and all(verdict == needs_all for verdict in found):
            return needs_all
        if all(verdict == NOT_MEASURED for verdict in found):
            return NOT_MEASURED
        return UNDECIDED


def paired(
    text: str, a: np.ndarray | None, b: np.ndarray | float = 0.0, paper: float = nan, margin: float | None = None
) -> Comparison:
    """Compare scores a and b (S, E) that played the same episodes; a is None where there are none."""
    if a is None or b is None:
        return Comparison(text, paper=paper, margin=margin)
    a = np.atleast_2d(a)
    difference, low, high = paired_difference(a, np.broadcast_to(b, a.shape))
    if a.shape[1] < MIN_EPISODES:
        low = high = nan
    return Comparison(text, difference, low, high, len(a), paper, margin)


def over_seeds(text: str, differences: np.ndarray) -> Comparison:
    """Judge one difference a training seed, (S,), or (S, P) of which the mean over P counts.

    The interval is Student's; without MIN_SEEDS seeds there is none.
    """
    differences = np.asarray(differences, float)
    if not differences.size:
        return Comparison(text)
    if len(differences) < MIN_SEEDS:
        few = f"{text}, {len(differences)} of {MIN_SEEDS} seeds"
        return Comparison(few, float(differences.mean()), seeds=len(differences))
    means = differences.reshape(len(differences), -1).mean(axis=1)
    return Comparison(text, float(means.mean()), *t_interval(means), seeds=len(means))


# ---------------------------------------------------------------------------- as text


def text(findings: Iterable[Finding]) -> str:
    """Return the findings for a terminal, each with its comparisons."""
    findings = list(findings)
    width = max((len(c.text) for f in findings for c in f.comparisons), default=0)
    lines = []
    for finding in findings:
        lines += ["", f"{finding.verdict.upper()}: {finding.claim} ({finding.section})"]
        for c in finding.comparisons:
            paper = "" if isnan(c.paper) else f"paper {c.paper:+.2f}"
            lines.append(f"    {c.text:{width}}  {c!s:24} {c.verdict:15} {c.seeds:2} seeds  {paper}".rstrip())
    if usual_seeds(findings) == 1:
        lines += ["", f"One training seed: {ONE_SEED}"]
    return "\n".join(lines[1:])


def usual_seeds(findings: list[Finding]) -> int:
    """Return the number of training seeds behind most comparisons, those not measured apart."""
    return mode([c.seeds for f in findings for c in f.comparisons if c.seeds] or [0])


def markdown(findings: Iterable[Finding], caption: str) -> str:
    """Return the findings as a page: the rule, a list of verdicts, every comparison."""
    findings = list(findings)
    parts = [
        f"# Findings of the paper: {caption}",
        "",
        "A difference is **reproduced** if its 95 % interval lies entirely on the side that the paper claims, **not "
        "reproduced** if it lies entirely on the other, **undecided** if it covers 0.  A claim that says *and* needs all its "
        "comparisons and falls with one; a claim that says *or* needs one and falls with all.  Differences are paired episode "
        "by episode, intervals are bootstrapped over training seeds and episodes (Student's where there is one number a "
        "seed), 95 % each without correction for their number; with fewer than ten seeds the bootstrapped ones are too "
        "short (`agility_ref/stats.py`).  *Seeds* are training seeds; one seed says nothing about another.  *Paper* is the same difference of the means that the paper prints, without an interval.",
        "",
    ]
    if usual_seeds(findings) == 1:
        parts += [f"**One training seed**: {ONE_SEED}", ""]
    parts += ["| verdict | claim | section |", "|---|---|---|"]
    parts += [f"| {f.verdict} | {f.claim} | {f.section} |" for f in findings]
    for f in findings:
        parts += ["", f"## {f.claim}", "", f"{f.section}.  {f.measure}  **{f.verdict.capitalize()}.**", ""]
        parts += ["| comparison | ours | seeds | verdict | paper |", "|---|---|---|---|---|"]
        parts += [
            f"| {c.text} | {c} | {c.seeds} | {c.verdict} | {'-' if isnan(c.paper) else f'{c.paper:+.2f}'} |"
            for c in f.comparisons
        ]
    return "\n".join(parts) + "\n"

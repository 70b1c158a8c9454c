"""Findings: what the paper claims, as one table of comparisons, asked of our figures.

A claim is made of comparisons, each put so that the claimed side is positive.  There is one rule:

    reproduced       the 95 % interval of the difference lies entirely above 0
    not reproduced   it lies entirely below 0
    undecided        it covers 0
    not measured     there is nothing to compare

A claim that says "and" is reproduced if all its comparisons are, and not reproduced if one of
them is not; a claim that says "or" the other way round.  Intervals are 95 % each, without
correction for their number.

In:  the cells of the table, the learning curves behind the weights, a file of ablations.
Out: one :class:`Finding` per row of ``CLAIMS``, and all of them as text.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import resources
from itertools import product
from math import isfinite, isnan, nan
from pathlib import Path
from statistics import mode

from agility_ref.errors import UserError
from agility_ref.files import read_csv, write_text
from agility_ref.results.cells import Cells, seeds_of, stack
from agility_ref.results.table1 import ENVIRONMENT_LABELS, PAPER_LABELS, paper_cells
from agility_ref.stats import paired_difference, t_interval
from agility_ref.training import weights
from agility_ref.training.bank import WeightsConfig, run_folder
from agility_ref.training.policies import ALIASES, ENVIRONMENTS, find_policy
from agility_ref.training.progress import read_progress

import numpy as np

REPRODUCED, NOT_REPRODUCED = "reproduced", "not reproduced"
UNDECIDED, NOT_MEASURED = "undecided", "not measured"
ONE_SEED = "the intervals cover the episodes alone.  Another training could turn any of them round."
MIN_SEEDS = 3  # an interval over training seeds alone needs this many
MIN_EPISODES = 10  # ... and one over episodes this many

FLICKER = 2.0  # a selector flickers if it switches more than this many times as often as the oracle would
COLLAPSE = 0.95  # ... and has collapsed if one skill acts for more than this share of an episode
EARLY = 0.25  # "early" is at this share of the shortest specialist's training after the warm start
ABLATION_COLUMNS = ("ablation", "policy", "seed", "steps", "waypoint_fraction")

# The specialists that a generalist replaces.  Without walk, from which all of these start.
REPLACED = {"gen-3": ("climb", "leap"), "gen-5": ("climb-up", "climb-down", "leap", "beam")}

# ---------------------------------------------------------------------------- the table of comparisons


@dataclass(frozen=True)
class Row:
    """One comparison: the figure of policy ``a`` on terrain ``here`` minus that of ``b`` on ``there``.

    ``metric`` is one of the table's, "flicker", "collapse", "early level", "final level" or "ablation".  With a
    ``margin`` the claim is that the difference lies within +- this, and else that it is above 0.
    """

    a: str
    b: str
    here: str = ""
    there: str = ""
    metric: str = "waypoint_fraction"
    margin: float | None = None


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper, where it stands, how it is measured here, and the comparisons that decide about it."""

    text: str
    section: str
    measure: str
    rows: tuple[Row, ...] = ()
    any_of: bool = False  # The claim says "or".


def _rows(a: list[str], b: list[str] | None = None, on: Sequence[str] = ("",), minus: str = "", **more) -> list[Row]:
    """Write out one row of claims.toml; what its entries mean stands at its top."""
    return [Row(x, y, here, minus or here, **more) for here in on for x in a for y in b or [x]]


def _read_claims() -> dict[str, Claim]:
    entries = tomllib.loads((resources.files("agility_ref.results") / "claims.toml").read_text(encoding="utf-8"))
    for entry in entries.values():
        entry["rows"] = tuple(row for packed in entry["rows"] for row in _rows(**packed))
    return {name: Claim(**entry) for name, entry in entries.items()}


CLAIMS = _read_claims()

# ---------------------------------------------------------------------------- the rule


@dataclass(frozen=True)
class Comparison:
    """One difference, positive where the claim holds."""

    text: str  # What is subtracted from what.
    difference: float = nan
    low: float = nan
    high: float = nan  # Ends of the 95 % interval; NaN without one.
    seeds: int = 0  # Training seeds behind it.
    paper: float = nan  # The same difference of the paper's means; NaN where it prints none.
    margin: float | None = None  # As in :class:`Row`.

    @property
    def verdict(self) -> str:
        """Apply the rule."""
        if self.seeds == 0:
            return NOT_MEASURED
        if self.margin is None:
            inside, outside = self.low > 0, self.high < 0  # both false without an interval
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

    claim: Claim
    comparisons: tuple[Comparison, ...]

    @property
    def verdict(self) -> str:
        """Combine the verdicts of the comparisons."""
        found = [comparison.verdict for comparison in self.comparisons]
        # "or": one that is reproduced suffices; "and": one that is not reproduced is too many.
        suffices, needs_all = (REPRODUCED, NOT_REPRODUCED) if self.claim.any_of else (NOT_REPRODUCED, REPRODUCED)
        if suffices in found:
            return suffices
        if found and all(verdict == needs_all for verdict in found):
            return needs_all
        return NOT_MEASURED if all(verdict == NOT_MEASURED for verdict in found) else UNDECIDED


def paired(text: str, a: np.ndarray, b: np.ndarray | float, paper: float = nan, margin: float | None = None):
    """Compare scores a and b (S, E) that played the same episodes."""
    difference, low, high = paired_difference(a, np.broadcast_to(b, a.shape))
    if a.shape[1] < MIN_EPISODES:
        low = high = nan
    return Comparison(text, difference, low, high, len(a), paper, margin)


def over_seeds(text: str, differences: np.ndarray) -> Comparison:
    """Judge one difference per training seed, (S,), or (S, P) of which the mean over P counts.

    The interval is Student's; without MIN_SEEDS seeds there is none.
    """
    differences = np.asarray(differences, float)
    if not differences.size:
        return Comparison(text)
    means = differences.reshape(len(differences), -1).mean(axis=1)
    if len(means) < MIN_SEEDS:
        return Comparison(f"{text}, {len(means)} of {MIN_SEEDS} seeds", float(means.mean()), seeds=len(means))
    return Comparison(text, float(means.mean()), *t_interval(means), seeds=len(means))


# ---------------------------------------------------------------------------- the evidence


@dataclass(frozen=True)
class Evidence:
    """What the claims are judged by."""

    cells: Cells
    curves: dict[tuple[str, int], dict[str, np.ndarray]]  # (policy, training seed) -> steps and level of its training.
    ablations: list[dict]  # Rows of ABLATION_COLUMNS; empty where none were measured.

    def judge(self, claim: Claim) -> Finding:
        """Measure every row of a claim."""
        return Finding(claim, tuple(found for row in claim.rows for found in self.measure(row)))

    def measure(self, row: Row) -> list[Comparison]:
        """Measure one row of the table."""
        if row.metric == "ablation":
            return [self._ablation(row.a, row.b)]
        if row.metric.endswith("level"):
            sign = 1 if row.metric == "early level" else -1
            return [over_seeds(f"{row.a}: {row.metric}", sign * self._levels(row.a, row.metric == "final level"))]
        if row.metric in ("flicker", "collapse"):
            return [self._choice(row)]
        return [self._scores(row)]

    def _choice(self, row: Row) -> Comparison:
        """How far a selector is from the threshold of flicker or collapse, positive beyond it."""
        seeds = seeds_of(self.cells, row.a, row.here)
        flicker = row.metric == "flicker"
        what = f"switches/s - {FLICKER:g} x wanted" if flicker else f"share of one skill - {COLLAPSE:g} or wanted"
        if not seeds:
            return Comparison(f"{row.a}: {what}")
        figure = "switches_per_second" if flicker else "commonest_share"
        own, wanted = (stack(self.cells, row.a, row.here, name, seeds) for name in (figure, f"wanted_{figure}"))
        return paired(f"{row.a}: {what}", own, FLICKER * wanted if flicker else np.maximum(COLLAPSE, wanted))

    def _scores(self, row: Row) -> Comparison:
        """Compare two policies on a terrain, or one on two, over the training seeds that both have.

        On one terrain the episodes are paired as played; on two, the easiest course of one with the
        easiest of the other, and so on up.
        """
        text = (
            f"{row.a} - {row.b} on {row.here}" if row.here == row.there else f"{row.a} on {row.here} - on {row.there}"
        )
        sides = ((row.a, row.here), (row.b, row.there))
        seeds = sorted(set(seeds_of(self.cells, *sides[0])) & set(seeds_of(self.cells, *sides[1])))
        paper = paper_mean(*sides[0], row.metric) - paper_mean(*sides[1], row.metric)
        if not seeds:
            return Comparison(text, paper=paper, margin=row.margin)
        scores = [stack(self.cells, *side, row.metric, seeds) for side in sides]
        if row.here != row.there:  # all seeds play the same courses
            orders = [np.argsort(stack(self.cells, *side, "difficulty", seeds[:1])[0]) for side in sides]
            scores = [score[:, order] for score, order in zip(scores, orders, strict=True)]
        return paired(text, *scores, paper=paper, margin=row.margin)

    def _levels(self, generalist: str, late: bool) -> np.ndarray:
        """Level of the generalist minus the mean level of the specialists that it replaces, (S,).

        The generalist's is that on the courses of those specialists.  Early: all after the same
        number of steps, warm start included.  Late: each at its end.
        """
        names, found = (generalist, *REPLACED[generalist]), []
        for seed in sorted({seed for _, seed in self.curves}):
            kinds = [f"level_{find_policy(name).courses[0]}" for name in names[1:]]
            if not all((name, seed) in self.curves for name in names):
                continue
            own, *curves = (self.curves[name, seed] for name in names)
            if not all(kind in own for kind in kinds):
                continue
            start, end = max(c["steps"][0] for c in (own, *curves)), min(c["steps"][-1] for c in curves)
            at = start + EARLY * (end - start)
            pairs = [((own["steps"], own[k]), (c["steps"], c["level"])) for k, c in zip(kinds, curves, strict=True)]
            levels = [[level[-1] if late else np.interp(at, steps, level) for steps, level in pair] for pair in pairs]
            found.append(np.mean([ours - theirs for ours, theirs in levels]))
        return np.array(found)

    def _ablation(self, one: str, other: str) -> Comparison:
        """Compare two ablations, per seed and policy, each at the end of its training; the baseline is one of them."""
        last: dict[tuple[str, str, int], tuple[int, float]] = {}
        for row in self.ablations:
            key = (row["ablation"], row["policy"], row["seed"])
            last[key] = max(last.get(key, (-1, nan)), (row["steps"], row["waypoint_fraction"]))
        both = {(p, s) for a, p, s in last if a == other and (one, p, s) in last}
        policies = sorted({p for p, _ in both})
        seeds = sorted(s for s in {s for _, s in both} if all((p, s) in both for p in policies))
        differences = [[last[one, p, s][1] - last[other, p, s][1] for p in policies] for s in seeds]
        return over_seeds(f"{one} - {other}" + (f" ({', '.join(policies)})" if policies else ""), differences)


def paper_mean(policy: str, environment: str, metric: str) -> float:
    """Return the mean that the paper prints, NaN where it prints none."""
    name = next((alias for alias, stands_for in ALIASES.items() if stands_for == policy), policy)
    figures = paper_cells().get((ENVIRONMENT_LABELS[environment], PAPER_LABELS.get(name)))
    return figures[metric][0] if figures else nan


def read_ablations(path: Path) -> list[dict]:
    """Read the file of ablations; an empty list where there is none.

    Rows named ``baseline`` are compared with those named ``no-curriculum`` and ``action-repeat-1``
    of the same policy and seed; of several steps the last count.

    Raises
    ------
    UserError : the file lacks a column, or holds something that is no number
    """
    if not Path(path).is_file():
        return []
    kinds = dict(zip(ABLATION_COLUMNS, (str, str, int, lambda steps: int(float(steps)), float), strict=True))
    try:
        rows = [{name: kind(row[name]) for name, kind in kinds.items()} for row in read_csv(path, ABLATION_COLUMNS)]
        if not all(isfinite(row["waypoint_fraction"]) for row in rows):
            raise ValueError("a waypoint fraction that is not finite")
    except (UserError, ValueError, OverflowError) as error:
        raise UserError(f"{path} does not hold {','.join(ABLATION_COLUMNS)}: {error}") from None
    return rows


def training_curve(policy: str, training: WeightsConfig) -> dict[str, np.ndarray] | None:
    """Return the learning curve behind the weights in use: of an own run, else of those shipped."""
    own = run_folder(training.root, policy, training.seed)
    if (own / "DONE").exists():
        path = own / "progress.csv"
        curve = read_progress(path) if path.is_file() else {}
    else:
        curve = weights.shipped_curve(weights.FOLDER / weights.file_name(training.preset, policy, training.seed))
    return curve if len(curve.get("level", ())) else None


def gather(cells: Cells, training: WeightsConfig, ablations: Path) -> Evidence:
    """Collect the evidence: complete episodes, learning curves of the same seeds, and ablations.

    Parameters
    ----------
    cells : of :func:`agility_ref.results.table1.compute`, protocol complete
    training : where the weights are; its seed is not used
    ablations : file of ablations; need not exist
    """
    names = {name for generalist, replaced in REPLACED.items() for name in (generalist, *replaced)}
    wanted = product(sorted(names), sorted({seed for _, _, seed in cells}))
    curves = {(policy, seed): training_curve(policy, replace(training, seed=seed)) for policy, seed in wanted}
    return Evidence(cells, {key: curve for key, curve in curves.items() if curve}, read_ablations(ablations))


def check(cells: Cells, training: WeightsConfig, ablations: Path) -> list[Finding]:
    """Judge every claim; parameters as :func:`gather`."""
    evidence = gather(cells, training, ablations)
    return [evidence.judge(claim) for claim in CLAIMS.values()]


def compare(cells: Cells, policies: tuple[str, ...]) -> list[Comparison]:
    """Compare the first policy's waypoint fraction with that of each other one, terrain by terrain."""
    rows = [Row(policies[0], other, t, t) for other in policies[1:] for t in ENVIRONMENTS]
    return [found for row in rows for found in Evidence(cells, {}, []).measure(row)]


# ---------------------------------------------------------------------------- as text


def text(findings: list[Finding]) -> str:
    """Return the findings for a terminal, each with its comparisons."""
    width = max((len(c.text) for f in findings for c in f.comparisons), default=0)
    lines = []
    for f in findings:
        lines += ["", f"{f.verdict.upper()}: {f.claim.text} ({f.claim.section})"]
        for c in f.comparisons:
            paper = "" if isnan(c.paper) else f"paper {c.paper:+.2f}"
            lines.append(f"    {c.text:{width}}  {c!s:24} {c.verdict:15} seeds: {c.seeds}  {paper}".rstrip())
    if usual_seeds(findings) == 1:
        lines += ["", f"One training seed: {ONE_SEED}"]
    return "\n".join(lines[1:])


def usual_seeds(findings: list[Finding]) -> int:
    """Return the number of training seeds behind most comparisons, those not measured apart."""
    return mode([c.seeds for f in findings for c in f.comparisons if c.seeds] or [0])


def markdown(findings: list[Finding], caption: str) -> str:
    """Return the findings as a page: the rule, a list of verdicts, every comparison."""
    parts = [
        f"# Findings of the paper: {caption}",
        "",
        "A difference is **reproduced** if its 95 % interval lies entirely on the side that the paper claims, **not "
        "reproduced** if it lies entirely on the other, **undecided** if it covers 0.  A claim that says *and* needs all its "
        "comparisons and falls with one; a claim that says *or* needs one and falls with all.  Differences are paired episode "
        "by episode, intervals are bootstrapped over training seeds and episodes (Student's where there is one number per "
        "seed), 95 % each without correction for their number; with fewer than ten seeds the bootstrapped ones are too "
        "short (`agility_ref/stats.py`).  *Seeds* are training seeds; one seed says nothing about another.  *Paper* is the same difference of the means that the paper prints, without an interval.",
        "",
    ]
    if usual_seeds(findings) == 1:
        parts += [f"**One training seed**: {ONE_SEED}", ""]
    parts += ["| verdict | claim | section |", "|---|---|---|"]
    parts += [f"| {f.verdict} | {f.claim.text} | {f.claim.section} |" for f in findings]
    for f in findings:
        parts += ["", f"## {f.claim.text}", ""]
        parts += [f"{f.claim.section}.  {f.claim.measure}  **{f.verdict.capitalize()}.**", ""]
        parts += ["| comparison | ours | seeds | verdict | paper |", "|---|---|---|---|---|"]
        parts += [
            f"| {c.text} | {c} | {c.seeds} | {c.verdict} | {'-' if isnan(c.paper) else f'{c.paper:+.2f}'} |"
            for c in f.comparisons
        ]
    return "\n".join(parts) + "\n"


def write(findings: list[Finding], folder: Path, caption: str) -> Path:
    """Write findings.md; return its path."""
    path = Path(folder) / "findings.md"
    write_text(path, markdown(findings, caption))
    return path

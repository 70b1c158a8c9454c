"""Findings: what the paper's abstract, its sections 4.2 and 4.3 and its Table 1 say, asked of our cells.

One function per claim.  Unless the claim names another quantity, the measure is the waypoint
fraction: rewards depend on weights that differ from the paper's, and a long episode is
neither good nor bad in itself.  There is one rule for every claim.  A claim is made of
comparisons, each put so that the claimed side is positive:

    reproduced       the 95 % interval of the difference lies entirely above 0
    not reproduced   it lies entirely below 0
    undecided        it covers 0
    not measured     there is nothing to compare

A claim that says "and" is reproduced if all its comparisons are, and not reproduced if one
of them is not; a claim that says "or" the other way round.  Intervals are 95 % each, without
correction for their number.

In:  the cells of the table, the learning curves behind the weights, a file of ablations.
Out: :class:`Comparison` and :class:`Finding`, and both as text.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
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


ABLATION_COLUMNS = ("ablation", "policy", "seed", "steps", "waypoint_fraction")


@dataclass(frozen=True)
class Evidence:
    """What the claims are judged by."""

    cells: Cells
    curves: dict[tuple[str, int], dict[str, np.ndarray]]
    """(policy, training seed) -> steps and level of its training."""
    ablations: list[dict]
    """Rows of ABLATION_COLUMNS; empty where none were measured."""

    def scores(self, policy: str, environment: str, metric: str, seeds: list[int]) -> np.ndarray | None:
        """(S, E) of one policy on one terrain; None without seeds."""
        return stack(self.cells, policy, environment, metric, seeds) if seeds else None

    def compare(
        self,
        a: tuple[str, str],
        b: tuple[str, str],
        metric: str = "waypoint_fraction",
        margin: float | None = None,
    ) -> Comparison:
        """Compare two (policy, environment), a - b, over the training seeds that both have.

        On one terrain the episodes are paired as played; on two, the easiest course of one with the
        easiest of the other, and so on up.
        """
        same_place = a[1] == b[1]
        text = f"{a[0]} - {b[0]} on {a[1]}" if same_place else f"{a[0]} on {a[1]} - on {b[1]}"
        seeds = sorted(set(seeds_of(self.cells, *a)) & set(seeds_of(self.cells, *b)))
        scores = [self.scores(*side, metric, seeds) for side in (a, b)]
        if seeds and not same_place:
            for k, side in enumerate((a, b)):
                order = np.argsort(self.scores(*side, "difficulty", seeds[:1])[0])  # all seeds play the same courses
                scores[k] = scores[k][:, order]
        paper = paper_mean(*a, metric) - paper_mean(*b, metric)
        return paired(text, *scores, paper=paper, margin=margin)


def paper_mean(policy: str, environment: str, metric: str) -> float:
    """Return the mean that the paper prints, NaN where it prints none."""
    name = next((alias for alias, stands_for in ALIASES.items() if stands_for == policy), policy)
    figures = paper_cells().get((ENVIRONMENT_LABELS[environment], PAPER_LABELS.get(name)))
    return figures[metric][0] if figures else nan


def read_ablations(path: Path) -> list[dict]:
    """Read the file of ablations; an empty list where there is none.

    Rows named ``baseline`` are compared with those named ``no-curriculum`` and
    ``action-repeat-<k>`` of the same policy and seed; of several steps the last count.

    Raises
    ------
    UserError : the file lacks a column, or holds something that is no number
    """
    if not Path(path).is_file():
        return []
    try:
        rows = [
            {
                "ablation": row["ablation"], "policy": row["policy"], "seed": int(row["seed"]),
                "steps": int(float(row["steps"])), "waypoint_fraction": float(row["waypoint_fraction"]),
            }
            for row in read_csv(path, ABLATION_COLUMNS)
        ]  # fmt: skip
        if not all(isfinite(row["waypoint_fraction"]) for row in rows):
            raise ValueError("a waypoint fraction that is not finite")
    except (ValueError, OverflowError) as error:
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


def gather(cells: Cells, training: WeightsConfig, ablations: Path, policies: Iterable[str]) -> Evidence:
    """Collect the evidence.

    Parameters
    ----------
    cells : of :func:`agility_ref.results.table1.compute`, protocol complete
    training : where the weights are; its seed is not used
    ablations : file of ablations; need not exist
    policies : whose learning curves are wanted
    """
    curves = {}
    for policy, seed in product(policies, {seed for _, _, seed in cells}):
        curve = training_curve(policy, replace(training, seed=seed))
        if curve is not None:
            curves[policy, seed] = curve
    return Evidence(cells, curves, read_ablations(ablations))


SELECTORS, GENERALISTS = ("oracle", "ps-sl-5"), ("gen-3", "gen-5")
FLICKER = 2.0  # a selector flickers if it switches more than this many times as often as the oracle would
COLLAPSE = 0.95  # ... and has collapsed if one skill acts for more than this share of an episode
EQUAL = 0.1  # terrains are equally hard if the waypoint fraction differs by less than this
EARLY = 0.25  # "early" is at this share of the shortest specialist's training after the warm start

# The specialists that a generalist replaces.  Without walk, from which all of these start.
REPLACED = {"gen-3": ("climb", "leap"), "gen-5": ("climb-up", "climb-down", "leap", "beam")}
# The specialist of each terrain, and the oracle's other skills.
OWN = {"gap": "leap", "beam": "beam", "climb": "climb"}
FOREIGN = {
    "gap": ("climb-up", "climb-down", "beam", "walk"),
    "beam": ("climb-up", "climb-down", "leap", "walk"),
    "climb": ("climb-up", "climb-down", "leap", "beam", "walk"),
}
BASELINE, NO_CURRICULUM, ACTION_STACKING = "baseline", "no-curriculum", "action-repeat"
SEEN = "The learned selectors have trained on Climb+Gap courses, their skills and the generalists on climbing and leaping apart."


# ---------------------------------------------------------------------------- section 4.3, selectors and generalists


def selectors_win_where_one_skill_is_asked_for(e: Evidence) -> Finding:
    """Judge "outperform the generalists in skill-specific environments (Gap, Beam, Climb)"."""
    return Finding(
        "Oracle and PS-SL-5 outperform the generalists on Gap, Beam and Climb.", "section 4.3",
        "Waypoint fraction of each selector minus that of each generalist.",
        tuple(e.compare((s, t), (g, t)) for t, s, g in product(("gap", "beam", "climb"), SELECTORS, GENERALISTS)),
    )  # fmt: skip


def generalists_win_on_climb_gap(e: Evidence) -> Finding:
    """Judge "the generalist outperforms in more difficult and dynamic terrains (Climb+Gap)"."""
    return Finding(
        "The generalists outperform Oracle and PS-SL-5 on Climb+Gap.", "section 4.3",
        f"Waypoint fraction of each generalist minus that of each selector.  {SEEN}",
        tuple(e.compare((g, "climb-gap"), (s, "climb-gap")) for g, s in product(GENERALISTS, SELECTORS)),
    )  # fmt: skip


def generalists_win_reward_on_climb_gap(e: Evidence) -> Finding:
    """The same in reward, the column of Table 1 that bears the paper's sentence out."""
    return Finding(
        "The generalists earn more reward than Oracle and PS-SL-5 on Climb+Gap.", "section 4.3 and Table 1",
        "Reward of an episode; the weights of its terms are not the paper's.",
        tuple(e.compare((g, "climb-gap"), (s, "climb-gap"), "reward") for g, s in product(GENERALISTS, SELECTORS)),
    )  # fmt: skip


def rl_selector_wins_waypoints_on_climb_gap(e: Evidence) -> Finding:
    """Judge "the RL+PPO-based Selector outperforms the generalist in reaching waypoints in the hardest terrain"."""
    return Finding(
        "PS-RL-3 reaches more waypoints than PS-SL-5 and the generalists on Climb+Gap.", "section 4.3 and Table 1",
        f"Waypoint fraction of PS-RL-3 minus that of each of the others.  {SEEN}",
        tuple(e.compare(("ps-rl-3", "climb-gap"), (p, "climb-gap")) for p in ("ps-sl-5", *GENERALISTS)),
    )  # fmt: skip


def _flickers_or_collapses(e: Evidence, policy: str, reward: str) -> Finding:
    seeds = seeds_of(e.cells, policy, "climb-gap")
    names = ("switches_per_second", "wanted_switches_per_second", "commonest_share", "wanted_commonest_share")
    switches, wanted, share, wanted_share = (e.scores(policy, "climb-gap", name, seeds) for name in names)
    return Finding(
        f"PS-RL-3 trained on {reward} keeps switching, or collapses to one skill.", "sections 4.2 and 4.3",
        f"On Climb+Gap, against what the oracle asks for along the same path.  It flickers if it switches more than "
        f"{FLICKER:g} times as often; it has collapsed if its commonest skill acts for more than {COLLAPSE:.0%} of the "
        "episode, and for more than the oracle's would.",
        (
            paired(f"{policy}: switches/s - {FLICKER:g} x wanted", switches, FLICKER * wanted if seeds else None),
            paired(
                f"{policy}: share of one skill - {COLLAPSE:g} or wanted",
                share, np.maximum(COLLAPSE, wanted_share) if seeds else None,
            ),
        ),
        any_of=True,
    )  # fmt: skip


def rl_selector_on_reward_is_unsteady(e: Evidence) -> Finding:
    """Judge "keeps switching its predicted policy" and "mode collapse", for the original reward."""
    return _flickers_or_collapses(e, "ps-rl-3-env", "the environment's reward")


def rl_selector_on_oracle_reward_is_unsteady(e: Evidence) -> Finding:
    """Judge the same for the oracle's reward."""
    return _flickers_or_collapses(e, "ps-rl-3-oracle", "the oracle's reward")


# ---------------------------------------------------------------------------- section 4.3 and Table 1, terrains


def specialists_fail_elsewhere(e: Evidence) -> Finding:
    """Judge what Table 1 shows: on each terrain the specialists of other terrains fall behind its own."""
    return Finding(
        "Specialists fail off their own course.", "Table 1",
        "Waypoint fraction of the terrain's own specialist minus that of each other of the oracle's five skills there.",
        tuple(e.compare((OWN[t], t), (other, t)) for t in OWN for other in FOREIGN[t]),
    )  # fmt: skip


def climb_gap_is_the_hardest(e: Evidence) -> Finding:
    """Judge "climb = leap = plank < climb and leap", its second half."""
    easier = [("ps-sl-5", t) for t in ("climb", "gap", "beam")] + [("ps-rl-3", t) for t in ("climb", "gap")]
    return Finding(
        "Climb+Gap is harder for the learned selectors than Climb, Gap and Beam.", "section 4.3",
        "Waypoint fraction of one selector on two terrains; PS-RL-3 has no skill for beams.  How hard a terrain is "
        "depends on its dimensions, and those of Beam and Climb+Gap are ours.",
        tuple(e.compare(side, (side[0], "climb-gap")) for side in easier),
    )  # fmt: skip


def other_terrains_are_equally_hard(e: Evidence) -> Finding:
    """Judge "climb = leap = plank", the first half: equality needs a margin."""
    pairs = (("climb", "gap"), ("gap", "beam"), ("climb", "beam"))
    return Finding(
        "Climb, Gap and Beam are equally hard for PS-SL-5.", "section 4.3",
        f"Waypoint fraction on two terrains; equal if the interval lies within +-{EQUAL}, unequal if it lies outside.",
        tuple(e.compare(("ps-sl-5", a), ("ps-sl-5", b), margin=EQUAL) for a, b in pairs),
    )  # fmt: skip


# ---------------------------------------------------------------------------- abstract, learning curves


def _level_differences(e: Evidence, generalist: str, late: bool) -> np.ndarray:
    """Level of the generalist minus the mean level of the specialists that it replaces, (S,).

    The generalist's is that on the courses of those specialists.  Early: all after the same
    number of steps, warm start included.  Late: each at its end.
    """
    names, found = (generalist, *REPLACED[generalist]), []
    for seed in sorted({seed for _, seed in e.curves}):
        if not all((name, seed) in e.curves for name in names):
            continue
        own, *curves = (e.curves[name, seed] for name in names)
        kinds = [f"level_{find_policy(name).courses[0]}" for name in names[1:]]
        if not all(kind in own for kind in kinds):
            continue
        start, end = max(c["steps"][0] for c in (own, *curves)), min(c["steps"][-1] for c in curves)
        at = start + EARLY * (end - start)
        pairs = [((own["steps"], own[kind]), (c["steps"], c["level"])) for kind, c in zip(kinds, curves, strict=True)]
        levels = [[level[-1] if late else np.interp(at, steps, level) for steps, level in pair] for pair in pairs]
        found.append(np.mean([generalist_level - level for generalist_level, level in levels]))
    return np.array(found)


def generalists_learn_faster_early(e: Evidence) -> Finding:
    """Judge "a generalist exhibits accelerated early-stage learning"."""
    return Finding(
        "Generalists learn faster early.", "abstract",
        f"Level of the curriculum after {EARLY:.0%} of the shortest specialist's training, all after the same number of "
        "steps: the generalist's on their courses minus the mean of the specialists that it replaces.",
        tuple(over_seeds(f"{g}: early level", _level_differences(e, g, late=False)) for g in REPLACED),
    )  # fmt: skip


def generalists_plateau_below(e: Evidence) -> Finding:
    """Judge "its performance tends to plateau at a suboptimal level"."""
    return Finding(
        "Generalists plateau below the specialists.", "abstract",
        "Level of the curriculum at the end of training: the mean of the specialists minus the generalist's on their "
        "courses; Table 1 prints the steps of each.",
        tuple(over_seeds(f"{g}: final level", -_level_differences(e, g, late=True)) for g in REPLACED),
    )  # fmt: skip


# ---------------------------------------------------------------------------- section 4.2, ablations


def _ablation(e: Evidence, name: str) -> Comparison:
    """Compare the baseline with one ablation, per seed and policy, each at the end of its training."""
    last: dict[tuple[str, str, int], tuple[int, float]] = {}
    for row in e.ablations:
        key = (row["ablation"], row["policy"], row["seed"])
        last[key] = max(last.get(key, (-1, nan)), (row["steps"], row["waypoint_fraction"]))
    both = {(p, s) for a, p, s in last if a == name and (BASELINE, p, s) in last}
    policies = sorted({p for p, _ in both})
    seeds = sorted(s for s in {s for _, s in both} if all((p, s) in both for p in policies))
    differences = [[last[BASELINE, p, s][1] - last[name, p, s][1] for p in policies] for s in seeds]
    return over_seeds(f"{BASELINE} - {name}" + (f" ({', '.join(policies)})" if policies else ""), np.array(differences))


def curriculum_is_crucial(e: Evidence) -> Finding:
    """Judge "Curriculum is crucial for the robot to learn anything"."""
    return Finding(
        "Curriculum is crucial.", "section 4.2",
        "Waypoint fraction of policies trained with the curriculum minus that of the same trained without.",
        (_ablation(e, NO_CURRICULUM),),
    )  # fmt: skip


def action_stacking_hurts(e: Evidence) -> Finding:
    """Judge "Action stacking (repeating the same action for multiple timesteps) worsened the performance"."""
    names = sorted({row["ablation"] for row in e.ablations if row["ablation"].startswith(ACTION_STACKING)})
    return Finding(
        "Action stacking hurts.", "section 4.2",
        "Waypoint fraction of policies that choose every action minus that of policies that hold each for some steps.",
        tuple(_ablation(e, name) for name in names or [ACTION_STACKING]),
    )  # fmt: skip


CLAIMS: tuple[Callable[[Evidence], Finding], ...] = (
    selectors_win_where_one_skill_is_asked_for,
    generalists_win_on_climb_gap,
    generalists_win_reward_on_climb_gap,
    rl_selector_wins_waypoints_on_climb_gap,
    rl_selector_on_reward_is_unsteady,
    rl_selector_on_oracle_reward_is_unsteady,
    specialists_fail_elsewhere,
    climb_gap_is_the_hardest,
    other_terrains_are_equally_hard,
    generalists_learn_faster_early,
    generalists_plateau_below,
    curriculum_is_crucial,
    action_stacking_hurts,
)


# ---------------------------------------------------------------------------- all of them


def check(cells: Cells, training: WeightsConfig, ablations: Path) -> list[Finding]:
    """Judge every claim by the cells of a table; see :func:`agility_ref.results.findings.gather`."""
    policies = {name for generalist, replaced in REPLACED.items() for name in (generalist, *replaced)}
    evidence = gather(cells, training, ablations, policies)
    return [claim(evidence) for claim in CLAIMS]


def compare(cells: Cells, policies: tuple[str, ...]) -> list[Comparison]:
    """Compare the first policy's waypoint fraction with that of each other one, terrain by terrain."""
    evidence = Evidence(cells, {}, [])
    return [evidence.compare((policies[0], t), (other, t)) for other in policies[1:] for t in ENVIRONMENTS]


def write(findings: list[Finding], folder: Path, caption: str) -> Path:
    """Write findings.md; return its path."""
    path = Path(folder) / "findings.md"
    write_text(path, markdown(findings, caption))
    return path

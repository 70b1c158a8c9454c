"""Table 1: every policy on every terrain, beside the paper's figures.

Paper Table 1: 11 policies x 4 environments, 43 cells (Climb on Beam is missing there).
PS-RL-3 stands there for one of two selectors that section 3.2.2 trains; both have rows of
their own here, and the one that PS-RL-3 names is played once for both.
The paper's own numbers are package data, ``table1_paper.csv``, transcribed from it; a dash
there (edge violation of hierarchies, one reward) stays empty.

In:  an evaluation config, training seeds, weights.
Out: cells, rows that summarise them, and the table as text, CSV, Markdown, LaTeX and a picture: mean and standard
deviation, ours beside the paper's, as the paper prints them; and what may be said of ours: interquartile mean,
success rate, steps spent.
"""

import csv
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

from agility_ref.errors import UserError
from agility_ref.evaluate import METRICS, EvaluationConfig, evaluation_world
from agility_ref.files import write_csv, write_text
from agility_ref.results.cells import Cell, Cells, acting_policies, enter, find_cell, seeds_of
from agility_ref.results.published import mean_std
from agility_ref.stats import bootstrap_interval, iqm, wilson_interval
from agility_ref.training import weights
from agility_ref.training.bank import WeightsConfig, run_folder
from agility_ref.training.policies import ENVIRONMENTS, POLICIES, TABLE_ROWS, find_policy
from agility_ref.training.progress import attempt

import numpy as np

# Beyond the paper: the two rewards of section 3.2.2, and the future work of section 5.
EXTRA_ROWS = ("ps-rl-3-env", "ps-rl-3-oracle", "distilled", "post-gen")
ENVIRONMENT_LABELS = {"climb-gap": "Climb+Gap", "gap": "Gap", "beam": "Beam", "climb": "Climb"}
PAPER_LABELS = {"ps-rl-3": "PS-RL-3"} | {name: POLICIES[name].label for name in TABLE_ROWS if name in POLICIES}

MeanStd = dict[str, tuple[float, float]]
"""metric -> mean and standard deviation over episodes, as the paper prints them."""
Interval = tuple[float, float, float]
"""Estimate, and the lower and upper end of its 95 % interval."""


@dataclass(frozen=True)
class Summary:
    """What the table says of one policy on one terrain, from the cells of all its seeds."""

    mean_std: MeanStd  # Over the episodes of all seeds together; NaN where there is nothing to divide by.
    iqm: dict[str, Interval]  # metric -> interquartile mean with its bootstrap interval; empty as published.
    success: Interval | None
    """Share of episodes that reach all 8 waypoints, with :func:`success_interval`; None as published."""
    steps: int  # Environment steps spent on the policy, the mean over seeds.
    seeds: tuple[int, ...]  # Training seeds.


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    environment: str  # As the paper labels it.
    policy: str  # Likewise.
    paper: MeanStd | None  # The paper's figures, NaN for a dash; None for a line that the paper does not have.
    ours: Summary | None  # None where weights are missing.


def paper_cells() -> dict[tuple[str, str], MeanStd]:
    """Read the paper's 43 cells: (environment, policy) as labelled there -> its figures."""
    text = (resources.files("agility_ref.results") / "table1_paper.csv").read_text(encoding="utf-8")
    return {
        (row["environment"], row["policy"]): {
            m: tuple(float(row[f"{m}_{k}"] or "nan") for k in ("mean", "std")) for m in METRICS
        }
        for row in csv.DictReader(text.splitlines())
    }


def table_lines() -> list[tuple[str, str]]:
    """Return (environment, policy) of every line, by their command-line names: 43 of the paper, 16 beyond."""
    paper = paper_cells()
    return [
        (environment, name)
        for environment in ENVIRONMENTS
        for name in (*TABLE_ROWS, *EXTRA_ROWS)
        if name in EXTRA_ROWS or (ENVIRONMENT_LABELS[environment], PAPER_LABELS[name]) in paper
    ]


# ---------------------------------------------------------------------------- seeds


def parse_seeds(words: Iterable[str]) -> tuple[int, ...] | None:
    """Read training seeds: ``0``, ``0 1 2``, ``0,1,2``; None for ``all``.

    >>> parse_seeds(["2,0", "1"])
    (0, 1, 2)

    Raises
    ------
    UserError : neither whole numbers from 0 on nor the word all
    """
    words = [part for word in words for part in word.replace(",", " ").split()]
    if words == ["all"]:
        return None
    if not words or not all(word.isdecimal() for word in words):
        raise UserError(f"seeds are numbers such as 0 1 2, or all; not {' '.join(words)!r}")
    return tuple(sorted({int(word) for word in words}))


def seeds_with_weights(policy: str, training: WeightsConfig) -> tuple[int, ...]:
    """Return the seeds for which this policy and all its skills are trained; (0,) if there are none."""
    found = []
    for name in acting_policies(policy):
        own = {path.parent.name for path in (training.root / name).glob("seed*/DONE")}
        own = {int(seed) for folder in own if (seed := folder.removeprefix("seed")).isdecimal()}
        found.append(own.union(weights.shipped_seeds(training.preset, name)))
    return tuple(sorted(set.intersection(*found))) or (0,)


# ---------------------------------------------------------------------------- computing


def train_all(config: WeightsConfig, quiet: bool = False) -> None:
    """Train every policy of the table that has no finished run yet."""
    from agility_ref.pictures.plots import learning_curve
    from agility_ref.training.runs import TrainConfig, train_policy  # here, so that only training waits for torch

    config = TrainConfig(**vars(config))
    for name in ("walk", *TABLE_ROWS, *EXTRA_ROWS):
        spec = find_policy(name)
        folder = run_folder(config.root, name, config.seed)
        if spec.method != "oracle" and not (folder / "DONE").exists():
            train_policy(name, config, quiet, learning_curve)


def compute(
    config: EvaluationConfig, training: WeightsConfig, folder: Path, seeds: tuple[int, ...] | None = (0,)
) -> tuple[Cells, list[str]]:
    """Find or play every cell whose weights exist; return the cells and what is missing.

    Parameters
    ----------
    config : what is played
    training : where the weights are; its seed is not used
    folder : where cells are stored, and found by an interrupted table
    seeds : training seeds; None for all that have weights, policy by policy
    """
    from tqdm import tqdm

    evaluation_world(ENVIRONMENTS[0], config)  # a bad config is an error even where all weights are missing
    lines = dict.fromkeys((environment, find_policy(name).name) for environment, name in table_lines())
    entrants, missing = [], []
    for policy in dict.fromkeys(policy for _, policy in lines):
        for seed in seeds if seeds is not None else seeds_with_weights(policy, training):
            try:
                entrants.append(enter(policy, replace(training, seed=seed)))
            except UserError as error:
                missing.append(str(error))
    # Terrain outermost: all play on the courses of one, then of the next.
    asked = [(entrant, t) for t in ENVIRONMENTS for entrant in entrants if (t, entrant.policy) in lines]
    cells = {}
    with tqdm(asked, unit="cell", leave=False, disable=None) as bar:  # on a terminal only
        for entrant, environment in bar:
            bar.set_description(f"{entrant.policy} on {environment}, seed {entrant.seed}")
            cells[entrant.policy, environment, entrant.seed] = find_cell(entrant, environment, config, folder)
    return cells, list(dict.fromkeys(missing))


def table_rows(cells: Cells) -> list[Row]:
    """Summarise the cells, in the order of the paper."""
    paper, rows = paper_cells(), []
    for environment, name in table_lines():
        extra = name in EXTRA_ROWS
        label, policy = (POLICIES[name].label if extra else PAPER_LABELS[name]), find_policy(name).name
        seeds = seeds_of(cells, policy, environment)
        figures = None if extra else paper[ENVIRONMENT_LABELS[environment], label]
        ours = summarise([cells[policy, environment, seed] for seed in seeds]) if seeds else None
        rows.append(Row(ENVIRONMENT_LABELS[environment], label, figures, ours))
    return rows


def summarise(cells: list[Cell]) -> Summary:
    """Summarise one policy on one terrain over its training seeds."""
    protocol = cells[0].protocol
    scores = {m: [cell.arrays[m] for cell in cells] for m in METRICS}
    pooled = {m: mean_std(np.concatenate(values), m, protocol) for m, values in scores.items()}
    intervals, success = {}, None
    if protocol == "complete":  # as published, seeds differ in their number of episodes
        intervals = {m: (iqm(np.stack(v)), *bootstrap_interval(np.stack(v))) for m, v in scores.items()}
        reached = np.stack(scores["waypoint_fraction"]) == 1.0
        success = (float(reached.mean()), *success_interval(reached))
    steps = round(float(np.mean([cell.steps for cell in cells])))
    return Summary(pooled, intervals, success, steps, tuple(cell.seed for cell in cells))


def success_interval(reached: np.ndarray) -> tuple[float, float]:
    """95 % interval of a success rate; reached (S, E) bool, one row per training seed.

    Wilson's, with the episodes of one seed as trials: several seeds play the same courses.  The
    difficulties are spread evenly, which makes it rather too wide.  It knows nothing of the spread
    between seeds, so with several the bootstrap over them may widen it.
    """
    low, high = wilson_interval(float(reached.mean()) * reached.shape[1], reached.shape[1])
    if len(reached) > 1:
        ends = bootstrap_interval(reached, np.mean)
        low, high = min(low, ends[0]), max(high, ends[1])
    return low, high


# ---------------------------------------------------------------------------- as text

HEADINGS = {
    "reward": "Reward",
    "episode_length": "Ep. length",
    "waypoint_fraction": "% WP",
    "edge_violation": "Violation",
}
DIGITS = {"reward": 2, "episode_length": 0, "waypoint_fraction": 2, "edge_violation": 2}
NOTES = (
    "Mean ± standard deviation over episodes, as the paper prints it: the spread between episodes, not the uncertainty "
    "of the mean.  Rewards cannot be compared with the paper's: the weights of the terms differ.  Episode length is in "
    "control steps of 20 ms, as in the paper; an action lasts two.",
    "Interquartile mean over the episodes of all training seeds, with its 95 % interval, bootstrapped over seeds and "
    "episodes; success is the share of episodes that reach all 8 waypoints, with Wilson's 95 % interval for the episodes of "
    "one seed, widened by the bootstrap where there are several.  With one training seed the intervals cover the episodes alone and say nothing of how another training would have turned out.  Steps are "
    "environment steps in millions: those of a selector include its bank of skills, their common warm start once.",
)
EXTRA_HEADINGS = ("Success", "Steps", "Seeds")


def title(config: EvaluationConfig, rows: list[Row]) -> str:
    """Say in one line what the table shows."""
    seeds = sorted({seed for row in rows if row.ours for seed in row.ours.seeds})
    parts = [f"Table 1, preset {config.preset}", f"{config.episodes} episodes per cell"]
    if config.protocol != "complete":
        parts[1:] = [f"{config.episodes} robots per cell", f"counted {config.protocol}"]
    if config.difficulty is not None:
        parts.append(f"difficulty {config.difficulty:g}")
    if config.clean:
        parts.append("without noise and pushes")
    if seeds:
        parts.append(f"training seed{'s' * (len(seeds) > 1)} {', '.join(map(str, seeds))}")
    return ", ".join(parts)


def format_value(value: tuple[float, float] | None, metric: str) -> str:
    """Return "mean ± std" with the metric's digits, or a dash."""
    if value is None or math.isnan(value[0]):
        return "-"
    return f"{value[0]:.{DIGITS[metric]}f} ± {value[1]:.{DIGITS[metric]}f}"


def format_interval(interval: Interval | None, digits: int = 2) -> str:
    """Return "estimate [low, high]", or a dash.

    >>> format_interval((0.5, 0.25, 0.75))
    '0.50 [0.25, 0.75]'
    """
    if interval is None:
        return "-"
    estimate, low, high = (f"{x:.{digits}f}" for x in interval)
    return f"{estimate} [{low}, {high}]"


def compared(row: Row) -> list[str]:
    """Return the cells of the first table: ours and the paper's of each metric."""
    ours = row.ours.mean_std if row.ours else None
    return [format_value(who and who[m], m) for m in METRICS for who in (ours, row.paper)]


def surely(row: Row) -> list[str]:
    """Return the cells of the second table: four intervals, success rate, steps, seeds."""
    ours = row.ours
    if ours is None:
        return ["-"] * (len(METRICS) + len(EXTRA_HEADINGS))
    intervals = [format_interval(ours.iqm.get(m), DIGITS[m]) for m in METRICS]
    seeds = ", ".join(map(str, ours.seeds))
    return [*intervals, format_interval(ours.success), f"{ours.steps / 1e6:.1f} M", seeds]


def printed(rows: list[Row]) -> list[tuple[list[str], list[list[str]]]]:
    """Return headings and lines of each table; the second where it says anything that the first does not."""
    tables = [([f"{HEADINGS[m]} {who}" for m in METRICS for who in ("ours", "paper")], [*map(compared, rows)])]
    if any(row.ours and row.ours.iqm for row in rows):
        tables.append(([*HEADINGS.values(), *EXTRA_HEADINGS], [*map(surely, rows)]))
    return tables


def text(rows: list[Row]) -> str:
    """Return both tables for a terminal."""
    parts = []
    for heads, lines in printed(rows):
        table = [[head.removesuffix(" ours") for head in heads], *lines]
        widths = [max(map(len, column)) + 2 for column in zip(*table, strict=True)]
        names, previous = [f"{'':27}"], ""
        for row in rows:
            names.append(f"{row.environment if row.environment != previous else '':10} {row.policy:16}")
            previous = row.environment
        parts.append("\n".join(
            name + "".join(f"{value:>{width}}" for value, width in zip(line, widths, strict=True))
            for name, line in zip(names, table, strict=True)
        ))  # fmt: skip
    sure = "\n\ninterquartile mean and success rate with 95 % intervals, environment steps, training seeds\n"
    return sure.join(parts)


def markdown(rows: list[Row]) -> str:
    """Return both tables in Markdown, each with a note on how to read it."""
    parts = []
    for (heads, lines), note in zip(printed(rows), NOTES, strict=False):
        parts += ["## How sure\n"] if parts else []
        parts += ["| Environment | Policy | " + " | ".join(heads) + " |", "|---" * (len(heads) + 2) + "|"]
        parts += [f"| {r.environment} | {r.policy} | {' | '.join(line)} |" for r, line in zip(rows, lines, strict=True)]
        parts += ["", note, ""]
    return "\n".join(parts)


def csv_line(row: Row) -> dict[str, str]:
    """Return column -> value of one row; empty where there is none."""
    ours, numbers = row.ours, {}
    for who, figures in (("ours", ours and ours.mean_std), ("paper", row.paper)):
        for m in METRICS:
            numbers |= _named(f"{m}_", ("mean", "std"), figures and figures[m], f"_{who}")
    for m in METRICS:
        numbers |= _named(f"{m}_", ("iqm", "low", "high"), ours and ours.iqm.get(m))
    numbers |= _named("success_", ("rate", "low", "high"), ours and ours.success)
    last = {"steps": ours.steps, "seeds": " ".join(map(str, ours.seeds))} if ours else {"steps": "", "seeds": ""}
    return {"environment": row.environment, "policy": row.policy, **numbers, **last}


def _named(prefix: str, names: tuple[str, ...], values: tuple[float, ...] | None, suffix: str = "") -> dict[str, str]:
    values = values or (math.nan,) * len(names)
    return {f"{prefix}{n}{suffix}": "" if math.isnan(v) else f"{v:.4f}" for n, v in zip(names, values, strict=True)}


def latex(rows: list[Row], caption: str) -> str:
    r"""Return both tables as LaTeX ``table*`` environments; needs ``\usepackage{booktabs}`` and nothing else."""
    labels, parts = ("tab:agility-ref-table1", "tab:agility-ref-intervals"), ["% Needs \\usepackage{booktabs}."]
    for k, (heads, lines) in enumerate(printed(rows)):
        top = [" & ".join(map(_escape, ["Environment", "Policy", *heads])) + r" \\"]
        if k == 0:  # ours and the paper's under one heading per metric
            groups = "".join(rf" & \multicolumn{{2}}{{c}}{{{_escape(HEADINGS[m])}}}" for m in METRICS)
            rules = "".join(rf"\cmidrule(lr){{{3 + 2 * j}-{4 + 2 * j}}}" for j in range(len(METRICS)))
            top = [rf" & {groups} \\", rules, " & ".join(["Environment & Policy", *("ours", "paper") * 4]) + r" \\"]
        body, previous = [], rows[0].environment
        for row, line in zip(rows, lines, strict=True):
            body += [r"\midrule"] if row.environment != previous else []
            previous = row.environment
            body.append(" & ".join([row.environment, row.policy, *map(_math, line)]) + r" \\")
        parts += [
            r"\begin{table*}", r"\centering", rf"\caption{{{_escape(f'{caption}. {NOTES[k]}')}}}", rf"\label{{{labels[k]}}}",
            r"\scriptsize", r"\setlength{\tabcolsep}{3pt}", rf"\begin{{tabular}}{{ll{'r' * len(heads)}}}",
            r"\toprule", *top, r"\midrule", *body, r"\bottomrule", r"\end{tabular}", r"\end{table*}", "",
        ]  # fmt: skip
    return "\n".join(parts)


def _escape(words: str) -> str:
    for character in "&%$#_{}":
        words = words.replace(character, f"\\{character}")
    return words.replace("±", r"$\pm$")


def _math(value: str) -> str:
    """Set the figures of a value in mathematics, so that a minus is one; a dash stands for nothing."""
    if value == "-":
        return "--"
    figures = value.removesuffix(" M")
    return f"${figures}$".replace("±", r"\pm") + value[len(figures) :]


def write_all(rows: list[Row], folder: Path, caption: str) -> list[Path]:
    """Write table1.csv, table1.md and table1.tex, and draw table1.png if that can be done; return their paths."""
    from agility_ref.pictures.plots import table_figure

    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"table1.{suffix}" for suffix in ("csv", "md", "tex", "png")]
    write_csv(paths[0], [csv_line(row) for row in rows])
    write_text(paths[1], f"# {caption}\n\n{markdown(rows)}")
    write_text(paths[2], latex(rows, caption))
    return paths if attempt(table_figure, rows, paths[3], caption) else paths[:3]

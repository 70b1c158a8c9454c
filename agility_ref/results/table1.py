"""Table 1: every policy on every terrain, beside the paper's figures.

Paper Table 1: 11 policies x 4 environments, 43 cells (Climb on Beam is missing there).
PS-RL-3 stands there for one of two selectors that section 3.2.2 trains; both have rows of
their own here, and the one that PS-RL-3 names is played once for both.
The paper's own numbers are package data, ``table1_paper.csv``, transcribed from it; a dash
there (edge violation of hierarchies, one reward) stays empty.

In:  an evaluation config, training seeds, weights.  Out: cells, and rows that summarise them.
"""

import csv
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

from agility_ref.errors import UserError
from agility_ref.evaluate import METRICS, EvaluationConfig, evaluation_world, mean_std
from agility_ref.results.cells import Cell, Cells, acting_policies, enter, find_cell, seeds_of
from agility_ref.stats import bootstrap_interval, iqm, wilson_interval
from agility_ref.training import weights
from agility_ref.training.bank import WeightsConfig, run_folder
from agility_ref.training.policies import ENVIRONMENTS, POLICIES, TABLE_ROWS, find_policy

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

    mean_std: MeanStd
    """Over the episodes of all seeds together; NaN where there is nothing to divide by."""
    iqm: dict[str, Interval]
    """metric -> interquartile mean with its bootstrap interval; empty as published."""
    success: Interval | None
    """Share of episodes that reach all 8 waypoints, with :func:`success_interval`; None as published."""
    steps: int
    """Environment steps spent on the policy, the mean over seeds."""
    seeds: tuple[int, ...]
    """Training seeds."""


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    environment: str
    """As the paper labels it."""
    policy: str
    """Likewise."""
    paper: MeanStd | None
    """The paper's figures, NaN for a dash; None for a line that the paper does not have."""
    ours: Summary | None
    """None where weights are missing."""


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
    config: EvaluationConfig,
    training: WeightsConfig,
    folder: Path,
    seeds: tuple[int, ...] | None = (0,),
    on_play: Callable[[str, str, int], None] = lambda policy, environment, seed: None,
) -> tuple[Cells, list[str]]:
    """Find or play every cell whose weights exist; return the cells and what is missing.

    Parameters
    ----------
    config : what is played
    training : where the weights are; its seed is not used
    folder : where cells are stored, and found by an interrupted table
    seeds : training seeds; None for all that have weights, policy by policy
    on_play : called with policy, environment and seed before a cell is played
    """
    evaluation_world(ENVIRONMENTS[0], config)  # a bad config is an error even where all weights are missing
    lines = dict.fromkeys((environment, find_policy(name).name) for environment, name in table_lines())
    entrants, missing = [], []
    for policy in dict.fromkeys(policy for _, policy in lines):
        for seed in seeds if seeds is not None else seeds_with_weights(policy, training):
            try:
                entrants.append(enter(policy, replace(training, seed=seed)))
            except UserError as error:
                missing.append(str(error))
    cells = {
        (entrant.policy, environment, entrant.seed): find_cell(entrant, environment, config, folder, on_play)
        for environment in ENVIRONMENTS  # the outer loop: all play on the courses of one terrain, then of the next
        for entrant in entrants
        if (environment, entrant.policy) in lines
    }
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
    """95 % interval of a success rate; reached (S, E) bool, one row a training seed.

    Wilson's, with the episodes of one seed as trials: several seeds play the same courses.  The
    difficulties are spread evenly, which makes it rather too wide.  It knows nothing of the spread
    between seeds, so with several the bootstrap over them may widen it.
    """
    low, high = wilson_interval(float(reached.mean()) * reached.shape[1], reached.shape[1])
    if len(reached) > 1:
        ends = bootstrap_interval(reached, np.mean)
        low, high = min(low, ends[0]), max(high, ends[1])
    return low, high

"""Evidence: everything that the findings are judged by, in one place.

In:  the cells of the table, the learning curves behind the weights, a file of ablations.
Out: :class:`Evidence`, which compares two policies episode by episode.
"""

import csv
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product
from math import nan
from pathlib import Path

import numpy as np

from agility_ref import weights
from agility_ref.bank import TrainConfig, run_folder
from agility_ref.cells import Cells, seeds_of, stack
from agility_ref.errors import UserError
from agility_ref.policies import ALIASES
from agility_ref.progress import read_progress
from agility_ref.table1 import ENVIRONMENT_LABELS, PAPER_LABELS, paper_cells
from agility_ref.verdicts import Comparison, paired

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
        with open(path, newline="") as file:
            rows = list(csv.DictReader(file))
        return [
            {
                "ablation": row["ablation"], "policy": row["policy"], "seed": int(row["seed"]),
                "steps": int(float(row["steps"])), "waypoint_fraction": float(row["waypoint_fraction"]),
            }
            for row in rows
        ]  # fmt: skip
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path} does not hold {','.join(ABLATION_COLUMNS)}: {error!r}") from None


def training_curve(policy: str, training: TrainConfig) -> dict[str, np.ndarray] | None:
    """Return the learning curve behind the weights in use: of an own run, else of those shipped."""
    own = run_folder(training.root, policy, training.seed)
    if (own / "DONE").exists():
        path = own / "progress.csv"
        curve = read_progress(path) if path.is_file() else {}
    else:
        curve = weights.shipped_curve(weights.FOLDER / weights.file_name(training.preset, policy, training.seed))
    return curve if len(curve.get("level", ())) else None


def gather(cells: Cells, training: TrainConfig, ablations: Path, policies: Iterable[str]) -> Evidence:
    """Collect the evidence.

    Parameters
    ----------
    cells : of :func:`agility_ref.table1.compute`, protocol complete
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

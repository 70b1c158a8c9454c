"""Table 1: every policy on every terrain, beside the paper's figures.

Paper Table 1: 11 policies x 4 environments, 43 cells (Climb on Beam is missing there).
The paper's own numbers are package data, ``table1_paper.csv``, transcribed from it; a dash
there (edge violation of hierarchies, one reward) stays empty.

In:  a preset, a seed, weights.  Out: cells, and the table as text, CSV, Markdown and PNG.
"""

import csv
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np

from agility_ref.errors import UserError
from agility_ref.evaluate import METRICS, Evaluation, EvaluationConfig, evaluate, evaluation_world
from agility_ref.policies import ENVIRONMENTS, POLICIES, TABLE_ROWS, find_policy
from agility_ref.runs import TrainConfig, load_policy, train_policy

ENVIRONMENT_LABELS = {"climb-gap": "Climb+Gap", "gap": "Gap", "beam": "Beam", "climb": "Climb"}
PAPER_LABELS = {"ps-rl-3": "PS-RL-3"} | {name: POLICIES[name].label for name in TABLE_ROWS if name in POLICIES}

Cells = dict[tuple[str, str], dict]
"""(environment, policy) as the paper labels them -> {"paper": ..., "ours": ... or None}."""


def paper_cells() -> Cells:
    """Read the paper's 43 cells: metric -> (mean, std), NaN where the paper has a dash."""
    text = (resources.files("agility_ref") / "table1_paper.csv").read_text()
    cells = {}
    for row in csv.DictReader(text.splitlines()):
        values = {m: tuple(float(row[f"{m}_{k}"] or "nan") for k in ("mean", "std")) for m in METRICS}
        cells[row["environment"], row["policy"]] = {"paper": values, "ours": None}
    return cells


def summarise(evaluations: list[Evaluation]) -> dict[str, tuple[float, float]]:
    """Mean and standard deviation of each metric over the episodes of all seeds."""
    pooled = {m: np.concatenate([getattr(e, m) for e in evaluations]) for m in METRICS}
    return {m: (float(v.mean()), float(v.std())) for m, v in pooled.items()}


def train_all(config: TrainConfig, quiet: bool = False) -> None:
    """Train every policy of the table that has no finished run yet."""
    for name in ("walk", *TABLE_ROWS, *(n for n in POLICIES if n.startswith("ps-rl-3"))):
        spec = find_policy(name)
        folder = config.root / spec.name / f"seed{config.seed}"
        if spec.method != "oracle" and not (folder / "DONE").exists():
            train_policy(name, config, quiet)


def compute(
    config: EvaluationConfig,
    training: TrainConfig,
    on_cell: Callable[[str, str], None] = lambda environment, policy: None,
) -> tuple[Cells, list[str]]:
    """Evaluate every cell whose weights exist; return the cells and what is missing."""
    evaluation_world(ENVIRONMENTS[0], config)  # a bad config is an error even where all weights are missing
    cells, missing = paper_cells(), []
    for environment in ENVIRONMENTS:
        for name in TABLE_ROWS:
            key = (ENVIRONMENT_LABELS[environment], PAPER_LABELS[name])
            if key not in cells:
                continue
            try:
                policy = load_policy(name, training)
            except UserError as error:
                missing.append(str(error))
                continue
            on_cell(environment, name)
            cells[key]["ours"] = summarise([evaluate(policy, environment, config)])
    return cells, list(dict.fromkeys(missing))


# ---------------------------------------------------------------------------- output

HEADINGS = {
    "reward": "Reward",
    "episode_length": "Ep. length",
    "waypoint_fraction": "% WP",
    "edge_violation": "Violation",
}
DIGITS = {"reward": 2, "episode_length": 0, "waypoint_fraction": 2, "edge_violation": 2}


def format_value(value: tuple[float, float] | None, metric: str) -> str:
    """Return "mean ± std" with the metric's digits, or a dash."""
    if value is None or np.isnan(value[0]):
        return "-"
    return f"{value[0]:.{DIGITS[metric]}f} ± {value[1]:.{DIGITS[metric]}f}"


def markdown(cells: Cells) -> str:
    """Return the table in Markdown, ours and the paper's side by side."""
    columns = [f"{HEADINGS[m]} {who}" for m in METRICS for who in ("ours", "paper")]
    lines = ["| Environment | Policy | " + " | ".join(columns) + " |", "|---" * (len(columns) + 2) + "|"]
    for (environment, label), cell in cells.items():
        values = [format_value(cell[who] and cell[who][m], m) for m in METRICS for who in ("ours", "paper")]
        lines.append(f"| {environment} | {label} | " + " | ".join(values) + " |")
    return "\n".join(lines) + "\n"


def text(cells: Cells) -> str:
    """Return the table for a terminal."""
    lines = [f"{'':11}{'':9}" + "".join(f"{HEADINGS[m]:>17}{'paper':>17}" for m in METRICS)]
    previous = ""
    for (environment, label), cell in cells.items():
        values = "".join(
            f"{format_value(cell[who] and cell[who][m], m):>17}" for m in METRICS for who in ("ours", "paper")
        )
        lines.append(f"{environment if environment != previous else '':11}{label:9}{values}")
        previous = environment
    return "\n".join(lines)


def write_csv(cells: Cells, path: Path) -> None:
    """Write one row a cell: ours, then the paper's, mean and standard deviation."""
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        heads = [f"{m}_{k}_{who}" for who in ("ours", "paper") for m in METRICS for k in ("mean", "std")]
        writer.writerow(["environment", "policy", *heads])
        for (environment, label), cell in cells.items():
            numbers = [
                v for who in ("ours", "paper") for m in METRICS for v in (cell[who][m] if cell[who] else ("", ""))
            ]
            writer.writerow([environment, label, *("" if v == "" or np.isnan(v) else f"{v:.4f}" for v in numbers)])


def write_all(cells: Cells, folder: Path, title: str) -> list[Path]:
    """Write table1.csv, table1.md and table1.png; return their paths."""
    from agility_ref.plots import table_figure

    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"table1.{suffix}" for suffix in ("csv", "md", "png")]
    write_csv(cells, paths[0])
    paths[1].write_text(f"# {title}\n\n{markdown(cells)}")
    table_figure(cells, paths[2], title)
    return paths

"""Figures: learning curves and Table 1 as a picture.

In:  ``progress.csv`` files and the cells of the table.  Out: PNG files.
matplotlib is imported when a figure is drawn, never at import.
"""

import csv
from pathlib import Path

import numpy as np

BLUE, ORANGE, GREEN, RED, PURPLE = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7"  # Okabe and Ito
SKILL_COLOURS = {"walk": "#999999", "climb-up": BLUE, "climb-down": "#56B4E9", "leap": RED, "beam": GREEN}


def new_figure(rows: int = 1, columns: int = 1, size: tuple[float, float] = (7.0, 4.0)):
    """Return (figure, axes) without touching any display."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False)


def read_progress(path: Path) -> dict[str, np.ndarray]:
    """Read a progress.csv into one array a column."""
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    return {key: np.array([float(row[key]) for row in rows]) for key in rows[0]} if rows else {}


def learning_curve(progress: Path, out: Path, title: str) -> None:
    """Draw return, waypoint fraction and level against environment steps."""
    curve = read_progress(progress)
    if not curve:
        return
    figure, axes = new_figure(1, 2, (9.0, 3.4))
    steps = curve["steps"] / 1e6
    left, right = axes[0]
    left.plot(steps, curve["reward"], color=BLUE)
    left.set(xlabel="environment steps [million]", ylabel="return per episode", title=title)
    right.plot(steps, curve["waypoint_fraction"], color=BLUE, label="waypoint fraction (with exploration noise)")
    right.plot(steps, curve["level"], color=ORANGE, label="level, as a fraction of the top")
    right.set(xlabel="environment steps [million]", ylim=(0, 1.02))
    right.set_title(f"{curve['wall_seconds'][-1] / 60:.0f} min, {np.median(curve['steps_per_second']):.0f} steps/s")
    right.legend(loc="upper left", fontsize=8)
    for axis in axes[0]:
        axis.grid(alpha=0.3)
    figure.savefig(out, dpi=110)


def table_figure(cells: dict[tuple[str, str], dict], out: Path, title: str) -> None:
    """Draw waypoint fraction and edge violation of every cell, ours beside the paper's."""
    environments = list(dict.fromkeys(environment for environment, _ in cells))
    figure, axes = new_figure(2, len(environments), (3.6 * len(environments), 7.0))
    for column, environment in enumerate(environments):
        rows = [(label, cell) for (e, label), cell in cells.items() if e == environment]
        y = np.arange(len(rows))[::-1]
        for row, metric in enumerate(("waypoint_fraction", "edge_violation")):
            axis = axes[row, column]
            ours = np.array([cell["ours"][metric][0] if cell["ours"] else np.nan for _, cell in rows])
            paper = np.array([cell["paper"][metric][0] for _, cell in rows])
            axis.barh(y + 0.2, ours, 0.38, color=BLUE, label="ours")
            axis.barh(y - 0.2, paper, 0.38, color=ORANGE, label="paper")
            axis.set_yticks(y, [label for label, _ in rows])
            axis.set(title=environment if row == 0 else "", xlabel=metric.replace("_", " "))
            axis.grid(axis="x", alpha=0.3)
    axes[0, 0].legend(fontsize=8)
    figure.suptitle(title)
    figure.savefig(out, dpi=110)

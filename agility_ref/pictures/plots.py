"""Figures of numbers: learning curves and Table 1 as a picture; the style of every figure.

In:  ``progress.csv`` files and the cells of the table.  Out: PNG and SVG files that carry
the command and the versions that made them.
matplotlib is imported when a figure is drawn, never at import.
"""

import os
import sys
import warnings
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

from agility_ref.files import replacing
from agility_ref.stats import bootstrap_interval, iqm
from agility_ref.training.progress import read_progress

import numpy as np

# Okabe and Ito, for whatever is neither a leg nor a skill.
BLUE, ORANGE, GREEN, RED, PURPLE = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7"
SKY, GREY = "#56B4E9", "#8A8A8A"
CYCLE = (BLUE, ORANGE, GREEN, PURPLE, SKY, RED, "#000000")
# Right legs are warm, left legs cool; the front pair is the darker one.
LEG_COLOURS = {"FR": ORANGE, "FL": BLUE, "RR": "#F0E442", "RL": SKY}
SKILL_COLOURS = {  # Tol's "muted" scheme, so that no skill looks like a leg or a violation
    "walk": "#BDBDBD", "climb-up": "#44AA99", "climb-down": "#882255",
    "leap": "#DDCC77", "beam": "#117733", "climb": "#332288",
}  # fmt: skip

STYLE = {  # matplotlib rc settings: readable when a page shows the figure at half its size
    "font.size": 12.0,
    "font.family": "DejaVu Sans",
    "axes.titlesize": 13.0,
    "axes.labelsize": 12.0,
    "xtick.labelsize": 11.0,
    "ytick.labelsize": 11.0,
    "legend.fontsize": 11.0,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.alpha": 0.3,
    "lines.linewidth": 1.8,
    "figure.dpi": 130.0,
    "savefig.dpi": 130.0,
    "svg.hashsalt": "agility_ref",  # the same figure twice is the same file
    "svg.fonttype": "none",
}


def skill_colour(name: str) -> str:
    """Colour of a skill; grey for a name that is none."""
    return SKILL_COLOURS.get(name, GREY)


def import_matplotlib():
    """Return matplotlib, also where MPLBACKEND names a backend that is not installed, as a notebook's is here."""
    if "matplotlib" in sys.modules or "MPLBACKEND" not in os.environ:
        import matplotlib

        return matplotlib
    wanted = os.environ.pop("MPLBACKEND")
    try:
        import matplotlib
    finally:
        os.environ["MPLBACKEND"] = wanted
    with suppress(ValueError):  # our figures use Agg; the caller's own keep the backend that was asked for
        matplotlib.rcParams["backend"] = wanted
    return matplotlib


def style():
    """Return a context in which matplotlib follows its defaults and STYLE, whatever a user's matplotlibrc asks for."""
    matplotlib = import_matplotlib()
    defaults = {key: value for key, value in matplotlib.rcParamsDefault.items() if not key.startswith("backend")}
    with warnings.catch_warnings():  # a default may be of a setting that is going away
        warnings.simplefilter("ignore")
        return matplotlib.rc_context(defaults | STYLE)


def empty_figure(size: tuple[float, float]):
    """Return a figure of this size [inch] without axes and without touching any display."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size)
    FigureCanvasAgg(figure)
    return figure


def new_figure(rows: int = 1, columns: int = 1, size: tuple[float, float] = (7.0, 4.0)):
    """Return (figure, axes), laid out so that labels do not overlap."""
    figure = empty_figure(size)
    figure.set_layout_engine("constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def skill_legend(figure, names) -> None:
    """Add a legend of skills below a figure."""
    from matplotlib.patches import Patch

    items = [Patch(color=skill_colour(name), label=name) for name in names]
    figure.legend(handles=items, loc="outside lower center", ncols=6)


def save_figure(figure, out: Path, command: str) -> list[Path]:
    """Write ``out`` as PNG and as SVG, with the command and the versions in the metadata."""
    import_matplotlib()
    command = command.encode(errors="replace").decode()  # a folder's name need not be text
    made, out = made_with(), Path(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    paths = [out.with_suffix(".png"), out.with_suffix(".svg")]
    tags = [{"Software": made, "Description": command}, {"Creator": made, "Description": command, "Date": None}]
    with style():
        for path, metadata in zip(paths, tags, strict=True):
            with replacing(path) as file:
                figure.savefig(file, format=path.suffix[1:], metadata=metadata)
            figure.set_layout_engine("none")  # the PNG's layout is the SVG's
    return paths


def made_with() -> str:
    """Return the versions that a figure records."""
    from agility_ref import __version__

    others = ", ".join(f"{name} {version(name)}" for name in ("mujoco", "numpy", "matplotlib"))
    return f"agility_ref {__version__}, {others}"


# ---------------------------------------------------------------------------- learning curves


LABELS = {
    "reward": "return per episode",
    "waypoint_fraction": "waypoint fraction, exploring",
    "level": "level / top level",
}


def smooth(steps: np.ndarray, values: np.ndarray, grid: np.ndarray, window: float) -> np.ndarray:
    """Mean of ``values`` over a window [steps] centred on every grid point, NaN where there is none."""
    inside = np.abs(grid[:, None] - steps) <= window / 2
    counts = inside.sum(axis=1)
    return np.where(counts > 0, (inside * values).sum(axis=1) / np.maximum(counts, 1), np.nan)


def band(curves: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """IQM over seeds and its 95 % bootstrap band at every grid point.

    Parameters
    ----------
    curves : (S, G) one row per seed

    Returns
    -------
    middle, low, high : (G,) each; NaN where a seed has no value.  With one seed the band
        is the curve itself: there is no spread to show.
    """
    middle, low, high = (np.full(curves.shape[1], np.nan) for _ in range(3))
    known = np.flatnonzero(~np.isnan(curves).any(axis=0))
    for g in known:
        middle[g] = iqm(curves[:, g])
    if not len(known):
        return middle, low, high
    sampled = known[:: max(len(known) // 30, 1)]  # the band is smooth: 30 points and lines between
    ends = np.array([bootstrap_interval(curves[:, g : g + 1], resamples=200) for g in sampled]).T
    low[known], high[known] = (np.interp(known, sampled, end) for end in ends)
    return middle, low, high


def _wall_axis(axis, curve: dict[str, np.ndarray], label: str = "") -> None:
    """Add wall time [min] above the axis; a warm start's own time lies left of zero."""
    from matplotlib.ticker import MaxNLocator

    steps, minutes = curve["steps"] / 1e6, curve["wall_seconds"] / 60
    if len(steps) < 2 or minutes[-1] <= minutes[0]:
        return
    pace = (minutes[-1] - minutes[0]) / (steps[-1] - steps[0])  # [min / million steps]
    far = np.array([-1e3, 1e3])  # both go on beyond the run
    at = np.array([far[0], *steps, steps[-1] + far[1]])
    time = np.array([minutes[0] + (far[0] - steps[0]) * pace, *minutes, minutes[-1] + far[1] * pace])
    twin = axis.secondary_xaxis("top", functions=(lambda x: np.interp(x, at, time), lambda t: np.interp(t, time, at)))
    share = (steps[-1] - steps[0]) / max(axis.get_xlim()[1], steps[-1])  # of the axis: room for labels
    ticks = MaxNLocator(max(round(5 * share), 1)).tick_values(0, minutes[-1])
    twin.set_xticks(ticks[(ticks >= 0) & (ticks <= minutes[-1])])
    twin.set_xlabel(label)


def learning_curves(
    runs: dict[str, list[dict[str, np.ndarray]]],
    evaluations: dict[str, list[dict[str, float]]] | None = None,
    metrics: tuple[str, ...] = ("waypoint_fraction", "level", "reward"),
):
    """Compare policies: one thin line per seed, a bold IQM, a 95 % band; return the figure.

    Parameters
    ----------
    runs : policy -> the progress of each of its seeds, one array per column
    evaluations : policy -> evaluations of its runs, each with ``steps`` and the metrics;
        drawn as diamonds, for they are played without exploration and on other courses
    metrics : columns of progress.csv, one panel each; read the waypoint fraction beside the
        level, for a curriculum keeps it between its two thresholds until the top is reached
    """
    with style():
        figure, axes = new_figure(1, len(metrics), (4.8 * len(metrics), 4.9))
        curves = {policy: [c for c in seeds if c] for policy, seeds in runs.items() if any(seeds)}
        others = [policy for policy in curves if policy not in SKILL_COLOURS]
        colours = SKILL_COLOURS | {policy: CYCLE[k % len(CYCLE)] for k, policy in enumerate(others)}
        for axis, metric in zip(axes[0], metrics, strict=True):
            for policy, seeds in curves.items():
                points = (evaluations or {}).get(policy, [])
                _draw_policy(axis, policy, seeds, points, metric, colours[policy])
            axis.set(xlabel="environment steps [million]", ylabel=LABELS.get(metric, metric.replace("_", " ")))
            axis.set_xlim(left=0)
        for axis in axes[0] if curves else ():
            first = next(iter(curves))
            _wall_axis(axis, curves[first][0], f"wall time of {first} [min]" if axis is axes[0, 0] else "")
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
        return figure


def _draw_policy(axis, policy: str, seeds: list[dict], points: list[dict], metric: str, colour: str) -> None:
    start, end = max(c["steps"][0] for c in seeds), min(c["steps"][-1] for c in seeds)
    grid = np.linspace(start, end, 120)
    smoothed = np.stack([smooth(c["steps"], c[metric], grid, (end - start) / 30) for c in seeds])
    for row in smoothed:
        axis.plot(grid / 1e6, row, color=colour, linewidth=0.8, alpha=0.6)
    middle, low, high = band(smoothed)
    axis.fill_between(grid / 1e6, low, high, color=colour, alpha=0.2, linewidth=0)
    label = f"{policy}, {len(seeds)} seed{'s' * (len(seeds) > 1)}"
    axis.plot(grid / 1e6, middle, color=colour, linewidth=2.6, label=label)
    for point in points if metric != "level" else []:
        axis.plot(point["steps"] / 1e6, point[metric], "D", color=colour, markeredgecolor="black", markersize=8)


def learning_curve(progress: Path, out: Path, title: str) -> bool:
    """Draw return, waypoint fraction and level of one run; say whether there was anything to draw."""
    curve = read_progress(progress)
    if "reward" not in curve:
        return False
    with style():
        figure, axes = new_figure(1, 2, (10.0, 4.2))
        steps = curve["steps"] / 1e6
        left, right = axes[0]
        left.plot(steps, curve["reward"], color=BLUE)
        left.set(xlabel="environment steps [million]", ylabel=LABELS["reward"], title=title)
        right.plot(steps, curve["waypoint_fraction"], color=BLUE, label=LABELS["waypoint_fraction"])
        right.plot(steps, curve["level"], color=ORANGE, label=LABELS["level"])
        right.set(xlabel="environment steps [million]", ylim=(0, 1.02))
        _wall_axis(left, curve, "wall time [min]")
        _wall_axis(right, curve)
        speed = f"{curve['wall_seconds'][-1] / 60:.0f} min, {np.median(curve['steps_per_second']):.0f} steps/s"
        right.legend(loc="best", title=speed)
    save_figure(figure, out, f"agility-ref plot {Path(progress).parent}")
    return True


# ---------------------------------------------------------------------------- Table 1


def table_figure(rows: list, out: Path, title: str) -> None:
    """Draw waypoint fraction and edge violation of every line of the table, ours beside the paper's.

    Parameters
    ----------
    rows : of :func:`agility_ref.results.table1.table_rows`; one mark per estimate: the means of both, and the
        interquartile mean of ours with its 95 % interval
    out, title : of the figure
    """
    environments = list(dict.fromkeys(row.environment for row in rows))
    with style():
        figure, axes = new_figure(2, len(environments), (3.6 * len(environments), 9.0))
        for column, environment in enumerate(environments):
            here = [row for row in rows if row.environment == environment]
            y = np.arange(len(here))[::-1]
            for line, metric in enumerate(("waypoint_fraction", "edge_violation")):
                axis = axes[line, column]
                ours = np.array([row.ours.mean_std[metric][0] if row.ours else np.nan for row in here])
                paper = np.array([row.paper[metric][0] if row.paper else np.nan for row in here])
                nothing = (np.nan,) * 3
                sure = np.array([row.ours.iqm.get(metric, nothing) if row.ours else nothing for row in here])
                axis.hlines(y, sure[:, 1], sure[:, 2], color="black", linewidth=1.2)
                axis.plot(sure[:, 0], y, "|", color="black", markersize=9, label="ours: IQM, 95 % interval")
                axis.plot(ours, y, "o", color=BLUE, markersize=6, alpha=0.9, label="ours: mean")
                axis.plot(paper, y, "D", color="none", markeredgecolor=ORANGE, markeredgewidth=1.8, label="paper: mean")
                axis.set_yticks(y, [row.policy for row in here])
                axis.set(title=environment if line == 0 else "", xlabel=metric.replace("_", " "), xlim=(0, None))
                axis.margins(y=0.03)
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
        figure.suptitle(title, x=0.01, ha="left")
    save_figure(figure, out, f"agility-ref table1 ({title})")


def show(figure, name: str) -> None:
    """Show a figure of a tutorial: below the cell in a notebook, else as the file ``figures/<name>.png``."""
    if "ipykernel" in sys.modules:
        from io import BytesIO

        from IPython.display import Image, display

        png = BytesIO()
        figure.savefig(png, format="png", dpi=110)
        display(Image(data=png.getvalue()))
        return
    path = Path("figures", f"{name}.png").resolve()
    path.parent.mkdir(exist_ok=True)
    figure.savefig(path, dpi=110)
    print("figure:", path)

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

BLUE, ORANGE, GREEN, RED, PURPLE = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7"  # Okabe and Ito
SKY, GREY = "#56B4E9", "#8A8A8A"
CYCLE = (BLUE, ORANGE, GREEN, PURPLE, SKY, RED, "#000000")
SKILL_COLOURS = {  # Tol's "muted" scheme, so that no skill looks like a leg or a violation
    "walk": "#BDBDBD", "climb-up": "#44AA99", "climb-down": "#882255",
    "leap": "#DDCC77", "beam": "#117733", "climb": "#AA4499",
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
    import_matplotlib()
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


def save_figure(figure, out: Path, command: str) -> list[Path]:
    """Write ``out`` as PNG and as SVG, with the command and the versions in the metadata."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from PIL import PngImagePlugin

    command = command.encode(errors="replace").decode()  # a folder's name need not be text
    made = {"Software": made_with(), "Description": command}
    out = Path(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    paths = [out.with_suffix(".png"), out.with_suffix(".svg")]
    with style(), replacing(paths[0]) as png, replacing(paths[1]) as svg:
        figure.set_dpi(STYLE["savefig.dpi"])  # each canvas draws once, where Figure.savefig would draw twice
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        pixels = np.asarray(canvas.buffer_rgba())[:, :, :3].copy()
        figure.set_layout_engine("none")  # the PNG's layout is the SVG's
        tags = {"Creator": made["Software"], "Description": command, "Date": None}
        FigureCanvasSVG(figure).print_svg(svg, metadata=tags)
        info = PngImagePlugin.PngInfo()
        for key, text in made.items():
            info.add_itxt(key, text)
        paletted(pixels).save(png, format="PNG", pnginfo=info, optimize=True)
    return paths


def paletted(pixels: np.ndarray):
    """Return an image of 256 colours, which are enough for a diagram and take a third of the space.

    The commonest 128 stay exact.  The others are spread over all that are left, each counted
    once, so that a single red mark is not given the colour of a large area near it.

    Parameters
    ----------
    pixels : (height, width, 3) uint8
    """
    from PIL import Image

    packed = pixels.astype(np.uint32)
    packed = packed[:, :, 0] << 16 | packed[:, :, 1] << 8 | packed[:, :, 2]
    colours, counts = np.unique(packed, return_counts=True)
    colours = colours[np.argsort(-counts.astype(int), kind="stable")]
    rgb = np.stack([colours >> 16, colours >> 8 & 255, colours & 255], axis=1).astype(np.uint8)
    palette = rgb
    if len(rgb) > 256:
        rest = Image.fromarray(rgb[None, 128:]).quantize(128, Image.Quantize.MAXCOVERAGE)
        palette = np.concatenate([rgb[:128], np.array(rest.getpalette(), np.uint8).reshape(-1, 3)])[:256]
    # |a - b|^2 = |a|^2 - 2 a.b + |b|^2, of which the first is the same for every entry b
    a, b = rgb.astype(np.float32), palette.astype(np.float32)
    index = np.zeros(1 << 24, np.uint8)  # of every 24-bit colour in the palette
    index[colours] = ((b**2).sum(axis=1) - 2 * a @ b.T).argmin(axis=1)
    image = Image.fromarray(index[packed])
    image.putpalette(palette.tobytes())
    return image


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


def _wall_axis(axis, curve: dict[str, np.ndarray], whose: str = "") -> None:
    """Add wall time [min] above the axis; a warm start's own time lies left of zero."""
    from matplotlib.ticker import MaxNLocator

    steps, minutes = curve["steps"] / 1e6, curve["wall_seconds"] / 60
    if len(steps) < 2 or minutes[-1] <= minutes[0]:
        return
    pace = (minutes[-1] - minutes[0]) / (steps[-1] - steps[0])  # [min / million steps]
    outer = (
        np.array([-1e3, *steps, steps[-1] + 1e3]),
        np.array([minutes[0] - (steps[0] + 1e3) * pace, *minutes, minutes[-1] + 1e3 * pace]),
    )
    twin = axis.secondary_xaxis(
        "top", functions=(lambda x: np.interp(x, *outer), lambda t: np.interp(t, *reversed(outer)))
    )
    share = (steps[-1] - steps[0]) / max(axis.get_xlim()[1], steps[-1])  # of the axis: room for labels
    ticks = MaxNLocator(max(round(5 * share), 1)).tick_values(0, minutes[-1])
    twin.set_xticks(ticks[(ticks >= 0) & (ticks <= minutes[-1])])
    twin.set_xlabel(f"wall time{whose} [min]")


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
        for axis, metric in zip(axes[0], metrics, strict=True):
            for k, (policy, seeds) in enumerate(curves.items()):
                points = (evaluations or {}).get(policy, [])
                _draw_policy(axis, policy, seeds, points, metric, CYCLE[k % len(CYCLE)])
            axis.set(xlabel="environment steps [million]", ylabel=LABELS.get(metric, metric.replace("_", " ")))
            axis.set_xlim(left=0)
        for axis in axes[0]:
            if curves:
                first = next(iter(curves))
                _wall_axis(axis, curves[first][0], f" of {first}")
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
        left.set(xlabel="environment steps [million]", ylabel="return per episode", title=title)
        right.plot(steps, curve["waypoint_fraction"], color=BLUE, label="waypoint fraction, exploring")
        right.plot(steps, curve["level"], color=ORANGE, label="level / top level")
        right.set(xlabel="environment steps [million]", ylim=(0, 1.02))
        for axis in axes[0]:
            _wall_axis(axis, curve)
        speed = f"{curve['wall_seconds'][-1] / 60:.0f} min, {np.median(curve['steps_per_second']):.0f} steps/s"
        right.legend(loc="best", title=speed)
    save_figure(figure, out, f"agility-ref plot {Path(progress).parent}")
    return True


# ---------------------------------------------------------------------------- Table 1


def table_figure(rows: list, out: Path, title: str) -> None:
    """Draw waypoint fraction and edge violation of every line of the table, ours beside the paper's.

    Parameters
    ----------
    rows : of :func:`agility_ref.results.table1.table_rows`; bars are means, dots the interquartile means
        of ours with their 95 % intervals
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
                axis.barh(y + 0.2, ours, 0.38, color=BLUE, label="ours")
                axis.barh(y - 0.2, paper, 0.38, color=ORANGE, label="paper")
                axis.hlines(y + 0.2, sure[:, 1], sure[:, 2], color="black", linewidth=1.2)
                axis.plot(sure[:, 0], y + 0.2, ".", color="black", label="ours: IQM, 95 % interval")
                axis.set_yticks(y, [row.policy for row in here])
                axis.set(title=environment if line == 0 else "", xlabel=metric.replace("_", " "), xlim=(0, None))
                axis.grid(visible=False, axis="y")
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

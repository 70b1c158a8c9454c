"""Table 1 on paper: text for the terminal, CSV, Markdown, LaTeX and a picture.

In:  the rows of :mod:`agility_ref.results.table1`.
Out: two tables: mean and standard deviation, ours beside the paper's, as the paper prints
them; and what may be said of ours: interquartile mean, success rate, steps spent.
"""

import math
from collections.abc import Callable
from pathlib import Path

from agility_ref.evaluate import METRICS, EvaluationConfig
from agility_ref.files import write_csv, write_text
from agility_ref.results.table1 import Interval, Row
from agility_ref.training.progress import attempt

HEADINGS = {
    "reward": "Reward",
    "episode_length": "Ep. length",
    "waypoint_fraction": "% WP",
    "edge_violation": "Violation",
}
DIGITS = {"reward": 2, "episode_length": 0, "waypoint_fraction": 2, "edge_violation": 2}
NOTES = (
    "Mean ± standard deviation over episodes, as the paper prints it: the spread between episodes, not the uncertainty "
    "of the mean.  Rewards cannot be compared with the paper's: the weights of the terms differ.",
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


def headings(second: bool) -> list[str]:
    """Return the headings of the first or the second table, without environment and policy."""
    if second:
        return [*HEADINGS.values(), *EXTRA_HEADINGS]
    return [f"{HEADINGS[m]} {who}" for m in METRICS for who in ("ours", "paper")]


def has_intervals(rows: list[Row]) -> bool:
    """Whether the second table has anything to say that the first has not."""
    return any(row.ours and row.ours.iqm for row in rows)


# ---------------------------------------------------------------------------- terminal, Markdown, CSV


def text(rows: list[Row]) -> str:
    """Return both tables for a terminal."""
    lines = _columns(rows, [part for m in METRICS for part in (HEADINGS[m], "paper")], compared)
    if has_intervals(rows):
        lines += ["", "interquartile mean and success rate with 95 % intervals, environment steps, training seeds"]
        lines += _columns(rows, headings(True), surely)
    return "\n".join(lines)


def _columns(rows: list[Row], heads: list[str], values: Callable[[Row], list[str]]) -> list[str]:
    table = [heads, *map(values, rows)]
    widths = [max(map(len, column)) + 2 for column in zip(*table, strict=True)]
    names, previous = [f"{'':27}"], ""
    for row in rows:
        names.append(f"{row.environment if row.environment != previous else '':10} {row.policy:16}")
        previous = row.environment
    return [
        name + "".join(f"{value:>{width}}" for value, width in zip(line, widths, strict=True))
        for name, line in zip(names, table, strict=True)
    ]


def markdown(rows: list[Row]) -> str:
    """Return both tables in Markdown, each with a note on how to read it."""
    parts = [_markdown(rows, headings(False), compared), "", NOTES[0]]
    if has_intervals(rows):
        parts += ["", "## How sure", "", _markdown(rows, headings(True), surely), "", NOTES[1]]
    return "\n".join(parts) + "\n"


def _markdown(rows: list[Row], heads: list[str], values: Callable[[Row], list[str]]) -> str:
    lines = ["| Environment | Policy | " + " | ".join(heads) + " |", "|---" * (len(heads) + 2) + "|"]
    lines += [f"| {row.environment} | {row.policy} | " + " | ".join(values(row)) + " |" for row in rows]
    return "\n".join(lines)


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


# ---------------------------------------------------------------------------- LaTeX


def latex(rows: list[Row], caption: str) -> str:
    r"""Return both tables as LaTeX ``table*`` environments.

    The document needs ``\usepackage{booktabs}`` and nothing else.
    """
    groups = "".join(rf" & \multicolumn{{2}}{{c}}{{{_escape(HEADINGS[m])}}}" for m in METRICS) + r" \\"
    rules = "".join(rf"\cmidrule(lr){{{3 + 2 * k}-{4 + 2 * k}}}" for k in range(len(METRICS)))
    first = [f" & {groups}", rules, _latex_row(["Environment", "Policy", *("ours", "paper") * len(METRICS)])]
    parts = [_latex_table(rows, first, compared, f"{caption}. {NOTES[0]}", "tab:agility-ref-table1")]
    if has_intervals(rows):
        second = [_latex_row(["Environment", "Policy", *headings(True)])]
        parts.append(_latex_table(rows, second, surely, f"{caption}. {NOTES[1]}", "tab:agility-ref-intervals"))
    return "% Needs \\usepackage{booktabs}.\n" + "\n".join(parts)


def _latex_table(
    rows: list[Row], heads: list[str], values: Callable[[Row], list[str]], caption: str, label: str
) -> str:
    columns = len(values(rows[0]))
    body, previous = [], rows[0].environment
    for row in rows:
        if row.environment != previous:
            body.append(r"\midrule")
        previous = row.environment
        body.append(" & ".join([row.environment, row.policy, *map(_math, values(row))]) + r" \\")
    return "\n".join([
        r"\begin{table*}", r"\centering", rf"\caption{{{_escape(caption)}}}", rf"\label{{{label}}}",
        r"\scriptsize", r"\setlength{\tabcolsep}{3pt}", rf"\begin{{tabular}}{{ll{'r' * columns}}}",
        r"\toprule", *heads, r"\midrule", *body, r"\bottomrule", r"\end{tabular}", r"\end{table*}", "",
    ])  # fmt: skip


def _latex_row(values: list[str]) -> str:
    return " & ".join(_escape(value) for value in values) + r" \\"


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


# ---------------------------------------------------------------------------- files


def write_all(rows: list[Row], folder: Path, caption: str) -> list[Path]:
    """Write table1.csv, table1.md and table1.tex, and draw table1.png if that can be done; return their paths."""
    from agility_ref.pictures.plots import table_figure

    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"table1.{suffix}" for suffix in ("csv", "md", "tex", "png")]
    write_csv(paths[0], [csv_line(row) for row in rows])
    write_text(paths[1], f"# {caption}\n\n{markdown(rows)}")
    write_text(paths[2], latex(rows, caption))
    return paths if attempt(table_figure, rows, paths[3], caption) else paths[:3]

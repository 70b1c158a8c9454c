"""Figures of a diagnosis: confusion matrices, skill timelines, and where mistakes happen.

In:  one :class:`~agility_ref.trace.Trace` an environment, all of one policy.
Out: matplotlib figures; skills keep their colours from the other pictures.
"""

import numpy as np

from agility_ref.diagnosis import OFFSETS, confusion, wrong_share
from agility_ref.evaluate import oracle_accuracy
from agility_ref.plots import SKILL_COLOURS, empty_figure, new_figure, skill_colour, style
from agility_ref.terrain import LANE_LENGTH, LANE_WIDTH, SKILLS
from agility_ref.trace import Trace
from agility_ref.world import LEAD, height_map, region_map

HALF_WIDTH = 1.5  # [m] of the lane shown on either side of its middle


def _rgb(names: list[str]) -> np.ndarray:
    """Colours of skills, (n, 3) from 0 to 1."""
    from matplotlib.colors import to_rgb

    return np.array([to_rgb(skill_colour(name)) for name in names])


def _legend(figure, names: list[str]) -> None:
    from matplotlib.patches import Patch

    items = [Patch(color=skill_colour(name), label=name) for name in names]
    figure.legend(handles=items, loc="outside lower center", ncols=6)


def confusion_figure(traces: list[Trace]):
    """One confusion matrix an environment: share of the oracle's steps (rows) by the skill chosen (columns)."""
    skills = traces[0].skills
    with style():
        figure, axes = new_figure(1, len(traces), (3.2 * len(traces) + 1.4, 4.6))
        for axis, trace in zip(axes[0], traces, strict=True):
            counts = confusion(trace.skill, trace.oracle, len(skills))
            wanted = counts.sum(axis=1, keepdims=True)
            shares = counts / np.maximum(wanted, 1)
            axis.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
            for (i, j), share in np.ndenumerate(shares):
                if wanted[i, 0]:
                    colour = "white" if share > 0.6 else "black"
                    axis.text(j, i, f"{100 * share:.0f}", ha="center", va="center", color=colour)
            axis.set_xticks(range(len(skills)), skills, rotation=45, ha="right")
            axis.set_yticks(range(len(skills)), skills if axis is axes[0, 0] else [""] * len(skills))
            agree = 100 * oracle_accuracy(trace.skill, trace.oracle).mean()
            axis.set_title(f"{trace.environment}: {agree:.0f} % agree", loc="left")
            axis.set_xlabel("chosen")
            axis.grid(visible=False)
        axes[0, 0].set_ylabel("wanted by the oracle")
        figure.suptitle(f"{traces[0].policy}: skill chosen, % of each row", x=0.01, ha="left")
        return figure


def timeline_figure(traces: list[Trace], episodes: int = 8):
    """Skill chosen over time in the first episodes of each environment, the oracle's in a thin band below."""
    with style():
        figure, axes = new_figure(len(traces), 1, (10.0, 0.9 + 2.3 * len(traces)))
        for axis, trace in zip(axes[:, 0], traces, strict=True):
            shown = min(episodes, trace.skill.shape[1])
            # The last colour is that of nothing: after the end, and between two episodes.
            colours = np.vstack([_rgb(list(trace.skills)), [1.0, 1.0, 1.0]])
            nothing = np.full(len(trace.skill), -1)
            rows = [row for n in range(shown) for row in (*[trace.skill[:, n]] * 3, trace.oracle[:, n], nothing)]
            seconds = len(trace.skill) * trace.dt
            axis.imshow(colours[rows], aspect="auto", extent=(0, seconds, shown, 0), interpolation="nearest")
            axis.set_yticks(np.arange(shown) + 0.4, range(shown))
            axis.set(ylabel="episode")
            axis.set_title(trace.environment, loc="left")
            axis.grid(visible=False)
        axes[-1, 0].set_xlabel("time [s]")
        figure.suptitle(f"{traces[0].policy}: skill chosen, and below it the oracle's", x=0.01, ha="left")
        _legend(figure, list(traces[0].skills))
        return figure


def mistakes_figure(traces: list[Trace]):
    """Wrong choices around the obstacles, and from above on one course of each environment."""
    profiles, lanes = [[f"{part}{k}" for k in range(len(traces))] for part in ("profile", "lane")]
    with style():
        figure = empty_figure((12.0, 4.2 + 2.2 * len(traces)))
        figure.set_layout_engine("constrained")
        axes = figure.subplot_mosaic(
            [profiles, *[[lane] * len(traces) for lane in lanes]], height_ratios=[1.5, *[1.0] * len(traces)]
        )
        for trace, above, below in zip(traces, profiles, lanes, strict=True):
            _draw_profile(axes[above], trace)
            _draw_course(axes[below], trace)
        axes[profiles[0]].set_ylabel("share of time on a wrong skill,\nby nearest obstacle")
        axes[lanes[-1]].set_xlabel("x [m]; dots: wrong choices, in the colour of the skill chosen")
        figure.suptitle(f"{traces[0].policy}: where its choice is not the oracle's", x=0.01, ha="left")
        shown = {*SKILLS, *traces[0].skills}
        _legend(figure, [name for name in SKILL_COLOURS if name in shown])
        return figure


def _draw_profile(axis, trace: Trace) -> None:
    """Draw the share of wrong choices around each kind of obstacle; dashed, where the oracle's region begins."""
    for name, share in zip(SKILLS, wrong_share(trace), strict=True):
        if not np.isnan(share).all():
            axis.stairs(share, OFFSETS, color=SKILL_COLOURS[name], linewidth=2.0)
            axis.axvline(-LEAD[name], color=SKILL_COLOURS[name], linestyle="--", linewidth=1.5)
    axis.axvline(0.0, color="black", linewidth=1.0)
    axis.set(xlim=(OFFSETS[0], OFFSETS[-1]), ylim=(0, 1.02), xlabel="x from the obstacle [m]")
    axis.set_title(trace.environment, loc="left")


def widest_mistakes(trace: Trace) -> int:
    """Episode whose wrong choices are spread over the most decimetres of x."""
    tenths = np.where(trace.wrong, (10 * trace.position[:, :, 0]).astype(int), -1)
    return int(np.argmax([len(np.unique(column[column >= 0])) for column in tenths.T]))


def _draw_course(axis, trace: Trace) -> None:
    """Draw a course from above: height, the oracle's regions, the path, wrong choices by the skill chosen."""
    n = widest_mistakes(trace)
    course, played = trace.courses[n], trace.skill[:, n] >= 0
    heights = height_map(course)
    axis.imshow(
        heights.T, origin="lower", extent=(0, LANE_LENGTH, -LANE_WIDTH / 2, LANE_WIDTH / 2), cmap="gray",
        vmin=heights.min() - 0.5 * max(np.ptp(heights), 0.2), interpolation="nearest", aspect="auto",
    )  # fmt: skip
    colours = np.array([(*rgb, 0.0 if name == "walk" else 0.5) for name, rgb in zip(SKILLS, _rgb(SKILLS), strict=True)])
    regions = colours[region_map(course)][None]
    axis.imshow(
        regions, extent=(0, LANE_LENGTH, -HALF_WIDTH, HALF_WIDTH), aspect="auto", interpolation="nearest"
    )  # fmt: skip
    x, y = trace.position[played, n, :2].T
    axis.plot(x, y, color="black", linewidth=1.0)
    wrong = trace.wrong[played, n]
    chosen = _rgb(list(trace.skills))[trace.skill[played, n][wrong]]
    axis.scatter(x[wrong], y[wrong], s=26, c=chosen, edgecolors="black", linewidths=0.5, zorder=4)
    axis.set(xlim=(0, course.waypoints[:, 0].max() + 1.0), ylim=(-HALF_WIDTH, HALF_WIDTH), ylabel="y [m]")
    axis.set_title(
        f"{trace.environment}, episode {n}, d = {course.difficulty:.2f}: wrong in {100 * wrong.mean():.0f} % of its steps",
        loc="left", fontsize=12,
    )  # fmt: skip
    axis.grid(visible=False)

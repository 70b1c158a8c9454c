"""Pictures of episodes: strobe pictures and the oracle policy map (the paper's Fig. 3).

Pure matplotlib: no graphics library, no display.

In:  :class:`~agility_ref.pictures.record.Episode` objects.  Out: matplotlib figures.
"""

from itertools import pairwise

from agility_ref.errors import UserError
from agility_ref.go1 import FOOT_RADIUS, LEGS
from agility_ref.pictures.plots import PURPLE, RED, SKILL_COLOURS, empty_figure, new_figure, skill_colour, style
from agility_ref.pictures.record import Episode
from agility_ref.pictures.scene import LEG_COLOURS, SIDE, Robot, find_edges, waypoint_heights
from agility_ref.terrain import CELL, LANE_LENGTH, LANE_WIDTH, NUM_WAYPOINTS, SKILLS, Course
from agility_ref.world import EDGE_MIN_DROP, height_map, region_map

import numpy as np

VIOLATION, ROBOT = RED, PURPLE
ROW_LENGTH = 5.0  # [m] of course in one row of a strobe picture
X = (np.arange(round(LANE_LENGTH / CELL)) + 0.5) * CELL  # [m] centres of the height map's cells
Y = (np.arange(round(LANE_WIDTH / CELL)) + 0.5) * CELL - LANE_WIDTH / 2


def stretches(values: np.ndarray) -> list[tuple[int, int]]:
    """Cut an array (n,) or (n, k) where its value changes; return (start, stop) of every stretch."""
    rows = values.reshape(len(values), -1)
    changes = (rows[1:] != rows[:-1]).any(axis=1)
    borders = [0, *np.flatnonzero(changes) + 1, len(values)]
    return [(int(start), int(stop)) for start, stop in pairwise(borders)]


# ---------------------------------------------------------------------------- strobe


def ground_along(course: Course, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of the ground [m] at every X along a path x, y [m]."""
    order = np.argsort(x, kind="stable")
    path_y = np.interp(X, x[order], y[order])
    heights = height_map(course)
    j = np.clip(((path_y + LANE_WIDTH / 2) / CELL).astype(int), 0, heights.shape[1] - 1)
    return heights[np.arange(len(X)), j]


def instants(episode: Episode, period: float, spacing: float) -> list[int]:
    """Steps at which to draw the robot: every ``period`` [s], and not within ``spacing`` [m]."""
    chosen: list[int] = []
    for t in range(0, len(episode), max(round(period / episode.dt), 1)):
        if not chosen or np.hypot(*(episode.qpos[t, :2] - episode.qpos[chosen[-1], :2])) >= spacing:
            chosen.append(t)
    last = len(episode) - 1
    if np.hypot(*(episode.qpos[last, :2] - episode.qpos[chosen[-1], :2])) >= spacing / 2:
        chosen.append(last)
    return chosen


def strobe(episode: Episode, period: float = 0.7, spacing: float = 0.3):
    """Side view to scale, the robot at regular instants; return the figure.

    Parameters
    ----------
    episode : what was played
    period : time between two drawings of the robot [s]
    spacing : a robot that has moved less than this since its last drawing is not drawn [m]

    Raises
    ------
    UserError : a period that is not above 0 and finite
    """
    if not 0.0 < period < np.inf:
        raise UserError(f"period must be above 0, got {period}")
    x, z = episode.qpos[:, 0], episode.qpos[:, 2]
    ground = ground_along(episode.course, x, episode.qpos[:, 1])
    heights = height_map(episode.course)
    highest, lowest = heights.max(axis=1), heights.min(axis=1)
    begin, end = max(float(x.min()) - 0.6, 0.0), min(float(x.max()) + 0.7, LANE_LENGTH)
    count = max(int(np.ceil((end - begin) / ROW_LENGTH - 0.1)), 1)
    starts = begin + ROW_LENGTH * np.arange(count)
    limits = []
    for start in starts:
        here = (start - 0.3 <= X) & (start + ROW_LENGTH + 0.3 >= X)
        on_row = (x >= start - 0.3) & (x <= start + ROW_LENGTH + 0.3)
        top = max(highest[here].max() + 0.70, z[on_row].max() + 0.40 if on_row.any() else -np.inf)
        bottom = max(lowest[here].min() - 0.12, np.median(ground[here]) - 0.75)
        limits.append((bottom, top))
    width, pad, head, foot = 10.0, 0.42, 0.62, 0.60  # [inch]
    scale = (width - 0.9) / ROW_LENGTH
    panels = [(top - bottom) * scale for bottom, top in limits]
    with style():
        figure = empty_figure((width, sum(panels) + pad * (count - 1) + head + foot))
        total = figure.get_figheight()
        robot, drawn = Robot(episode.course), instants(episode, period, spacing)
        upper = total - head
        for start, (bottom, top), height in zip(starts, limits, panels, strict=True):
            axis = figure.add_axes((0.7 / width, (upper - height) / total, ROW_LENGTH * scale / width, height / total))
            upper -= height + pad
            axis.set(xlim=(start, start + ROW_LENGTH), ylim=(bottom, top), ylabel="z [m]")
            axis.set_yticks(np.arange(np.ceil(5 * bottom), 5 * top) / 5)
            axis.grid(visible=False)
            draw_ground(axis, ground, heights, bottom)
            _draw_waypoints(axis, episode, start)
            _draw_skill_band(axis, episode, top)
            axis.plot(x, z, color="black", linewidth=0.8, alpha=0.4, zorder=3)
            previous = -np.inf
            for k, t in enumerate(drawn):
                if start - 0.4 < x[t] < start + ROW_LENGTH + 0.4:
                    robot.draw(axis, episode.qpos[t], 5 + 0.01 * k)
                    if start + 0.1 < x[t] < start + ROW_LENGTH - 0.1 and abs(x[t] - previous) > 0.35:
                        later = drawn[k + 1] if k + 1 < len(drawn) else len(episode)
                        label = f"{t * episode.dt:.1f}"
                        if (later - t) * episode.dt > 2 * period:  # it stood here, or tried in vain
                            label += f" to {later * episode.dt:.1f}"
                        place = {"ha": "center", "va": "bottom", "fontsize": 10.5, "zorder": 12}
                        axis.text(x[t], z[t] + 0.11, f"{label} s", **place)
                        previous = x[t]
            _draw_contacts(axis, episode)
        axis.set_xlabel("x [m], to scale")
        figure.text(0.7 / width, 1 - 0.12 / total, episode.summary(), fontsize=13, va="top")
        _strobe_legend(figure, episode, 1 - 0.36 / total, 0.7 / width)
        return figure


def draw_ground(axis, ground: np.ndarray, heights: np.ndarray, bottom: float) -> None:
    """Fill the ground along a path, behind it what stands higher in the lane, and the sides of beams.

    Parameters
    ----------
    ground : (nx,) height under the path [m]
    heights : (nx, ny) height of the whole lane [m]
    bottom : lowest height shown [m]
    """
    beside = heights.min(axis=1)
    beside = np.where(ground - beside > EDGE_MIN_DROP, beside, ground)  # tiles of rough ground have no sides
    levels = np.stack([heights.max(axis=1), ground, beside])
    parts = np.array(stretches(levels.T))  # the corners alone: 900 points a curve make an SVG of megabytes
    x = parts.ravel() * CELL
    highest, ground, beside = np.repeat(levels[:, parts[:, 0]], 2, axis=1)
    axis.fill_between(x, highest, bottom - 1, color="#E9E5DC", zorder=1, linewidth=0)
    axis.fill_between(x, ground, beside, color=SIDE, zorder=2, linewidth=0)
    axis.fill_between(x, beside, bottom - 1, color="#C9C2B4", zorder=2, linewidth=0)
    axis.plot(x, ground, color="#6B6558", linewidth=1.0, zorder=2.5)


def _draw_waypoints(axis, episode: Episode, start: float) -> None:
    for k, (x, z) in enumerate(zip(episode.course.waypoints[:, 0], waypoint_heights(episode.course), strict=True)):
        if start <= x < start + ROW_LENGTH:
            colour = ROBOT if k < episode.reached else "white"
            axis.plot([x, x], [z, z + 0.58], color="black", linewidth=0.8, alpha=0.5, zorder=2.6)
            axis.plot(x, z + 0.58, "o", color=colour, markeredgecolor="black", markersize=7, clip_on=False)
            axis.annotate(str(k + 1), (x, z + 0.58), (5, 0), textcoords="offset points", va="center", fontsize=10)


def _draw_skill_band(axis, episode: Episode, top: float) -> None:
    """Colour the top of a row by the acting skill, and below it by the oracle's."""
    if episode.skill is None:
        return
    x = episode.qpos[:, 0]
    for indices, low, high in ((episode.skill, top - 0.10, top - 0.02), (episode.wanted, top - 0.19, top - 0.11)):
        for start, stop in stretches(indices):
            span = [x[start], x[min(stop, len(x) - 1)]]
            colour = skill_colour(episode.skills[indices[start]])
            axis.fill_between(span, low, high, color=colour, linewidth=0, zorder=2.7)
    inside = axis.get_xlim()[0] + 0.03
    for label, height in (("chosen", top - 0.06), ("oracle", top - 0.15)):
        if x.min() > inside + 0.45:
            axis.text(inside, height, label, fontsize=10, va="center", zorder=3)


def _draw_contacts(axis, episode: Episode) -> None:
    """Mark every step of every foot that stands, by leg; in red where it violates an edge."""
    for k, leg in enumerate(LEGS):
        standing = episode.foot_contact[:, k]
        sole = episode.foot_pos[:, k, 2] - FOOT_RADIUS - 0.02 - 0.018 * k
        axis.plot(episode.foot_pos[standing, k, 0], sole[standing], ".", color=LEG_COLOURS[leg], markersize=3, zorder=4)
        wrong = episode.foot_on_edge[:, k]
        axis.plot(
            episode.foot_pos[wrong, k, 0], episode.foot_pos[wrong, k, 2] - FOOT_RADIUS,
            "x", color=VIOLATION, markersize=7, markeredgewidth=2, zorder=9,
        )  # fmt: skip


def _strobe_legend(figure, episode: Episode, y: float, x: float) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    items = [Line2D([], [], ls="", marker="o", ms=6, color=LEG_COLOURS[leg], label=leg) for leg in LEGS]
    items.append(Line2D([], [], ls="", marker="x", ms=7, mew=2, color=VIOLATION, label="edge violated"))
    items.append(Line2D([], [], ls="", marker="o", ms=7, color=ROBOT, mec="black", label="waypoint reached"))
    items += [Patch(color=skill_colour(name), label=name) for name in episode.skills]
    figure.legend(
        handles=items, loc="upper left", bbox_to_anchor=(x - 0.012, y), ncols=len(items), fontsize=10,
        handletextpad=0.2, columnspacing=0.9, borderpad=0, handlelength=1.2,
    )  # fmt: skip


# ---------------------------------------------------------------------------- oracle policy map


def oracle_map(episodes: list[Episode], half_width: float = 1.5):
    """Courses from above with the oracle's regions and the robots' trails: the paper's Fig. 3.

    Parameters
    ----------
    episodes : those of one course side by side, as :func:`~agility_ref.pictures.record.record` returns them
    half_width : how much of the lane to show on either side of its middle [m]
    """
    lanes: dict[int, list[Episode]] = {}
    for episode in episodes:
        lanes.setdefault(id(episode.course), []).append(episode)
    hierarchy = episodes[0].skill is not None
    first = episodes[0]
    with style():
        end = min(max(e.course.waypoints[:, 0].max() for e in episodes) + 1.0, LANE_LENGTH)
        lane_height = 9.1 / end * (2 * half_width + 0.75 * hierarchy) + 0.62  # [inch]
        figure, axes = new_figure(len(lanes), 1, (10.0, 1.1 + lane_height * len(lanes)))
        everything = [height_map(lane[0].course) for lane in lanes.values()]
        shades = min(h.min() for h in everything), max(h.max() for h in everything)
        for axis, lane, heights in zip(axes[:, 0], lanes.values(), everything, strict=True):
            _draw_lane(axis, lane[0].course, heights, shades, end, half_width)
            for episode in lane:
                _draw_trail(axis, episode)
            bottom = -half_width
            if hierarchy:
                bottom -= 0.75
                _draw_choices(axis, lane, -half_width)
            reached = np.mean([e.reached for e in lane]) / NUM_WAYPOINTS
            title = axis.set_title(
                f"d = {lane[0].course.difficulty:.2f}: {100 * reached:.0f} % of the waypoints, "
                f"{sum(e.fell for e in lane)} of {len(lane)} robots fell" + _agreement(lane),
                fontsize=12, loc="left",
            )  # fmt: skip
            title.set_in_layout(False)  # a long title must not squeeze the lane
            axis.set(xlim=(0, end), ylim=(bottom, half_width), ylabel="y [m]", aspect="equal")
            axis.set_yticks([-1, 0, 1])
            axis.grid(visible=False)
        axis.set_xlabel("x [m]")
        figure.suptitle(f"{first.policy} on {first.environment}, from above", x=0.01, ha="left")
        _map_legend(figure, episodes)
        return figure


def _draw_lane(
    axis, course: Course, heights: np.ndarray, shades: tuple[float, float], end: float, half_width: float
) -> None:
    """Shade the height, overlay the skill regions, mark edges and waypoints."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Rectangle

    shown = np.abs(Y) < half_width
    low, high = shades
    axis.imshow(
        heights[:, shown].T, origin="lower", extent=(0, LANE_LENGTH, -half_width, half_width), cmap="gray",
        vmin=low - 0.5 * max(high - low, 0.2), vmax=high + 0.1 * max(high - low, 0.2), interpolation="nearest",
    )  # fmt: skip
    regions = region_map(course)
    for start, stop in stretches(regions):
        name = SKILLS[regions[start]]
        if name != "walk":
            span = [start * CELL, stop * CELL]
            axis.fill_between(span, -half_width, half_width, color=skill_colour(name), alpha=0.5, linewidth=0)
    lines = [[(e.x0, e.y0), (e.x1, e.y1)] for e in find_edges(heights)]
    edges = axis.add_collection(LineCollection(lines, colors="black", linewidths=0.8, alpha=0.6, in_layout=False))
    edges.set_clip_path(Rectangle((0, -half_width), end, 2 * half_width, transform=axis.transData))
    axis.plot(*course.waypoints.T, "D", color="white", markeredgecolor="black", markersize=6, zorder=4)


def _draw_trail(axis, episode: Episode) -> None:
    """Draw the path, coloured by the chosen skill, and the robot where its episode ended."""
    from matplotlib.collections import LineCollection

    xy = episode.qpos[:, :2]
    axis.plot(*xy.T, color="black", linewidth=2.6 if episode.skill is not None else 1.0, alpha=0.55, zorder=5)
    if episode.skill is not None:
        parts = stretches(episode.skill)  # one line per stretch: an SVG with one per step takes seconds
        lines = [xy[start : stop + 1] for start, stop in parts]
        colours = [skill_colour(episode.skills[episode.skill[start]]) for start, _ in parts]
        axis.add_collection(LineCollection(lines, colors=colours, linewidths=1.8, zorder=6, in_layout=False))
    marker = "X" if episode.fell else "o"
    axis.plot(*xy[-1], marker, color=ROBOT, markeredgecolor="black", markersize=9, zorder=7)


def _draw_choices(axis, lane: list[Episode], top: float) -> None:
    """Two strips below a lane: the commonest choice in every 0.1 m, and the oracle's."""
    names = lane[0].skills
    width = 0.1  # [m]
    bins = np.concatenate([(e.qpos[:, 0] / width).astype(int) for e in lane])
    for attribute, high in (("skill", top - 0.08), ("wanted", top - 0.42)):
        values = np.concatenate([getattr(e, attribute) for e in lane])
        votes = np.zeros((bins.max() + 1, len(names)), int)
        np.add.at(votes, (bins, values), 1)
        commonest = np.where(votes.any(axis=1), votes.argmax(axis=1), -1)  # -1: nobody came here
        for start, stop in stretches(commonest):
            if commonest[start] >= 0:
                colour = skill_colour(names[commonest[start]])
                axis.fill_between([start * width, stop * width], high - 0.28, high, color=colour, linewidth=0)
        label = "chosen" if attribute == "skill" else "oracle"
        axis.text(bins.min() * width - 0.05, high - 0.14, label, fontsize=10, va="center", ha="right")


def _agreement(lane: list[Episode]) -> str:
    """Share of steps in which the chosen skill was the oracle's, as text."""
    if lane[0].skill is None:
        return ""
    same = np.concatenate([e.skill == e.wanted for e in lane])
    return f", {100 * same.mean():.0f} % of the choices are the oracle's"


def _map_legend(figure, episodes: list[Episode]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    marks = {"waypoint": ("D", "white"), "robot": ("o", ROBOT), "robot that fell": ("X", ROBOT)}
    regions = {SKILLS[k] for e in episodes for k in np.unique(region_map(e.course))} | set(episodes[0].skills)
    items = [Line2D([], [], ls="", marker=m, ms=8, color=c, mec="black", label=name) for name, (m, c) in marks.items()]
    items += [Patch(color=skill_colour(name), label=name) for name in SKILL_COLOURS if name in regions]
    figure.legend(handles=items, loc="outside lower center", ncols=len(items), fontsize=10.5, columnspacing=1.0)

"""Pictures: strobe, oracle policy map (the paper's Fig. 3), skills (its Fig. 1) and the kinds of course.

Pure matplotlib: no graphics library, no display.

In:  :class:`~agility_ref.pictures.record.Episode` objects; for the courses nothing.  Out: matplotlib figures.
"""

from agility_ref import terrain
from agility_ref.errors import UserError
from agility_ref.go1 import FOOT_RADIUS, LEGS, STAND_HEIGHT
from agility_ref.pictures.plots import (
    BLUE,
    LEG_COLOURS,
    PURPLE,
    RED,
    SKILL_COLOURS,
    empty_figure,
    new_figure,
    skill_colour,
    style,
)  # fmt: skip
from agility_ref.pictures.record import Episode
from agility_ref.pictures.scene import (
    SIDE,
    Robot,
    X,
    Y,
    draw_ground,
    find_edges,
    ground_along,
    stretches,
    waypoint_heights,
)  # fmt: skip
from agility_ref.terrain import BEAM_DROP, CELL, COURSE_KINDS, LANE_LENGTH, LANE_WIDTH, NUM_WAYPOINTS, SKILLS, Course
from agility_ref.world import height_map, region_map

import numpy as np

VIOLATION, ROBOT = RED, PURPLE
ROW_LENGTH = 5.0  # [m] of course in one row of a strobe picture

# ---------------------------------------------------------------------------- strobe


def instants(episode: Episode, period: float, spacing: float) -> list[int]:
    """Steps at which to draw the robot: every ``period`` [s], and not within ``spacing`` [m]."""

    def moved(t: int) -> float:
        return np.hypot(*(episode.qpos[t, :2] - episode.qpos[chosen[-1], :2]))

    chosen, last = [0], len(episode) - 1
    for t in range(0, len(episode), max(round(period / episode.dt), 1)):
        if moved(t) >= spacing:
            chosen.append(t)
    return [*chosen, last] if moved(last) >= spacing / 2 else chosen


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
    x, z, heights = episode.qpos[:, 0], episode.qpos[:, 2], height_map(episode.course)
    ground = ground_along(episode.course, x, episode.qpos[:, 1])
    begin, end = max(float(x.min()) - 0.6, 0.0), min(float(x.max()) + 0.7, LANE_LENGTH)
    starts = begin + ROW_LENGTH * np.arange(max(int(np.ceil((end - begin) / ROW_LENGTH - 0.1)), 1))
    limits = []
    for start in starts:
        here = (start - 0.3 <= X) & (start + ROW_LENGTH + 0.3 >= X)
        on_row = (x >= start - 0.3) & (x <= start + ROW_LENGTH + 0.3)
        top = max(heights[here].max() + 0.70, z[on_row].max() + 0.40 if on_row.any() else -np.inf)
        limits.append((max(heights[here].min() - 0.12, np.median(ground[here]) - 0.75), top))
    width, pad, head, foot = 10.0, 0.42, 0.62, 0.60  # [inch]
    scale = (width - 0.9) / ROW_LENGTH
    panels = [(top - bottom) * scale for bottom, top in limits]
    with style():
        figure = empty_figure((width, sum(panels) + pad * (len(starts) - 1) + head + foot))
        total, robot, drawn = figure.get_figheight(), Robot(episode.course), instants(episode, period, spacing)
        upper = total - head
        for start, (bottom, top), height in zip(starts, limits, panels, strict=True):
            axis = figure.add_axes((0.7 / width, (upper - height) / total, ROW_LENGTH * scale / width, height / total))
            upper -= height + pad
            axis.set(xlim=(start, start + ROW_LENGTH), ylim=(bottom, top), ylabel="z [m]")
            axis.set_yticks(np.arange(np.ceil(5 * bottom), 5 * top) / 5)
            axis.grid(visible=False)
            draw_ground(axis, ground, heights, bottom)
            _draw_waypoints(axis, episode, start)
            if episode.skill is not None:
                _draw_skill_band(axis, episode, top)
            axis.plot(x, z, color="black", linewidth=0.8, alpha=0.4, zorder=3)
            _draw_robots(axis, episode, robot, drawn, period, start)
            _draw_contacts(axis, episode)
        axis.set_xlabel("x [m], to scale")
        figure.text(0.7 / width, 1 - 0.12 / total, episode.summary(), fontsize=13, va="top")
        _strobe_legend(figure, episode, 1 - 0.36 / total, 0.7 / width)
        return figure


def _draw_robots(axis, episode: Episode, robot: Robot, drawn: list[int], period: float, start: float) -> None:
    """Draw the robot at each instant of a row, with the time where there is room for it."""
    x, z, previous = episode.qpos[:, 0], episode.qpos[:, 2], -np.inf
    for k, t in enumerate(drawn):
        if start - 0.4 < x[t] < start + ROW_LENGTH + 0.4:
            robot.draw(axis, episode.qpos[t], 5 + 0.01 * k)
            if start + 0.1 < x[t] < start + ROW_LENGTH - 0.1 and abs(x[t] - previous) > 0.35:
                later, label = drawn[k + 1] if k + 1 < len(drawn) else len(episode), f"{t * episode.dt:.1f}"
                if (later - t) * episode.dt > 2 * period:  # it stood here, or tried in vain
                    label += f" to {later * episode.dt:.1f}"
                axis.text(x[t], z[t] + 0.11, f"{label} s", ha="center", va="bottom", fontsize=10.5, zorder=12)
                previous = x[t]


def _draw_waypoints(axis, episode: Episode, start: float) -> None:
    for k, (x, z) in enumerate(zip(episode.course.waypoints[:, 0], waypoint_heights(episode.course), strict=True)):
        if start <= x < start + ROW_LENGTH:
            colour = ROBOT if k < episode.reached else "white"
            axis.plot([x, x], [z, z + 0.58], color="black", linewidth=0.8, alpha=0.5, zorder=2.6)
            axis.plot(x, z + 0.58, "o", color=colour, markeredgecolor="black", markersize=7, clip_on=False)
            axis.annotate(str(k + 1), (x, z + 0.58), (5, 0), textcoords="offset points", va="center", fontsize=10)


def _draw_skill_band(axis, episode: Episode, top: float) -> None:
    """Colour the top of a row by the acting skill, and below it by the oracle's."""
    x, left = episode.qpos[:, 0], axis.get_xlim()[0] + 0.03
    for label, indices, height in (("chosen", episode.skill, top - 0.06), ("oracle", episode.wanted, top - 0.15)):
        for start, stop in stretches(indices):
            span, colour = [x[start], x[min(stop, len(x) - 1)]], skill_colour(episode.skills[indices[start]])
            axis.fill_between(span, height - 0.04, height + 0.04, color=colour, linewidth=0, zorder=2.7)
        if x.min() > left + 0.45:
            axis.text(left, height, label, fontsize=10, va="center", zorder=3)


def _draw_contacts(axis, episode: Episode) -> None:
    """Mark every step of every foot that stands, by leg; in red where it violates an edge."""
    for k, leg in enumerate(LEGS):
        x, sole = episode.foot_pos[:, k, 0], episode.foot_pos[:, k, 2] - FOOT_RADIUS
        on, wrong = episode.foot_contact[:, k], episode.foot_on_edge[:, k]
        below = sole[on] - 0.02 - 0.018 * k
        axis.plot(x[on], below, ".", color=LEG_COLOURS[leg], markersize=3, zorder=4)
        axis.plot(x[wrong], sole[wrong], "x", color=VIOLATION, markersize=7, markeredgewidth=2, zorder=9)


def _strobe_legend(figure, episode: Episode, y: float, x: float) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    items = [Line2D([], [], ls="", marker="o", ms=6, color=LEG_COLOURS[leg], label=leg) for leg in LEGS]
    items.append(Line2D([], [], ls="", marker="x", ms=7, mew=2, color=VIOLATION, label="edge violated"))
    items.append(Line2D([], [], ls="", marker="o", ms=7, color=ROBOT, mec="black", label="waypoint reached"))
    if any(obstacle.skill == "beam" for obstacle in episode.course.obstacles):
        items.append(Patch(color=SIDE, label="side of a beam"))
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
    first, hierarchy = episodes[0], episodes[0].skill is not None
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
            reached = np.mean([e.reached for e in lane]) / NUM_WAYPOINTS
            text = f"d = {lane[0].course.difficulty:.2f}: {100 * reached:.0f} % of the waypoints, "
            text += f"{sum(e.fell for e in lane)} of {len(lane)} robots fell"
            if hierarchy:
                _draw_choices(axis, lane, -half_width)
                agreed = np.concatenate([~e.wrong for e in lane]).mean()
                text += f", {100 * agreed:.0f} % of the choices are the oracle's"
            axis.set_title(text, fontsize=12, loc="left").set_in_layout(False)  # a long one must not squeeze the lane
            axis.set(xlim=(0, end), ylim=(-half_width - 0.75 * hierarchy, half_width), ylabel="y [m]", aspect="equal")
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

    low, high = shades
    axis.imshow(
        heights[:, np.abs(Y) < half_width].T, origin="lower", extent=(0, LANE_LENGTH, -half_width, half_width), cmap="gray",
        vmin=low - 0.5 * max(high - low, 0.2), vmax=high + 0.1 * max(high - low, 0.2), interpolation="nearest",
    )  # fmt: skip
    regions = region_map(course)
    for start, stop in stretches(regions):
        name, span = SKILLS[regions[start]], [start * CELL, stop * CELL]
        if name != "walk":
            axis.fill_between(span, -half_width, half_width, color=skill_colour(name), alpha=0.5, linewidth=0)
    lines = [[(e.x0, e.y0), (e.x1, e.y1)] for e in find_edges(heights)]
    edges = axis.add_collection(LineCollection(lines, colors="black", linewidths=0.8, alpha=0.6, in_layout=False))
    edges.set_clip_path(Rectangle((0, -half_width), end, 2 * half_width, transform=axis.transData))
    axis.plot(*course.waypoints.T, "D", color="white", markeredgecolor="black", markersize=6, zorder=4)


def _draw_trail(axis, episode: Episode) -> None:
    """Draw the path, coloured by the chosen skill, and the robot where its episode ended."""
    from matplotlib.collections import LineCollection

    xy, hierarchy = episode.qpos[:, :2], episode.skill is not None
    axis.plot(*xy.T, color="black", linewidth=2.6 if hierarchy else 1.0, alpha=0.55, zorder=5)
    if hierarchy:
        parts = stretches(episode.skill)  # one line per stretch: an SVG with one per step takes seconds
        lines = [xy[start : stop + 1] for start, stop in parts]
        colours = [skill_colour(episode.skill_name(start)) for start, _ in parts]
        axis.add_collection(LineCollection(lines, colors=colours, linewidths=1.8, zorder=6, in_layout=False))
    marker = "X" if episode.fell else "o"
    axis.plot(*xy[-1], marker, color=ROBOT, markeredgecolor="black", markersize=9, zorder=7)


def _draw_choices(axis, lane: list[Episode], top: float) -> None:
    """Two strips below a lane: the commonest choice in every 0.1 m, and the oracle's."""
    names, width = lane[0].skills, 0.1  # [m]
    bins = np.concatenate([(e.qpos[:, 0] / width).astype(int) for e in lane])
    for label, attribute, high in (("chosen", "skill", top - 0.08), ("oracle", "wanted", top - 0.42)):
        votes = np.zeros((bins.max() + 1, len(names)), int)
        np.add.at(votes, (bins, np.concatenate([getattr(e, attribute) for e in lane])), 1)
        commonest = np.where(votes.any(axis=1), votes.argmax(axis=1), -1)  # -1: nobody came here
        for start, stop in stretches(commonest):
            if commonest[start] >= 0:
                colour = skill_colour(names[commonest[start]])
                axis.fill_between([start * width, stop * width], high - 0.28, high, color=colour, linewidth=0)
        axis.text(bins.min() * width - 0.05, high - 0.14, label, fontsize=10, va="center", ha="right")


def _map_legend(figure, episodes: list[Episode]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    marks = {"waypoint": ("D", "white"), "robot": ("o", ROBOT), "robot that fell": ("X", ROBOT)}
    regions = {SKILLS[k] for e in episodes for k in np.unique(region_map(e.course))} | set(episodes[0].skills)
    items = [Line2D([], [], ls="", marker=m, ms=8, color=c, mec="black", label=name) for name, (m, c) in marks.items()]
    items += [Patch(color=skill_colour(name), label=name) for name in SKILL_COLOURS if name in regions]
    figure.legend(handles=items, loc="outside lower center", ncols=len(items), fontsize=10.5, columnspacing=1.0)


# ---------------------------------------------------------------------------- skills, the paper's Fig. 1


def skills_figure(episodes: dict[str, Episode], length: float = 2.3):
    """Draw the five skills at work, the paper's Fig. 1; return the figure.

    Parameters
    ----------
    episodes : skill -> an episode of its specialist, in the order to draw
    length : stretch of course in each panel [m]
    """
    with style():
        figure = empty_figure((14.0, 2.45))
        axes = figure.subplots(1, len(episodes))
        figure.subplots_adjust(left=0.005, right=0.995, bottom=0.02, top=0.86, wspace=0.03)
        for axis, (skill, episode) in zip(axes, episodes.items(), strict=True):
            x, z = episode.qpos[:, 0], episode.qpos[:, 2]
            middle = episode.course.obstacles[0].x0 + 0.1 if episode.course.obstacles else 4.0
            middle = min(middle, max(float(x.max()) - 0.4, 1.6))
            ground = ground_along(episode.course, x, episode.qpos[:, 1])
            here = np.abs(X - middle) < length / 2
            base = (ground[here].max() + max(ground[here].min(), ground[here].max() - 0.6)) / 2
            axis.set(xlim=(middle - length / 2, middle + length / 2), xticks=[], yticks=[])
            axis.set(ylim=(base - 0.60, base + 0.95), aspect="equal")
            axis.grid(visible=False)
            axis.spines[:].set_visible(False)
            draw_ground(axis, ground, height_map(episode.course), base - 0.60)
            robot = Robot(episode.course)
            for k, place in enumerate(middle + np.array([-0.85, -0.05, 0.75])):
                t = int(np.argmin(np.abs(x - place)))
                if abs(x[t] - place) < 0.3:
                    robot.draw(axis, episode.qpos[t], 5 + k)
            axis.plot(x, z, color="black", linewidth=0.8, alpha=0.4, zorder=4)
            if skill == "beam":
                axis.text(middle, base - 0.5, "dark: side of the beam", ha="center", fontsize=10, zorder=6)
            axis.set_title(skill, fontsize=15, color="black")
            axis.axhline(base + 0.93, color=skill_colour(skill), linewidth=8)
        return figure


# ---------------------------------------------------------------------------- courses

SHOWN = (1.7, 5.7)  # [m] stretch of every course that is drawn
VIEW = {  # kind: lowest and highest coordinate shown [m]; y for beam, which is seen from above
    "walk": (-0.25, 0.55), "climb-up": (-0.2, 1.75), "climb-down": (-1.75, 0.55), "climb": (-0.2, 1.75),
    "gap": (-1.15, 0.55), "beam": (-0.75, 0.75), "climb-gap": (-1.15, 1.15),
}  # fmt: skip
DIFFICULTIES = (0.0, 0.3, 0.6, 1.0)


def course_gallery(kinds: tuple[str, ...] = COURSE_KINDS, seed: int = 3):
    """Draw every kind at d = 0, 0.3, 0.6, 1, to scale, dimensions in metres; return the figure."""
    width, pad, head = 14.0, 0.50, 0.70  # [inch]
    scale = (width - 1.1) / len(DIFFICULTIES) / (SHOWN[1] - SHOWN[0] + 0.25)  # [inch/m]
    heights, panel = [np.ptp(VIEW[kind]) * scale for kind in kinds], np.ptp(SHOWN) * scale
    with style():
        figure = empty_figure((width, sum(heights) + pad * len(kinds) + head))
        total, upper = figure.get_figheight(), figure.get_figheight() - head
        for kind, height in zip(kinds, heights, strict=True):
            for column, d in enumerate(DIFFICULTIES):
                left = 0.9 + column * (panel + 0.25 * scale)
                axis = figure.add_axes((left / width, (upper - height) / total, panel / width, height / total))
                axis.set(xlim=SHOWN, ylim=VIEW[kind])
                axis.grid(visible=False)
                axis.tick_params(labelleft=column == 0, labelsize=10)
                if column == 0:
                    axis.set_ylabel(f"{kind}\n{'y' if kind == 'beam' else 'z'} [m]", fontweight="bold")
                draw = _draw_beams if kind == "beam" else _draw_profile
                draw(axis, terrain.make_course(kind, d, seed))
                if kind == kinds[0]:
                    figure.text((left + panel / 2) / width, 1 - 0.55 / total, f"d = {d:g}", ha="center", fontsize=15)
            upper -= height + pad
        note = "x [m]; side views to scale; beams from above, dark: the lower ground beside them"
        figure.text(0.5, 0.08 / total, note, ha="center")
        return figure


def _dimension(axis, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Draw a double arrow."""
    arrow = {"arrowstyle": "<->", "color": BLUE, "lw": 1.3, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 8}
    axis.annotate("", start, end, arrowprops=arrow)


def _draw_profile(axis, course: Course) -> None:
    """Side view along the middle of the lane, with one robot for scale."""
    d, kind, robot = course.difficulty, course.kind, Robot(course)
    ground = ground_along(course, X, np.zeros_like(X))
    draw_ground(axis, ground, height_map(course), VIEW[kind][0])
    home = robot.model.key_qpos[0].copy()
    home[0], home[2] = 2.05, STAND_HEIGHT
    robot.draw(axis, home)
    text = {"color": BLUE, "fontsize": 11, "va": "center"}
    if kind == "walk":
        tiles = f"tiles {terrain.TILE_LENGTH:g} m long,\n{terrain.roughness(d):.3f} m high to low"
        axis.text(4.1, 0.28, tiles, ha="center", **text)
    for obstacle in course.obstacles[: 2 if kind == "climb-gap" else 1]:
        x0, x1 = obstacle.x0, obstacle.x1
        before = ground[np.searchsorted(X, x0) - 3]
        if obstacle.skill == "leap":
            floor = ground[np.searchsorted(X, (x0 + x1) / 2)]
            _dimension(axis, (x0, before + 0.08), (x1, before + 0.08))
            axis.text(x0, before + 0.26, f"{terrain.gap_width(d):.2f} m wide", **text)
            _dimension(axis, (x1 + 0.08, before), (x1 + 0.08, floor))
            low = min((before + floor) / 2, before - 0.27)
            axis.text(
                x1 + 0.13, low, f"{terrain.pit_depth(d):.2f} m\ndeep", **text | {"fontsize": 10}
            )  # pits may be near
        else:
            after = before + terrain.step_height(d) * (1 if obstacle.skill == "climb-up" else -1)
            _dimension(axis, (x0 + 0.1, before), (x0 + 0.1, after))
            # above the arrow and whatever ground is near: numbers on white are read at any size
            axis.text(x0 + 0.02, max(before, after) + 0.17, f"{terrain.step_height(d):.2f} m", **text)


def _draw_beams(axis, course: Course) -> None:
    """View from above: beams light, the ground beside them dark."""
    extent = (0, LANE_LENGTH, -LANE_WIDTH / 2, LANE_WIDTH / 2)
    shades = {"cmap": "gray", "vmin": -BEAM_DROP - 0.15, "vmax": 0.03}
    axis.imshow(height_map(course).T, origin="lower", extent=extent, aspect="auto", **shades)
    axis.set(xlim=SHOWN, ylim=VIEW["beam"])
    first, half = course.obstacles[0], terrain.beam_width(course.difficulty) / 2
    x, y = (first.x0 + first.x1) / 2, course.waypoints[1, 1]
    _dimension(axis, (x + 0.25, y - half), (x + 0.25, y + half))
    axis.text(x, y - half - 0.05, f"{2 * half:.2f} m", ha="center", va="top", color="white", fontsize=11)
    axis.text(x, 0.68, f"{-BEAM_DROP:.2f} m", ha="center", va="top", color="white", fontsize=10.5)
    axis.plot(*course.waypoints.T, "D", color="white", markeredgecolor="black", markersize=6)

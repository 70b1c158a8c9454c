"""Course gallery and the paper's Figures 1 and 2, redrawn.

In:  nothing (courses, framework), or one recorded episode per skill (skills).
Out: matplotlib figures.
"""

from agility_ref.go1 import STAND_HEIGHT
from agility_ref.pictures.pictures import X, draw_ground, ground_along
from agility_ref.pictures.plots import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, empty_figure, skill_colour, style
from agility_ref.pictures.record import Episode
from agility_ref.pictures.scene import Robot
from agility_ref.terrain import (
    BEAM_DROP,
    COURSE_KINDS,
    LANE_LENGTH,
    LANE_WIDTH,
    TILE_LENGTH,
    Course,
    beam_width,
    gap_width,
    make_course,
    pit_depth,
    roughness,
    step_height,
)
from agility_ref.world import height_map

import numpy as np

SHOWN = (1.7, 5.7)  # [m] stretch of every course in the gallery
VIEW = {  # kind: lowest and highest coordinate shown [m]; y for beam, which is seen from above; others see EVERYTHING
    "walk": (-0.25, 0.55), "climb-up": (-0.2, 1.75), "climb-down": (-1.75, 0.55), "climb": (-0.2, 1.75),
    "gap": (-1.15, 0.55), "beam": (-0.75, 0.75), "climb-gap": (-1.15, 1.15),
}  # fmt: skip
EVERYTHING = (-1.75, 1.75)
DIFFICULTIES = (0.0, 0.3, 0.6, 1.0)


# ---------------------------------------------------------------------------- courses


def course_gallery(kinds: tuple[str, ...] = COURSE_KINDS, seed: int = 3):
    """Draw every kind at d = 0, 0.3, 0.6, 1, to scale, dimensions in metres; return the figure."""
    width, pad, head = 14.0, 0.50, 0.70  # [inch]
    scale = (width - 1.1) / len(DIFFICULTIES) / (SHOWN[1] - SHOWN[0] + 0.25)  # [inch/m]
    views = [VIEW.get(kind, EVERYTHING) for kind in kinds]
    heights = [(high - low) * scale for low, high in views]
    with style():
        figure = empty_figure((width, sum(heights) + pad * len(kinds) + head))
        total, upper = figure.get_figheight(), figure.get_figheight() - head
        panel = (SHOWN[1] - SHOWN[0]) * scale
        for kind, view, height in zip(kinds, views, heights, strict=True):
            for column, d in enumerate(DIFFICULTIES):
                left = 0.9 + column * (panel + 0.25 * scale)
                axis = figure.add_axes((left / width, (upper - height) / total, panel / width, height / total))
                axis.set(xlim=SHOWN, ylim=view)
                axis.grid(visible=False)
                axis.tick_params(labelleft=column == 0, labelsize=10)
                if column == 0:
                    axis.set_ylabel(f"{kind}\n{'y' if kind == 'beam' else 'z'} [m]", fontweight="bold")
                course = make_course(kind, d, seed)
                if kind == "beam":
                    _draw_beams(axis, course)
                else:
                    _draw_profile(axis, course)
            upper -= height + pad
        for column, d in enumerate(DIFFICULTIES):
            centre = 0.9 + column * (panel + 0.25 * scale) + panel / 2
            figure.text(centre / width, 1 - 0.55 / total, f"d = {d:g}", ha="center", fontsize=15)
        figure.text(0.5, 0.08 / total, "x [m]; side views to scale, beam from above", ha="center")
        return figure


def _dimension(axis, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Draw a double arrow."""
    arrow = {"arrowstyle": "<->", "color": BLUE, "lw": 1.3, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 8}
    axis.annotate("", start, end, arrowprops=arrow)


def _draw_profile(axis, course: Course) -> None:
    """Side view along the middle of the lane, with one robot for scale."""
    d, kind = course.difficulty, course.kind
    ground = ground_along(course, X, np.zeros_like(X))
    draw_ground(axis, ground, height_map(course), VIEW.get(kind, EVERYTHING)[0])
    robot = Robot(course)
    home = robot.model.key_qpos[0].copy()
    home[0], home[2] = 2.05, STAND_HEIGHT
    robot.draw(axis, home)
    if kind == "walk":
        axis.text(
            4.1,
            0.28,
            f"tiles {TILE_LENGTH:g} m long,\n{roughness(d):.3f} m high to low",
            ha="center",
            va="center",
            color=BLUE,
            fontsize=11,
        )
        return
    text = {"color": BLUE, "fontsize": 11, "va": "center"}
    for obstacle in course.obstacles[: 2 if kind == "climb-gap" else 1]:
        x0, x1 = obstacle.x0, obstacle.x1
        before = ground[np.searchsorted(X, x0) - 3]
        if obstacle.skill == "leap":
            floor = ground[np.searchsorted(X, (x0 + x1) / 2)]
            _dimension(axis, (x0, before + 0.08), (x1, before + 0.08))
            axis.text(x0, before + 0.26, f"{gap_width(d):.2f} m wide", **text)
            _dimension(axis, (x1 + 0.08, before), (x1 + 0.08, floor))
            low = min((before + floor) / 2, before - 0.27)
            axis.text(x1 + 0.13, low, f"{pit_depth(d):.2f} m\ndeep", **text | {"fontsize": 10})  # pits may be near
        else:
            after = before + step_height(d) * (1 if obstacle.skill == "climb-up" else -1)
            _dimension(axis, (x0 + 0.1, before), (x0 + 0.1, after))
            # above the arrow and whatever ground is near: numbers on white are read at any size
            axis.text(x0 + 0.02, max(before, after) + 0.17, f"{step_height(d):.2f} m", **text)


def _draw_beams(axis, course: Course) -> None:
    """View from above: beams light, the ground beside them dark."""
    heights = height_map(course)
    extent = (0, LANE_LENGTH, -LANE_WIDTH / 2, LANE_WIDTH / 2)
    axis.imshow(heights.T, origin="lower", extent=extent, cmap="gray", vmin=-BEAM_DROP - 0.15, vmax=0.03, aspect="auto")
    axis.set(xlim=SHOWN, ylim=VIEW["beam"])
    first = course.obstacles[0]
    x, y, half = (first.x0 + first.x1) / 2, course.waypoints[1, 1], beam_width(course.difficulty) / 2
    _dimension(axis, (x + 0.25, y - half), (x + 0.25, y + half))
    axis.text(x, y - half - 0.05, f"{2 * half:.2f} m", ha="center", va="top", color="white", fontsize=11)
    axis.text(x, 0.68, f"{-BEAM_DROP:.2f} m", ha="center", va="top", color="white", fontsize=10.5)
    axis.plot(*course.waypoints.T, "D", color="white", markeredgecolor="black", markersize=6)


# ---------------------------------------------------------------------------- Figure 1


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
            axis.set(xlim=(middle - length / 2, middle + length / 2), xticks=[], yticks=[])
            base = (ground[here].max() + max(ground[here].min(), ground[here].max() - 0.6)) / 2
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
            axis.set_title(skill, fontsize=15, color="black")
            axis.axhline(base + 0.93, color=skill_colour(skill), linewidth=8)
        return figure


# ---------------------------------------------------------------------------- Figure 2


def framework_figure():
    """Draw the selector framework, the paper's Fig. 2; return the figure."""
    with style():
        figure = empty_figure((12.0, 5.0))
        axis = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axis.set(xlim=(0, 12), ylim=(0, 5))
        axis.axis("off")
        inputs = [
            (3.9, "scandots\n132 heights around the robot", SKY),
            (2.85, "proprioception\n45 numbers and 4 foot contacts", SKY),
            (1.8, "heading, commanded speed\n3 numbers", SKY),
        ]
        for y, text, colour in inputs:
            _block(axis, 0.1, y, 2.9, 0.85, text, colour)
            _arrow(axis, (3.0, y + 0.42), (3.75, 3.27 + 0.25 * (y - 2.85)))
        _block(
            axis,
            3.75,
            2.45,
            2.15,
            1.65,
            "selector\n\noracle: region map\nor MLP of 3 layers:\nPPO or supervised",
            ORANGE,
        )
        skills = ("walk", "climb-up", "climb-down", "leap", "beam")
        for k, skill in enumerate(skills):
            y = 4.18 - 0.68 * k
            _block(axis, 7.2, y, 1.75, 0.52, skill, skill_colour(skill))
            _arrow(axis, (5.9, 3.27), (7.2, y + 0.26), faint=k != 3)
            _arrow(axis, (8.95, y + 0.26), (9.75, 3.0), faint=k != 3)
        axis.text(6.55, 4.62, "index of\none skill", ha="center", va="center", fontsize=11)
        axis.text(8.07, 4.85, "frozen specialists", ha="center", va="center", fontsize=11)
        _block(axis, 9.75, 2.5, 2.05, 1.0, "12 joint targets\nat 50 Hz", GREY)
        _block(axis, 9.75, 0.3, 2.05, 1.0, "Go1 on the course\n(MuJoCo)", GREEN)
        _arrow(axis, (10.77, 2.5), (10.77, 1.3))
        axis.plot([9.75, 1.55], [0.55, 0.55], color="black", linewidth=1.6)
        _arrow(axis, (1.55, 0.55), (1.55, 1.8))
        axis.text(5.0, 0.68, "observation", ha="left", fontsize=11)
        axis.plot([9.75, 4.8], [1.05, 1.05], color=PURPLE, linewidth=1.6)
        _arrow(axis, (4.8, 1.05), (4.8, 2.45), colour=PURPLE)
        axis.text(5.0, 1.18, "reward, to train the PPO selector", fontsize=11)
        return figure


def _block(axis, x: float, y: float, width: float, height: float, text: str, colour: str) -> None:
    from matplotlib.patches import FancyBboxPatch

    style_ = "round,pad=0,rounding_size=0.1"
    axis.add_patch(FancyBboxPatch((x, y), width, height, boxstyle=style_, fc=colour, ec="black", alpha=0.35, lw=0))
    axis.add_patch(FancyBboxPatch((x, y), width, height, boxstyle=style_, fc="none", ec=colour, lw=2))
    axis.text(x + width / 2, y + height / 2, text, ha="center", va="center", fontsize=11.5)


def _arrow(
    axis, start: tuple[float, float], end: tuple[float, float], faint: bool = False, colour: str = "black"
) -> None:
    look = {"arrowstyle": "->", "lw": 1.6, "shrinkA": 0, "color": colour, "alpha": 0.25 if faint else 1.0}
    axis.annotate("", end, start, arrowprops=look)

"""Terrain: courses as lists of boxes, and everything that follows from them.

A course **is** a list of static, axis-aligned boxes (paper section 3.1.1, Figures 1
and 3).  The physics, the height map under the scandots, the edge map behind "edge
violation", the waypoints and the oracle's skill regions (section 3.2.1) are all read
off that one list, so they cannot disagree.

In:  a course kind, a difficulty d in [0, 1] and a ``numpy.random.Generator``.
Out: a :class:`Course`; :mod:`agility_ref.world` turns courses into maps.

The dimensions are those of the Extreme Parkour code base that the paper stands on
(github.com/chengxuxin/extreme-parkour, ``legged_gym/utils/terrain.py``).  What differs:

* only ``walk`` is rough; the original adds roughness to every course;
* steps and gaps span the whole lane, so nothing can be walked around;
* pits deepen with the difficulty, which gives a beginner a shallow first gap;
* waypoints of ``gap`` stand behind each gap, not before it; ``walk`` is half as rough, on tiles of
  0.5 m; treads and the distances between waypoints differ by some centimetres;
* ``climb-up``, ``climb-down``, ``beam`` and ``climb-gap`` are described, not dimensioned, in the
  paper: these are ours.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

SKILLS = ("walk", "climb-up", "climb-down", "leap", "beam")  # order of the oracle's labels
COURSE_KINDS = ("walk", "climb-up", "climb-down", "climb", "gap", "beam", "climb-gap")

CELL = 0.02  # [m] grid of the height map; every box edge lies on it, so the map is exact
LANE_LENGTH = 18.0  # [m] along x
LANE_WIDTH = 4.0  # [m] along y, centred on y = 0
START_LENGTH = 2.5  # [m] level platform at height 0 on which every course begins
SPAWN_X = 1.0  # [m]
NUM_WAYPOINTS = 8
NUM_OBSTACLES = 6
BEAM_DROP = 0.2  # [m] from a beam down to the ground beside it
TILE_LENGTH = 0.5  # [m] of the rough ground's tiles along x; each row is split where the robot walks
GRID_SHAPE = (round(LANE_LENGTH / CELL), round(LANE_WIDTH / CELL))  # (nx, ny)


# Lowest difficulty of a kind.  Training starts there, evaluation at 0: a beginner trips over a step
# of 0.10 m and falls off a beam of 0.60 m, so theirs start at 0.03 m and 1.08 m.
EASIEST = {kind: 0.0 for kind in COURSE_KINDS} | {"climb-up": -0.2, "climb-down": -0.2, "climb": -0.2, "beam": -1.0}


@dataclass(frozen=True)
class Box:
    """One static block of terrain, ``x0 <= x <= x1``, ``y0 <= y <= y1``, all in [m]."""

    x0: float
    x1: float
    y0: float
    y1: float
    top: float  # height of the walking surface [m]
    walkable: bool = True  # false for the floor of a pit: standing on it is having fallen off


@dataclass(frozen=True)
class Obstacle:
    """The stretch ``x0 <= x <= x1`` [m] that needs ``skill`` (paper section 3.2.1)."""

    x0: float
    x1: float
    skill: str


@dataclass(frozen=True)
class Course:
    """One lane: its boxes, where to go, and which skill the oracle uses where."""

    kind: str
    difficulty: float
    boxes: tuple[Box, ...]
    obstacles: tuple[Obstacle, ...]
    waypoints: np.ndarray  # (8, 2) xy of the waypoints [m]


def snap(length: float) -> float:
    """Round a length [m] to the grid of the height map."""
    return round(length / CELL) * CELL


def _slab(x0: float, x1: float, top: float, walkable: bool = True) -> Box:
    """Return a box as wide as the lane."""
    return Box(x0, x1, -LANE_WIDTH / 2, LANE_WIDTH / 2, top, walkable)


def step_height(d: float) -> float:
    """Height of one step [m]: 0.10 at d = 0, 0.45 at d = 1."""
    return 0.10 + 0.35 * d


def gap_width(d: float) -> float:
    """Width of one gap [m]: 0.10 at d = 0, 0.80 at d = 1."""
    return snap(0.10 + 0.70 * d)


def beam_width(d: float) -> float:
    """Width of a beam [m]: 0.60 at d = 0, 0.12 at d = 1; wider below d = 0."""
    return 2 * snap((0.60 - 0.48 * d) / 2)


def pit_depth(d: float) -> float:
    """Depth of a pit [m]: 0.05 at d = 0, 1 at d = 1.  Ours: see the module."""
    return 0.05 + 0.95 * d


def roughness(d: float) -> float:
    """Height range of rough ground [m], lowest to highest tile: 0.02 at d = 0, 0.06 at d = 1."""
    return 0.02 + 0.04 * d


def _lateral(rng: np.random.Generator, amplitude: float) -> float:
    """Draw a lateral offset [m], uniform in +-amplitude."""
    return snap(rng.uniform(-amplitude, amplitude))


def _walk(d: float, rng: np.random.Generator) -> Course:
    """Rough ground: rows of two tiles of random height, zig-zag waypoints (the original's 'flat')."""
    boxes = [_slab(0.0, START_LENGTH, 0.0)]
    for x in np.arange(START_LENGTH, LANE_LENGTH - 1e-9, TILE_LENGTH).tolist():
        seam = _lateral(rng, 0.4)
        left, right = (float(z) for z in rng.uniform(-0.5, 0.5, 2) * roughness(d))
        boxes += [
            Box(x, x + TILE_LENGTH, -LANE_WIDTH / 2, seam, right),
            Box(x, x + TILE_LENGTH, seam, LANE_WIDTH / 2, left),
        ]
    spacing = rng.uniform(1.3, 1.9, NUM_WAYPOINTS - 1)
    x = 2.0 + np.concatenate([[0.0], np.cumsum(spacing)])
    y = [0.0] + [_lateral(rng, 0.4) for _ in range(NUM_OBSTACLES)] + [0.0]
    return Course("walk", d, tuple(boxes), (), np.column_stack([x, y]))


def _terraces(kind: str, levels: tuple[int, ...], d: float, rng: np.random.Generator) -> Course:
    """Full-width treads at ``levels`` x the step height, after a start platform at 0."""
    h = step_height(d)
    boxes, obstacles = [_slab(0.0, START_LENGTH, 0.0)], []
    waypoints = [(1.5, 0.0)]
    x, previous = START_LENGTH, 0
    for i, level in enumerate(levels):
        last = i == len(levels) - 1
        # The tread must hold the robot's 0.6 m, hence 0.5 where the original draws from 0.3.
        length = snap(rng.uniform(0.5, 1.5) + h)
        end = LANE_LENGTH if last else x + length
        boxes.append(_slab(x, end, level * h))
        if level > previous:
            obstacles.append(Obstacle(x, x, "climb-up"))
        elif level < previous:
            obstacles.append(Obstacle(x, x, "climb-down"))
        waypoints.append((x + (1.2 if last else length / 2), 0.0 if last else _lateral(rng, 0.4)))
        x, previous = end, level
    return Course(kind, d, tuple(boxes), tuple(obstacles), np.array(waypoints))


def islands(kind: str, moves: str, d: float, rng: np.random.Generator) -> Course:
    """Platforms separated, in the order of ``moves``, by gaps (g) and steps up (u) or down (d).

    Courses of the table have six moves; others are for experiments.
    """
    h, g = step_height(d), gap_width(d)
    boxes, obstacles, waypoints = [_slab(0.0, START_LENGTH, 0.0)], [], [(2.0, 0.0)]
    x, top = START_LENGTH, 0.0
    for i, move in enumerate(moves):
        if move == "g":
            boxes.append(_slab(x, x + g, min(top, 0.0) - pit_depth(d), walkable=False))
            obstacles.append(Obstacle(x, x + g, "leap"))
            x += g
        else:
            top += h if move == "u" else -h
            obstacles.append(Obstacle(x, x, "climb-up" if move == "u" else "climb-down"))
        last = i == len(moves) - 1
        length = snap(rng.uniform(0.8, 1.5))
        end = LANE_LENGTH if last else x + length
        boxes.append(_slab(x, end, top))
        waypoints.append((x + (0.6 if last else length / 2), 0.0 if last else _lateral(rng, 0.3)))
        x = end
    waypoints.append((waypoints[-1][0] + 0.8, 0.0))
    return Course(kind, d, tuple(boxes), tuple(obstacles), np.array(waypoints))


def _beam(d: float, rng: np.random.Generator) -> Course:
    """Six beams along the lane between full-width islands, the ground BEAM_DROP below on both sides."""
    half = beam_width(d) / 2
    boxes, obstacles, waypoints = [_slab(0.0, START_LENGTH, 0.0)], [], [(2.0, 0.0)]
    x = START_LENGTH
    for i in range(NUM_OBSTACLES):
        length = snap(rng.uniform(0.9, 1.3))
        y = _lateral(rng, 0.15)
        boxes.append(Box(x, x + length, y - half, y + half, 0.0))
        boxes.append(Box(x, x + length, -LANE_WIDTH / 2, y - half, -BEAM_DROP, walkable=False))
        boxes.append(Box(x, x + length, y + half, LANE_WIDTH / 2, -BEAM_DROP, walkable=False))
        obstacles.append(Obstacle(x, x + length, "beam"))
        waypoints.append((x + length / 2, y))
        x += length
        end = LANE_LENGTH if i == NUM_OBSTACLES - 1 else x + snap(rng.uniform(0.7, 1.0))
        boxes.append(_slab(x, end, 0.0))
        x = end
    waypoints.append((boxes[-1].x0 + 0.6, 0.0))
    return Course("beam", d, tuple(boxes), tuple(obstacles), np.array(waypoints))


GENERATORS = {
    "walk": _walk,
    "climb-up": partial(_terraces, "climb-up", (1, 2, 3, 4, 5, 6, 6)),
    "climb-down": partial(_terraces, "climb-down", (-1, -2, -3, -4, -5, -6, -6)),
    "climb": partial(_terraces, "climb", (1, 2, 3, 3, 2, 1, 0)),  # the original's 'step'
    "gap": partial(islands, "gap", "gggggg"),
    "beam": _beam,
    "climb-gap": partial(islands, "climb-gap", "ugudgd"),  # blocks climbed up and down, gaps between them
}


def make_course(kind: str, difficulty: float, seed: int | np.random.Generator = 0) -> Course:
    """Generate one course.

    Parameters
    ----------
    kind : one of COURSE_KINDS
    difficulty : d; the paper's range is 0 to 1, training may start at EASIEST
    seed : integer seed or Generator; the same seed gives the same course

    Raises
    ------
    ValueError : unknown kind, or a difficulty outside [EASIEST[kind], 1]
    """
    if kind not in GENERATORS:
        raise ValueError(f"unknown course kind {kind!r}; choose from {', '.join(COURSE_KINDS)}")
    if not EASIEST[kind] <= difficulty <= 1.0:
        raise ValueError(f"difficulty {difficulty} of {kind} is outside [{EASIEST[kind]:g}, 1]")
    return GENERATORS[kind](float(difficulty), np.random.default_rng(seed))

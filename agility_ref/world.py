"""World: courses as arrays.

Everything that the robots sense or are judged by is computed here from the boxes of the
courses: heights under the scandots, edges behind "edge violation" (paper Table 1), the
oracle's skill regions (section 3.2.1, Figure 3), and where a robot counts as fallen.

In:  a list of :class:`~agility_ref.terrain.Course`.
Out: a :class:`World` of stacked maps, one row per course.
"""

from agility_ref.terrain import CELL, GRID_SHAPE, LANE_WIDTH, SKILLS, Course

import numpy as np

EDGE_MIN_DROP = 0.075  # [m] a box top that drops more than this has an edge there
EDGE_DISTANCE = 0.05  # [m] a foot in contact within this distance of an edge violates it

SCAN_PATCH = 7  # cells, 0.14 m: what one scandot covers, next to nothing between it and its neighbours

# Where the oracle takes a skill up before an obstacle and how long it keeps it after: chosen on training
# courses (benchmarks/oracle_regions.py), within what the scandots see, 1.2 m ahead and 0.45 m behind.
LEAD = {"walk": 0.0, "climb-up": 0.8, "climb-down": 0.8, "leap": 1.0, "beam": 0.4}  # [m]
TAIL = {"walk": 0.0, "climb-up": 0.45, "climb-down": 0.45, "leap": 0.35, "beam": 0.3}  # [m]


def height_map(course: Course) -> np.ndarray:
    """Surface height at every cell centre, shape GRID_SHAPE [m]."""
    heights = np.full(GRID_SHAPE, -np.inf, np.float32)
    for box in course.boxes:
        i0, i1 = round(box.x0 / CELL), round(box.x1 / CELL)
        j0, j1 = round((box.y0 + LANE_WIDTH / 2) / CELL), round((box.y1 + LANE_WIDTH / 2) / CELL)
        cells = heights[i0:i1, j0:j1]
        np.maximum(cells, box.top, out=cells)
    assert np.isfinite(heights).all(), f"{course.kind}: boxes leave a hole in the lane"
    return heights


def edge_map(heights: np.ndarray, axes: str = "xy") -> np.ndarray:
    """Height of the lowest edge where one is within EDGE_DISTANCE, +inf elsewhere.

    An edge is a border between two cells whose heights differ by more than
    EDGE_MIN_DROP; it stands at the height of the upper one.

    Parameters
    ----------
    heights : (nx, ny) [m]
    axes : "xy", or "x" for the original, which looks along x only
    """
    edges = np.full(heights.shape, np.inf, np.float32)
    reach = int(np.floor(EDGE_DISTANCE / CELL + 0.5))  # cell centres within the distance
    for axis in range(len(axes)):
        h = np.moveaxis(heights, axis, 0)
        marked = np.moveaxis(edges, axis, 0)  # a view: writes land in `edges`
        border, other = np.nonzero(np.abs(np.diff(h, axis=0)) > EDGE_MIN_DROP)
        top = np.maximum(h[border, other], h[border + 1, other])
        for offset in range(1 - reach, reach + 1):
            cell = np.clip(border + offset, 0, h.shape[0] - 1)
            np.minimum.at(marked, (cell, other), top)
    return edges


def scan_map(heights: np.ndarray) -> np.ndarray:
    """Mean height of the SCAN_PATCH x SCAN_PATCH cells around every cell, (nx, ny) -> (nx, ny) [m].

    Scandots stand 0.15 m apart.  Sampled at points, they say on which side of a dot an edge
    lies but not where, and a beam of 0.12 m can stand between two of them unseen.
    """
    reach = SCAN_PATCH // 2
    for axis in (0, 1):
        padding = [(reach, reach) if k == axis else (0, 0) for k in (0, 1)]
        windows = np.lib.stride_tricks.sliding_window_view(np.pad(heights, padding, mode="edge"), SCAN_PATCH, axis)
        heights = windows.mean(axis=-1, dtype=np.float32)
    return heights


def region_map(course: Course) -> np.ndarray:
    """Skill the oracle uses at every x, shape (nx,), indices into SKILLS.

    Each obstacle claims the stretch from LEAD before it to TAIL after it; an obstacle
    keeps its tail before the next one's lead begins.  Everything else is walked.
    """
    regions = np.full(GRID_SHAPE[0], SKILLS.index("walk"), np.int8)
    tail_end = 0.0
    for obstacle in course.obstacles:
        start = max(obstacle.x0 - LEAD[obstacle.skill], tail_end)
        tail_end = obstacle.x1 + TAIL[obstacle.skill]
        regions[round(start / CELL) : round(tail_end / CELL)] = SKILLS.index(obstacle.skill)
    return regions


def support_map(course: Course, body_reach: float = 0.45) -> np.ndarray:
    """Lowest surface that may carry a robot at x, shape (nx,) [m].

    Pits are bridged by the lower of their two banks, then the minimum over +-body_reach
    is taken: a robot whose front feet are up a step still has its rear feet below.
    """
    nx = GRID_SHAPE[0]
    surface = np.full(nx, np.nan)
    for box in course.boxes:
        if box.walkable:
            cells = slice(round(box.x0 / CELL), round(box.x1 / CELL))
            surface[cells] = np.fmin(surface[cells], box.top)
    known = np.flatnonzero(~np.isnan(surface))
    x = np.arange(nx)
    left = known[np.clip(np.searchsorted(known, x, "right") - 1, 0, len(known) - 1)]
    right = known[np.clip(np.searchsorted(known, x, "left"), 0, len(known) - 1)]
    bridged = np.minimum(surface[left], surface[right])
    reach = round(body_reach / CELL)
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(bridged, reach, mode="edge"), 2 * reach + 1)
    return windows.min(axis=1).astype(np.float32)


def beam_map(course: Course) -> np.ndarray:
    """Whether x lies over a beam's span, shape (nx,) bool."""
    over = np.zeros(GRID_SHAPE[0], bool)
    for obstacle in course.obstacles:
        if obstacle.skill == "beam":
            over[round(obstacle.x0 / CELL) : round(obstacle.x1 / CELL)] = True
    return over


class World:
    """Many courses as arrays, each standing at the origin.

    Attributes
    ----------
    courses : list of Course, length C
    kinds, difficulties : (C,) of every course
    heights : (C, nx, ny) float32 [m]
    scan : (C, nx, ny) float32 [m], what scandots see; see :func:`scan_map`
    edges : (C, nx, ny) float32 [m], height of a near edge or +inf
    waypoints : (C, 8, 2) [m]
    regions : (C, nx) int8, the oracle's skill
    support : (C, nx) float32 [m], see :func:`support_map`
    over_beam : (C, nx) bool
    """

    def __init__(self, courses: list[Course], edges: str = "xy"):
        self.courses = list(courses)
        self.kinds, self.difficulties = (
            np.array([getattr(c, name) for c in courses]) for name in ("kind", "difficulty")
        )
        self.heights = np.stack([height_map(c) for c in courses])
        self.scan = np.stack([scan_map(h) for h in self.heights])
        self.edges = np.stack([edge_map(h, edges) for h in self.heights])
        self.waypoints = np.stack([c.waypoints for c in courses])
        self.regions = np.stack([region_map(c) for c in courses])
        self.support = np.stack([support_map(c) for c in courses])
        self.over_beam = np.stack([beam_map(c) for c in courses])

    def __len__(self) -> int:
        return len(self.courses)

    def column(self, x: np.ndarray) -> np.ndarray:
        """Return grid index along x of points [m]; outside the lane, that of its border."""
        return np.minimum(np.maximum((x * (1 / CELL)).astype(np.int32), 0), GRID_SHAPE[0] - 1)

    def cells(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return grid indices of points [m]; outside the lane, those of its border."""
        j = ((y + LANE_WIDTH / 2) * (1 / CELL)).astype(np.int32)
        return self.column(x), np.minimum(np.maximum(j, 0), GRID_SHAPE[1] - 1)

    def ground(self, course: np.ndarray | int, points: np.ndarray) -> np.ndarray:
        """Height of the ground under points (..., 2 or 3) of the given courses, (...) [m]."""
        return self.heights[course, *self.cells(points[..., 0], points[..., 1])]

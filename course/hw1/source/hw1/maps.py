"""From a list of boxes to what a robot senses and is judged by.

A lane is a grid of square cells.  x runs along the lane from 0, y to its left **from 0 at the right border**.
Maps are images: **the first axis is y**, the second x, so ``map[j, i]`` belongs to the cell with its centre at
x = (i + 0.5) cell, y = (j + 0.5) cell.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Lane:
    """The grid of a lane."""

    length: float
    """Along x [m], a whole number of cells."""
    width: float
    """Along y [m], a whole number of cells."""
    cell: float
    """Side of a cell [m]."""

    @property
    def shape(self) -> tuple[int, int]:
        """(ny, nx)."""
        return round(self.width / self.cell), round(self.length / self.cell)


def height_map(boxes: np.ndarray, lane: Lane) -> np.ndarray:
    """Height of the ground in every cell [m].

    A cell belongs to a box if its centre lies in it.  Where boxes overlap the highest counts, in whatever order
    they come; where there is none the ground is a hole, NaN.

    Parameters
    ----------
    boxes : (B, 5) rows x0, y0, x1, y1, top [m]; a box may reach beyond the lane

    Returns
    -------
    (ny, nx)
    """
    ### BEGIN SOLUTION
    ny, nx = lane.shape
    x = (np.arange(nx) + 0.5) * lane.cell
    y = (np.arange(ny) + 0.5) * lane.cell
    heights = np.full((ny, nx), np.nan)
    for x0, y0, x1, y1, top in boxes:
        rows, columns = (y0 <= y) & (y <= y1), (x0 <= x) & (x <= x1)
        cells = np.ix_(rows, columns)
        heights[cells] = np.fmax(heights[cells], top)
    return heights
    ### END SOLUTION


def edge_map(heights: np.ndarray, lane: Lane, drop: float, reach: float) -> np.ndarray:
    """Whether a cell is near an edge.

    An edge is the border of two cells, neighbours along x or along y, whose heights differ by more than
    ``drop``.  A hole is deeper than any drop; between two holes there is no edge.  A cell is near an edge if it
    lies in the same row (for neighbours along x; the same column for neighbours along y) and its centre is no
    farther from the border than ``reach``, on the upper side or on the lower.

    Parameters
    ----------
    heights : (ny, nx) [m]
    drop, reach : [m]

    Returns
    -------
    (ny, nx) bool
    """
    ### BEGIN SOLUTION
    ground = np.where(np.isnan(heights), -1e9, heights)
    near = np.zeros(heights.shape, bool)
    # centres are 0.5, 1.5, ... cells from a border: so many on either side are within reach
    cells = int(np.floor(reach / lane.cell + 0.5 + 1e-9))
    for axis in (0, 1):
        h, marked = np.moveaxis(ground, axis, 0), np.moveaxis(near, axis, 0)  # views
        border = np.abs(np.diff(h, axis=0)) > drop
        for k in range(cells):
            marked[: len(border) - k] |= border[k:]  # k cells before the border
            marked[1 + k :] |= border[: len(border) - k]  # k cells after it
    return near
    ### END SOLUTION


def region_map(obstacles: np.ndarray, lane: Lane, lead: float, tail: float) -> np.ndarray:
    """Skill that the oracle uses at every x.

    An obstacle claims the stretch from ``lead`` before it to ``tail`` after it; a cell belongs to it if its
    centre lies there.  No claim goes beyond the middle between an obstacle and its neighbour.  The rest is
    skill 0, walking.

    Parameters
    ----------
    obstacles : (K, 3) rows x0, x1 [m] and skill (1, 2, ...), in no particular order; they do not overlap
    lead, tail : [m]

    Returns
    -------
    (nx,) int
    """
    ### BEGIN SOLUTION
    x = (np.arange(lane.shape[1]) + 0.5) * lane.cell
    skills = np.zeros(len(x), int)
    obstacles = np.asarray(obstacles, float).reshape(-1, 3)
    ordered = obstacles[np.argsort(obstacles[:, 0])]
    middle = (ordered[:-1, 1] + ordered[1:, 0]) / 2
    earliest, latest = np.concatenate([[-np.inf], middle]), np.concatenate([middle, [np.inf]])
    for (x0, x1, skill), first, last in zip(ordered, earliest, latest, strict=False):
        skills[(max(x0 - lead, first) <= x) & (x <= min(x1 + tail, last))] = int(skill)
    return skills
    ### END SOLUTION


def scandots(
    heights: np.ndarray, lane: Lane, poses: np.ndarray, ahead: np.ndarray, left: np.ndarray, hole: float
) -> np.ndarray:
    """How high the ground around each robot is, **seen from its trunk**: negative where it lies lower.

    Dots stand at every pair of ``left`` and ``ahead``, turned with the robot's yaw (counterclockwise from x).
    A dot takes the height of the cell that it falls into; beside the lane, that of the nearest cell of the lane.

    Parameters
    ----------
    heights : (ny, nx) [m]
    poses : (N, 4) rows x, y, z of the trunk [m], yaw [rad]
    ahead : (A,) dots ahead of the trunk [m]
    left : (L,) dots to its left [m]
    hole : what a dot over a hole reads [m]

    Returns
    -------
    (N, L, A) ground - trunk [m]
    """
    ### BEGIN SOLUTION
    dy, dx = np.meshgrid(left, ahead, indexing="ij")  # (L, A)
    x, y, z, yaw = (np.asarray(poses, float)[:, k, None, None] for k in range(4))
    # p = base + R(yaw) (dx, dy)
    px = x + np.cos(yaw) * dx - np.sin(yaw) * dy
    py = y + np.sin(yaw) * dx + np.cos(yaw) * dy
    ny, nx = heights.shape
    i = np.clip(np.floor(px / lane.cell).astype(int), 0, nx - 1)
    j = np.clip(np.floor(py / lane.cell).astype(int), 0, ny - 1)
    seen = heights[j, i] - z
    return np.where(np.isnan(seen), hole, seen)
    ### END SOLUTION

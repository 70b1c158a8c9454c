"""Observation: what the robots sense, its layout, noise and scandots.

Paper section 3.2.1: scandots, proprioception and heading.  The layout is that of Extreme
Parkour without history and estimator; :class:`~agility_ref.env.Go1Env` fills it in.

In:  poses and the height maps of a :class:`~agility_ref.world.World`.
Out: the table OBSERVATION, and the 132 scandots.
"""

import numpy as np

from agility_ref.terrain import CELL, GRID_SHAPE, LANE_WIDTH
from agility_ref.world import World

SCANDOT_X = np.arange(-0.45, 1.21, 0.15, dtype=np.float32)  # (12,) [m] ahead of the trunk
SCANDOT_Y = np.arange(-0.75, 0.76, 0.15, dtype=np.float32)  # (11,) [m] to its left
NUM_SCANDOTS = len(SCANDOT_X) * len(SCANDOT_Y)  # 132

OBSERVATION = {  # name: (size, noise amplitude)
    "base_lin_vel": (3, 0.1),
    "base_ang_vel": (3, 0.2),
    "projected_gravity": (3, 0.03),
    "heading_error": (2, 0.05),
    "command": (1, 0.0),
    "dof_pos": (12, 0.02),
    "dof_vel": (12, 0.5),
    "last_action": (12, 0.0),
    "foot_contact": (4, 0.0),
    "scandots": (NUM_SCANDOTS, 0.02),
}
OBS_DIM = sum(size for size, _ in OBSERVATION.values())  # 184


def observation_slices() -> dict[str, slice]:
    """Where each part of the observation stands."""
    ends = np.cumsum([size for size, _ in OBSERVATION.values()]).tolist()
    return {name: slice(e - OBSERVATION[name][0], e) for name, e in zip(OBSERVATION, ends, strict=True)}


SCANDOTS = observation_slices()["scandots"]
# One draw an entry, but one for all scandots together: an error of the height estimate.
NOISE = np.array([a for name, (n, a) in OBSERVATION.items() for _ in range(n if name != "scandots" else 1)], np.float32)


def wrap(angle: np.ndarray) -> np.ndarray:
    """Wrap angles [rad] to +-pi."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def rotation(quat: np.ndarray) -> np.ndarray:
    """Rotation matrices (N, 3, 3), body to world, of unit quaternions (N, 4), wxyz."""
    w, x, y, z = np.ascontiguousarray(quat.T)
    return np.stack(
        [
            1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
        ],
        axis=1,
    ).reshape(-1, 3, 3)  # fmt: skip


def scandots(world: World, course: np.ndarray, pos: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Heights of the ground around each robot, seen from its trunk.

    Parameters
    ----------
    course : (n,) index of each robot's course
    pos : (n, 3) position of the trunk [m]
    yaw : (n,) heading [rad]

    Returns
    -------
    (n, 132) clip(trunk z - 0.3 - ground height, +-1) [m], x-major
    """
    x, y, z = pos.astype(np.float32).T
    yaw = yaw.astype(np.float32)
    cos, sin = np.cos(yaw)[:, None] / CELL, np.sin(yaw)[:, None] / CELL
    nx, ny = GRID_SHAPE
    # p = base + R(yaw) (dx, dy) in cells; the grid is separable, so two outer sums do
    along_x = (x / CELL)[:, None] + cos * SCANDOT_X  # (n, 12)
    along_y = ((y + LANE_WIDTH / 2) / CELL)[:, None] + sin * SCANDOT_X
    i = (along_x[:, :, None] - (sin * SCANDOT_Y)[:, None, :]).astype(np.int32)  # (n, 12, 11)
    j = (along_y[:, :, None] + (cos * SCANDOT_Y)[:, None, :]).astype(np.int32)
    np.clip(i, 0, nx - 1, out=i)
    np.clip(j, 0, ny - 1, out=j)
    i *= ny
    i += j
    i += (course * (nx * ny)).astype(np.int32)[:, None, None]
    ground = world.heights.reshape(-1).take(i).reshape(-1, NUM_SCANDOTS)
    return np.clip((z - np.float32(0.3))[:, None] - ground, -1.0, 1.0)

"""Observation: what the robots sense, its layout, noise and scandots.

Paper section 3.2.1: scandots, proprioception and heading.  The ingredients are those of Extreme
Parkour without history, estimator and class flags, in their own units; :class:`~agility_ref.env.Go1Env` fills it in.

In:  poses and the height maps of a :class:`~agility_ref.world.World`.
Out: the table OBSERVATION, and the 132 scandots.
"""

from dataclasses import dataclass

from agility_ref.terrain import CELL, GRID_SHAPE, LANE_WIDTH
from agility_ref.world import World

import numpy as np

SCANDOT_X = np.arange(-0.45, 1.21, 0.15, dtype=np.float32)  # (12,) [m] ahead of the trunk
SCANDOT_Y = np.arange(-0.75, 0.76, 0.15, dtype=np.float32)  # (11,) [m] to its left
NUM_SCANDOTS = len(SCANDOT_X) * len(SCANDOT_Y)  # 132
SCANDOT_ZERO = 0.3  # [m] under the trunk: ground there reads 0
SCANDOT_STD = 0.3  # [m] by which networks divide scandots, whose own spread depends on the course
_GRID = np.stack(np.meshgrid(SCANDOT_X, SCANDOT_Y, indexing="ij")).reshape(2, -1) / np.float32(CELL)  # in cells
_LAST_CELL = np.array([[n - 1] for n in GRID_SHAPE], np.int32)

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
# Bounds of an observation, noise included, for spaces that have to be finite.  No working robot reaches those that are
# not of geometry: 20 m/s, 50 rad/s, 2 m/s of command, 100 rad/s of the joints, 4 units of action.
_LIMITS = (20.0, 50.0, 1.0, np.pi, 2.0, np.pi, 100.0, 4.0, 1.0, 1.0)
OBS_BOUND = np.concatenate(
    [np.full(n, limit + noise, np.float32) for (n, noise), limit in zip(OBSERVATION.values(), _LIMITS, strict=True)]
)


@dataclass(frozen=True)
class Mirror:
    """Left for right: entry i of the mirror image of x is ``sign[i] * x[index[i]]``, and twice is nothing."""

    index: np.ndarray  # (n,) int
    sign: np.ndarray  # (n,) +-1, float32

    @classmethod
    def identity(cls, n: int) -> "Mirror":
        """Nothing changes: the mirror of n numbers without handedness."""
        return cls(np.arange(n), np.ones(n, np.float32))

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Mirror vectors (..., n)."""
        return x[..., self.index] * self.sign

    def bases(self) -> tuple[np.ndarray, np.ndarray]:
        """Orthonormal rows that span what the mirror keeps, (n_even, n), and what it flips, (n_odd, n)."""
        eye = np.eye(len(self.index), dtype=np.float32)
        pair, alone = np.flatnonzero(self.index > np.arange(len(eye))), self.index == np.arange(len(eye))
        # A pair that swaps gives one row of each: (e_i +- s e_j) / sqrt 2.
        other = self.sign[pair, None] * eye[self.index[pair]]
        even = np.concatenate([eye[alone & (self.sign > 0)], (eye[pair] + other) * np.float32(0.5**0.5)])
        odd = np.concatenate([eye[alone & (self.sign < 0)], (eye[pair] - other) * np.float32(0.5**0.5)])
        return even, odd


def _mirror() -> Mirror:
    """How a robot's mirror image observes."""
    polar, axial = np.array([1, -1, 1]), np.array([-1, 1, -1])  # vectors, and rotations about axes
    swapped = np.array([1, 0, 3, 2])  # legs FR FL RR RL
    joints = (3 * swapped[:, None] + np.arange(3)).ravel()
    hips = np.tile([-1, 1, 1], 4)  # only the hips move sideways
    parts = {
        "base_lin_vel": (np.arange(3), polar),
        "base_ang_vel": (np.arange(3), axial),
        "projected_gravity": (np.arange(3), polar),
        "heading_error": (np.arange(2), -np.ones(2)),
        "command": (np.arange(1), np.ones(1)),
        "dof_pos": (joints, hips),
        "dof_vel": (joints, hips),
        "last_action": (joints, hips),
        "foot_contact": (swapped, np.ones(4)),
        "scandots": (np.arange(NUM_SCANDOTS).reshape(len(SCANDOT_X), -1)[:, ::-1].ravel(), np.ones(NUM_SCANDOTS)),
    }
    starts = {name: part.start for name, part in observation_slices().items()}
    index = np.concatenate([starts[name] + index for name, (index, _) in parts.items()])
    return Mirror(index, np.concatenate([sign for _, sign in parts.values()]).astype(np.float32))


OBS_MIRROR = _mirror()
_ACTION = observation_slices()["last_action"]
ACTION_MIRROR = Mirror(OBS_MIRROR.index[_ACTION] - _ACTION.start, OBS_MIRROR.sign[_ACTION])
SCANDOT_MIRROR = Mirror(OBS_MIRROR.index[SCANDOTS] - SCANDOTS.start, OBS_MIRROR.sign[SCANDOTS])


def wrap(angle: np.ndarray) -> np.ndarray:
    """Wrap angles [rad] to +-pi."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def rotation(quat: np.ndarray) -> np.ndarray:
    """Rotation matrices (N, 3, 3), body to world, of unit quaternions (N, 4), wxyz."""
    w, x, y, z = quat.T
    ww, xx, yy, zz, xy, xz, yz, wx, wy, wz = w * w, x * x, y * y, z * z, x * y, x * z, y * z, w * x, w * y, w * z
    rows = (
        ww + xx - yy - zz, 2 * (xy - wz), 2 * (xz + wy),
        2 * (xy + wz), ww - xx + yy - zz, 2 * (yz - wx),
        2 * (xz - wy), 2 * (yz + wx), ww - xx - yy + zz,
    )  # fmt: skip
    return np.stack(rows, axis=1).reshape(-1, 3, 3)


def scandots(world: World, course: np.ndarray, pos: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Heights of the ground around each robot, means over 0.14 m x 0.14 m, seen from its trunk.

    Parameters
    ----------
    world : the courses' maps
    course : (n,) index of each robot's course
    pos : (n, 3) position of the trunk [m]
    yaw : (n,) heading [rad]

    Returns
    -------
    (n, 132) clip(trunk z - 0.3 - ground height, +-1) [m], x-major
    """
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.stack([cos, -sin, sin, cos], axis=1, dtype=np.float32).reshape(-1, 2, 2)
    origin = pos[:, :2] + (0.0, LANE_WIDTH / 2)
    # p = base + R(yaw) (dx, dy), in cells
    cell = (turn @ _GRID + (origin / CELL).astype(np.float32)[:, :, None]).astype(np.int32)  # (n, 2, 132)
    np.minimum(np.maximum(cell, 0, out=cell), _LAST_CELL, out=cell)
    flat = cell[:, 0] * GRID_SHAPE[1]
    flat += cell[:, 1]
    flat += (course * (GRID_SHAPE[0] * GRID_SHAPE[1])).astype(np.int32)[:, None]
    seen = (pos[:, 2:] - SCANDOT_ZERO).astype(np.float32) - world.scan.reshape(-1).take(flat)
    return np.minimum(np.maximum(seen, -1.0, out=seen), 1.0, out=seen)

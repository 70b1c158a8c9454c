"""Silhouettes: the Go1 drawn by matplotlib from its own kinematics.

Every geom of :mod:`agility_ref.scene` is convex, and the outline of a convex shape is the
set of its farthest points in the directions of the picture.

In:  ``qpos`` (19,).  Out: polygons in side view, x to the right and z up.
"""

import mujoco
import numpy as np

from agility_ref.scene import BOX, CAPSULE, CYLINDER, ELLIPSOID, LOOK_GROUP, SPHERE, make_scene
from agility_ref.terrain import Course


def support_points(shape: int, size: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Farthest point of a convex shape in each direction, in the shape's own frame.

    Parameters
    ----------
    shape : a MuJoCo geom type
    size : (3,) as MuJoCo has it [m]
    directions : (K, 3) unit vectors

    Returns
    -------
    (K, 3) [m]
    """
    d = directions
    if shape == BOX:
        return np.sign(d) * size
    if shape == SPHERE:
        return size[0] * d
    if shape == ELLIPSOID:  # S^2 d / |S d|
        return size**2 * d / np.linalg.norm(size * d, axis=1, keepdims=True)
    ends = np.zeros_like(d)
    ends[:, 2] = np.sign(d[:, 2]) * size[1]
    if shape == CAPSULE:
        return ends + size[0] * d
    if shape == CYLINDER:
        radial = np.hypot(d[:, 0], d[:, 1])[:, None]
        ends[:, :2] = size[0] * d[:, :2] / np.maximum(radial, 1e-9)
        return ends
    raise ValueError(f"no silhouette for geom type {shape}")


class Robot:
    """Draws a Go1 in side view (x to the right, z up) from recorded joint positions."""

    def __init__(self, course: Course, corners: int = 20):
        self.model = make_scene(course)
        self.data = mujoco.MjData(self.model)
        looks = (self.model.geom_group == LOOK_GROUP) & (self.model.geom_bodyid > 0)
        self.geoms = np.flatnonzero(looks)
        angle = np.linspace(0, 2 * np.pi, corners, endpoint=False) + 0.05  # never along a box's face
        self.directions = np.column_stack([np.cos(angle), np.zeros(corners), np.sin(angle)])

    def silhouettes(self, qpos: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
        """Project every geom; return polygons (K, 2) [m] and colours (G, 4), farthest first."""
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        order = self.geoms[np.argsort(-self.data.geom_xpos[self.geoms, 1], kind="stable")]
        polygons = []
        for g in order:
            rotation = self.data.geom_xmat[g].reshape(3, 3)
            local = support_points(self.model.geom_type[g], self.model.geom_size[g], self.directions @ rotation)
            polygons.append((self.data.geom_xpos[g] + local @ rotation.T)[:, [0, 2]])
        return polygons, self.model.geom_rgba[order]

    def draw(self, axis, qpos: np.ndarray, zorder: float = 5.0) -> None:
        """Add the robot to an axis."""
        from matplotlib.collections import PolyCollection

        polygons, colours = self.silhouettes(qpos)
        shade = colours * [0.6, 0.6, 0.6, 1.0]
        axis.add_collection(
            PolyCollection(polygons, facecolors=colours, edgecolors=shade, linewidths=0.4, zorder=zorder)
        )

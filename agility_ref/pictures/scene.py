"""The scene: how the Go1 and its course look.

The training model of :mod:`agility_ref.go1` is built from the few geoms that touch
something.  Here the same model is dressed: hips, trunk and head by their look, legs in a
colour each, terrain with light tops, a line every metre and marked edges, poles on the
waypoints, sky and sun.
Nothing that is added collides or weighs anything, and the joints stay, so a ``qpos``
recorded on the training model can be shown on this one.

:class:`Robot` draws the same shapes with matplotlib: every geom is convex, and the outline of
a convex shape is the set of its farthest points in the directions of the picture.

In:  a :class:`~agility_ref.terrain.Course`, and for drawings ``qpos`` (19,).
Out: a compiled ``mujoco.MjModel`` to look at, never to train on; polygons in side view.
"""

from dataclasses import dataclass
from itertools import pairwise

from agility_ref.go1 import FOOT_RADIUS, LEFT, LEGS, LINK_LENGTH, make_xml
from agility_ref.pictures.plots import LEG_COLOURS, RED
from agility_ref.terrain import CELL, GRID_SHAPE, LANE_LENGTH, LANE_WIDTH, NUM_WAYPOINTS, Course
from agility_ref.world import EDGE_MIN_DROP, height_map

import mujoco
import numpy as np

BODY, DARK, RUBBER = "#D8DADD", "#3A3F47", "#23262B"
TOP_LOW, TOP_HIGH, SIDE, PIT, METRE = "#B9B2A3", "#F3EEE2", "#8C8577", "#5B564E", "#9C9485"

GAZE = np.array([0.25, 0.0, -0.06])  # [m] from the trunk to the point that a camera looks at
WAYPOINT_COLOURS = {"reached": "#6E6E6E", "current": "#FF4FA3", "ahead": "#F2D5E3"}

X = (np.arange(round(LANE_LENGTH / CELL)) + 0.5) * CELL  # [m] centres of the height map's cells
Y = (np.arange(round(LANE_WIDTH / CELL)) + 0.5) * CELL - LANE_WIDTH / 2

LOOK_GROUP, COLLISION_GROUP = 2, 3  # geom groups; viewers show 0 to 2
BOX, SPHERE, CAPSULE, CYLINDER, ELLIPSOID = (
    mujoco.mjtGeom.mjGEOM_BOX,
    mujoco.mjtGeom.mjGEOM_SPHERE,
    mujoco.mjtGeom.mjGEOM_CAPSULE,
    mujoco.mjtGeom.mjGEOM_CYLINDER,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID,
)
SIDEWAYS = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)  # quaternion that lays a cylinder along y
FORWARD = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)  # ... along x


@dataclass(frozen=True)
class Edge:
    """A straight border of a box top that drops by more than EDGE_MIN_DROP, all in [m]."""

    x0: float
    x1: float
    y0: float
    y1: float
    top: float


def rgba(colour: str, alpha: float = 1.0) -> list[float]:
    """Turn "#RRGGBB" into four numbers from 0 to 1."""
    return [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)] + [alpha]


def blend(low: str, high: str, share: float) -> list[float]:
    """Mix two colours; share 0 gives the first."""
    return (np.array(rgba(low)) * (1 - share) + np.array(rgba(high)) * share).tolist()


def find_edges(heights: np.ndarray) -> list[Edge]:
    """List the edges of a height map (nx, ny), neighbouring cells joined into lines."""
    edges = []
    for axis in (0, 1):
        h = np.moveaxis(heights, axis, 0)
        for border in np.flatnonzero((np.abs(np.diff(h, axis=0)) > EDGE_MIN_DROP).any(axis=1)):
            top = np.maximum(h[border], h[border + 1])
            drop = np.abs(h[border] - h[border + 1]) > EDGE_MIN_DROP
            # cut where an edge begins, ends, or changes its height
            cuts = np.flatnonzero((drop[1:] != drop[:-1]) | (top[1:] != top[:-1])) + 1
            for start, stop in zip([0, *cuts], [*cuts, len(top)], strict=True):
                if drop[start]:
                    at, low, high = (border + 1) * CELL, start * CELL, stop * CELL
                    if axis == 0:
                        edges.append(Edge(at, at, low - LANE_WIDTH / 2, high - LANE_WIDTH / 2, float(top[start])))
                    else:
                        edges.append(Edge(low, high, at - LANE_WIDTH / 2, at - LANE_WIDTH / 2, float(top[start])))
    return edges


def waypoint_heights(course: Course) -> np.ndarray:
    """(8,) ground under every waypoint [m]."""
    heights = height_map(course)
    i = np.clip((course.waypoints[:, 0] / CELL).astype(int), 0, GRID_SHAPE[0] - 1)
    j = np.clip(((course.waypoints[:, 1] + LANE_WIDTH / 2) / CELL).astype(int), 0, GRID_SHAPE[1] - 1)
    return heights[i, j]


# ---------------------------------------------------------------------------- parts


def _add(body, shape, size, colour, pos=(0, 0, 0), quat=(1, 0, 0, 0), fromto=None, name="") -> None:
    """Add one geom that only looks: no contact, no mass."""
    colour = rgba(colour) if isinstance(colour, str) else colour
    look = {
        "type": shape,
        "rgba": colour,
        "contype": 0,
        "conaffinity": 0,
        "mass": 0.0,
        "group": LOOK_GROUP,
        "name": name,
    }
    where = {"pos": pos, "quat": quat} if fromto is None else {"fromto": fromto}
    body.add_geom(size=[*size, 0, 0][:3], **where, **look)


def _dress_trunk(trunk) -> None:
    """0.58 m from nose to tail with the head, 0.18 m wide at the shoulders."""
    _add(trunk, BOX, (0.150, 0.062, 0.050), BODY)
    _add(trunk, ELLIPSOID, (0.200, 0.066, 0.030), BODY, pos=(0, 0, 0.046))
    _add(trunk, BOX, (0.110, 0.066, 0.026), DARK, pos=(-0.01, 0, -0.030))
    for end in (1, -1):  # shoulders and hips: the motors that turn the legs sideways
        _add(trunk, BOX, (0.040, 0.058, 0.052), BODY, pos=(0.188 * end, 0, 0))
        for side in (1, -1):
            _add(trunk, CYLINDER, (0.042, 0.034), DARK, pos=(0.188 * end, 0.047 * side, 0), quat=FORWARD)
    _add(trunk, ELLIPSOID, (0.055, 0.050, 0.042), BODY, pos=(0.245, 0, 0.018))
    _add(trunk, ELLIPSOID, (0.034, 0.040, 0.030), DARK, pos=(0.272, 0, 0.016))
    for side in (1, -1):
        _add(trunk, SPHERE, (0.009,), "#FFFFFF", pos=(0.300, 0.017 * side, 0.020))
    _add(trunk, ELLIPSOID, (0.035, 0.050, 0.040), DARK, pos=(-0.235, 0, 0.004))


def _dress_leg(spec, leg: str) -> None:
    colour, side = LEG_COLOURS[leg], LEFT[leg]
    _add(spec.body(f"{leg}_hip"), CYLINDER, (0.044, 0.030), DARK, pos=(0, 0.050 * side, 0), quat=SIDEWAYS)
    thigh = spec.body(f"{leg}_thigh")
    _add(thigh, CYLINDER, (0.042, 0.018), colour, quat=SIDEWAYS, pos=(0, 0.004 * side, 0))
    _add(thigh, CAPSULE, (0.027,), colour, fromto=(0, 0, -0.02, -0.010, 0, -0.10))
    _add(thigh, CAPSULE, (0.019,), colour, fromto=(-0.010, 0, -0.10, 0, 0, -LINK_LENGTH))
    calf = spec.body(f"{leg}_calf")
    _add(calf, CYLINDER, (0.021, 0.017), DARK, quat=SIDEWAYS)
    _add(calf, CAPSULE, (0.014,), colour, fromto=(0, 0, -0.01, 0.006, 0, -0.10))
    _add(calf, CAPSULE, (0.010,), colour, fromto=(0.006, 0, -0.10, 0, 0, -0.20))
    _add(calf, SPHERE, (FOOT_RADIUS,), RUBBER, pos=(0, 0, -LINK_LENGTH))


def _dress_terrain(world, course: Course) -> None:
    """Light tops, the higher the lighter, lined every metre; dark pits; a strip along every edge."""
    tops = [box.top for box in course.boxes]
    low, span = min(tops), max(max(tops) - min(tops), 0.3)
    for box in course.boxes:
        colour = blend(TOP_LOW, TOP_HIGH, (box.top - low) / span) if box.walkable else rgba(PIT)
        # A thin plate would shadow itself; this one is sunk, with 1 mm showing.
        half = ((box.x1 - box.x0) / 2 - 0.001, (box.y1 - box.y0) / 2 - 0.001, 0.02)
        middle = (box.y0 + box.y1) / 2
        _add(world, BOX, half, colour, pos=((box.x0 + box.x1) / 2, middle, box.top - 0.019))
        if box.walkable:  # lines across the lane: bare ground would hide how fast a robot goes
            for x in range(int(np.ceil(box.x0 + 0.01)), int(np.ceil(box.x1 - 0.01))):
                _add(world, BOX, (0.006, half[1], 0.002), METRE, pos=(x, middle, box.top + 0.001))
    for e in find_edges(height_map(course)):
        width = 0.012  # [m]
        half = ((e.x1 - e.x0) / 2 + width / 2, (e.y1 - e.y0) / 2 + width / 2, 0.010)
        _add(world, BOX, half, RED, pos=((e.x0 + e.x1) / 2, (e.y0 + e.y1) / 2, e.top - 0.006))


def _dress_waypoints(world, course: Course) -> None:
    for k, ((x, y), z) in enumerate(zip(course.waypoints, waypoint_heights(course), strict=True)):
        _add(world, CYLINDER, (0.006, 0.25), "#FFFFFF", pos=(x, y, z + 0.25))
        _add(world, SPHERE, (0.035,), WAYPOINT_COLOURS["ahead"], pos=(x, y, z + 0.52), name=f"waypoint{k}")


def mark_waypoints(model: mujoco.MjModel, index: int) -> None:
    """Colour the waypoint balls: reached, the current one, ahead."""
    for k in range(NUM_WAYPOINTS):
        state = "reached" if k < index else "current" if k == index else "ahead"
        model.geom(f"waypoint{k}").rgba = rgba(WAYPOINT_COLOURS[state])


def pose(model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray, waypoint: int) -> None:
    """Put the robot into the pose ``qpos`` (19,), on its way to a waypoint, as a renderer is to see it."""
    data.qpos[:] = qpos
    mark_waypoints(model, waypoint)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)


def scene_spec(course: Course) -> mujoco.MjSpec:
    """Return the dressed model of one course, not yet compiled."""
    spec = mujoco.MjSpec.from_string(make_xml(course))
    for geom in spec.geoms:
        geom.group = COLLISION_GROUP
    for geom in spec.worldbody.geoms:  # the terrain's own boxes are seen from the side
        geom.group, geom.rgba = 0, rgba(SIDE)
    _dress_trunk(spec.body("trunk"))
    for leg in LEGS:
        _dress_leg(spec, leg)
    _dress_terrain(spec.worldbody, course)
    _dress_waypoints(spec.worldbody, course)
    spec.add_texture(
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=(0.42, 0.62, 0.83), rgb2=(0.93, 0.96, 0.98), width=256, height=1536,
    )  # fmt: skip
    spec.body("trunk").add_light(  # the sun follows the robot: a shadow map of 6 m is enough
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACK,
        pos=(-1.35, -1.5, 3.0), dir=(0.45, 0.5, -1.0), castshadow=True,
        diffuse=(0.62, 0.60, 0.56), ambient=(0.18, 0.18, 0.19), specular=(0.1, 0.1, 0.1),
    )  # fmt: skip
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = (0.30, 0.30, 0.32), (0.20, 0.20, 0.20)
    spec.visual.headlight.specular = (0, 0, 0)
    spec.visual.quality.shadowsize, spec.visual.quality.offsamples = 1024, 2  # 4096 and 4 take twice as long
    spec.visual.quality.numslices, spec.visual.quality.numstacks = 16, 8
    spec.visual.map.znear, spec.visual.map.zfar, spec.visual.map.shadowclip = 0.01, 40.0, 1.0
    spec.stat.extent, spec.stat.center = 3.0, (3.0, 0.0, 0.2)
    return spec


def make_scene(course: Course) -> mujoco.MjModel:
    """Compile the dressed model of one course."""
    return scene_spec(course).compile()


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
    radial = np.hypot(d[:, 0], d[:, 1])[:, None]  # a cylinder
    ends[:, :2] = size[0] * d[:, :2] / np.maximum(radial, 1e-9)
    return ends


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


# ---------------------------------------------------------------------------- the ground from the side


def stretches(values: np.ndarray) -> list[tuple[int, int]]:
    """Cut an array (n,) or (n, k) where its value changes; return (start, stop) of every stretch."""
    rows = values.reshape(len(values), -1)
    changes = (rows[1:] != rows[:-1]).any(axis=1)
    borders = [0, *np.flatnonzero(changes) + 1, len(values)]
    return [(int(start), int(stop)) for start, stop in pairwise(borders)]


def ground_along(course: Course, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of the ground [m] at every X along a path x, y [m]."""
    order = np.argsort(x, kind="stable")
    path_y = np.interp(X, x[order], y[order])
    heights = height_map(course)
    j = np.clip(((path_y + LANE_WIDTH / 2) / CELL).astype(int), 0, heights.shape[1] - 1)
    return heights[np.arange(len(X)), j]


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

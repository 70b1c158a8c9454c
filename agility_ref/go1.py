"""The Unitree Go1: its constants and its MuJoCo model, from primitive geoms.

Every number of the robot stands here once.  Masses, inertias, joint ranges and torque
limits are those of Unitree's Go1 description (BSD-3-Clause, see NOTICE) in the merged
form of MuJoCo Menagerie: each rotor is added to the link that carries it; the hips' rotors, which
the trunk carries, are left out, as there.  Rotor
inertia times gear ratio squared gives the joint armature.  The geoms are ours:
foot spheres, thigh and calf capsules and a trunk box touch the terrain, and nothing
touches the robot itself.

In:  a :class:`~agility_ref.terrain.Course`.
Out: a compiled ``mujoco.MjModel`` of that course with one Go1 on it.

Legs are ordered FR, FL, RR, RL; joints of a leg: hip (abduction), thigh, calf.
Axes: x forward, y left, z up.
"""

from dataclasses import dataclass

from agility_ref.errors import require_at_least
from agility_ref.terrain import Course

import mujoco
import numpy as np

LEGS = ("FR", "FL", "RR", "RL")
JOINTS = tuple(f"{leg}_{part}" for leg in LEGS for part in ("hip", "thigh", "calf"))
FRONT = {"FR": 1, "FL": 1, "RR": -1, "RL": -1}  # sign of x
LEFT = {"FR": -1, "FL": 1, "RR": -1, "RL": 1}  # sign of y

DEFAULT_DOF_POS = np.array([0.0, 0.9, -1.8] * 4)  # [rad] home pose
STAND_HEIGHT = 0.2878  # [m] trunk above the ground in the home pose, feet just touching
FOOT_RADIUS = 0.023  # [m]
LINK_LENGTH = 0.213  # [m] thigh and calf
HIP_XY = (0.1881, 0.04675)  # [m] hip joint from the trunk's centre
THIGH_Y = 0.08  # [m] thigh joint from the hip joint

TORQUE_LIMIT = {"hip": 23.7, "thigh": 23.7, "calf": 35.55}  # [N m]
JOINT_RANGE = {"hip": (-0.863, 0.863), "thigh": (-0.686, 4.501), "calf": (-2.818, -0.888)}  # [rad]
ROTOR_INERTIA = 1.11842e-4  # [kg m^2] about its axis
GEAR_RATIO = {"hip": 6.0, "thigh": 6.0, "calf": 9.0}

TRUNK_MASS, HIP_MASS, THIGH_MASS, CALF_MASS = 5.204, 0.68, 1.009, 0.195862  # [kg]
TOTAL_MASS = TRUNK_MASS + 4 * (HIP_MASS + THIGH_MASS + CALF_MASS)  # 12.743448 kg

TORQUE_LIMITS = np.array([TORQUE_LIMIT[p] for p in ("hip", "thigh", "calf")] * 4)
DOF_RANGE = np.array([JOINT_RANGE[p] for p in ("hip", "thigh", "calf")] * 4)  # (12, 2)


@dataclass(frozen=True)
class PhysicsConfig:
    """How the model is simulated.  benchmarks/README.md has the measured alternatives."""

    timestep: float = 0.01  # physics time step [s]; usual 0.002 to 0.01
    substeps: int = 2  # physics steps per control step; timestep x substeps = 0.02 s, i.e. 50 Hz
    iterations: int = 4  # newton iterations of the contact solver; usual 1 to 10
    ls_iterations: int = 6  # line-search iterations per Newton iteration; usual 4 to 50
    kp: float = 35.0  # position gain of the joint controller [N m/rad]; usual 20 to 50
    kd: float = 0.6  # damping gain of the joint controller [N m s/rad]; usual 0.5 to 1

    def __post_init__(self):
        require_at_least(1e-5, timestep=self.timestep)
        require_at_least(1, 1000, substeps=self.substeps, iterations=self.iterations, ls_iterations=self.ls_iterations)
        require_at_least(0, 1e6, kp=self.kp, kd=self.kd)


def _vec(*values: float) -> str:
    return " ".join(f"{v:.10g}" for v in values)


def _hip_inertial(sx: int, sy: int) -> str:
    com = _vec(-0.0049165985 * sx, -0.00762615 * sy, -8.865e-5)
    inertia = _vec(
        3.99379786e-4, 7.33419392e-4, 4.68422091e-4,
        -1.45901057e-5 * sx * sy, 1.24609912e-6 * sx, 1.57532551e-6 * sy,
    )  # fmt: skip
    return f'<inertial mass="{HIP_MASS}" pos="{com}" fullinertia="{inertia}"/>'


def _thigh_inertial(sy: int) -> str:
    com = _vec(-0.0030472151, -0.019314995 * sy, -0.0305004163)
    inertia = _vec(
        4.59879646e-3, 4.68922406e-3, 8.17447857e-4,
        6.13739128e-5 * sy, -2.27529117e-4, 6.10808287e-4 * sy,
    )  # fmt: skip
    return f'<inertial mass="{THIGH_MASS}" pos="{com}" fullinertia="{inertia}"/>'


CALF_INERTIAL = (  # the same for all four legs, y offset included
    f'<inertial mass="{CALF_MASS}" pos="0.0042986226 0.0009766759 -0.1461968942" fullinertia="'
    '1.48448395e-3 1.49763545e-3 3.60682694e-5 -6.18826635e-7 -1.77209168e-5 -3.56626238e-6"/>'
)


def _trunk_inertial(payload: float) -> str:
    # The payload [kg] is a uniform scaling of the trunk, so its centre of mass stays.
    scale = (TRUNK_MASS + payload) / TRUNK_MASS
    inertia = np.array([0.0168128557, 0.063009565, 0.0716547275, -2.296769e-4, -2.945293e-4, -4.18731e-5])
    return (
        f'<inertial mass="{TRUNK_MASS * scale:.10g}" pos="0.0223 0.002 -0.0005" '
        f'fullinertia="{_vec(*(inertia * scale))}"/>'
    )


def _joint(leg: str, part: str) -> str:
    low, high = JOINT_RANGE[part]
    axis = "1 0 0" if part == "hip" else "0 1 0"
    armature = ROTOR_INERTIA * GEAR_RATIO[part] ** 2
    return f'<joint name="{leg}_{part}" axis="{axis}" range="{low} {high}" armature="{armature:.9g}"/>'


def _leg(leg: str) -> str:
    sx, sy = FRONT[leg], LEFT[leg]
    return f"""
      <body name="{leg}_hip" pos="{_vec(HIP_XY[0] * sx, HIP_XY[1] * sy, 0)}">
        {_hip_inertial(sx, sy)}{_joint(leg, "hip")}
        <body name="{leg}_thigh" pos="{_vec(0, THIGH_Y * sy, 0)}">
          {_thigh_inertial(sy)}{_joint(leg, "thigh")}
          <geom name="{leg}_thigh" class="body" type="capsule" size="0.02" fromto="0 0 -0.03 -0.01 0 -0.19"/>
          <body name="{leg}_calf" pos="0 0 {-LINK_LENGTH}">
            {CALF_INERTIAL}{_joint(leg, "calf")}
            <geom name="{leg}_calf" class="body" type="capsule" size="0.012" fromto="0 0 -0.02 0 0 -0.19"/>
            <geom name="{leg}_foot" class="foot" pos="0 0 {-LINK_LENGTH}"/>
            <site name="{leg}_foot" pos="0 0 {-LINK_LENGTH}"/>
          </body>
        </body>
      </body>"""


def _terrain(course: Course, num_boxes: int, friction: float) -> str:
    """Return the course's boxes, padded to num_boxes with ones far below."""
    depth = 1.0  # [m] below the lowest top, so that no foot tunnels through a thin plate
    bottom = min(box.top for box in course.boxes) - depth
    geoms = []
    for b in course.boxes:
        centre = _vec((b.x0 + b.x1) / 2, (b.y0 + b.y1) / 2, (b.top + bottom) / 2)
        half = _vec((b.x1 - b.x0) / 2, (b.y1 - b.y0) / 2, (b.top - bottom) / 2)
        geoms.append(f'<geom class="terrain" pos="{centre}" size="{half}" friction="{friction:.4g}"/>')
    padding = '<geom class="terrain" pos="0 0 -50" size="0.1 0.1 0.1"/>'
    return "\n".join(geoms + [padding] * (num_boxes - len(course.boxes)))


BODIES = ("trunk", *(f"{leg}_{part}" for leg in LEGS for part in ("thigh", "calf")))  # what should not touch the ground
# Names of the sensors in the model, see make_xml.
FOOT_TOUCH = tuple(f"{leg}_foot_touch" for leg in LEGS)  # each (found, force xyz on the ground in the world [N])
FOOT_VELOCITY = tuple(f"{leg}_foot_velocity" for leg in LEGS)  # each xyz in the world [m/s]
BODY_TOUCH = tuple(f"{body}_touch" for body in BODIES)  # each found


def make_xml(
    course: Course, physics: PhysicsConfig = PhysicsConfig(), num_boxes: int | None = None,
    friction: float = 1.0, payload: float = 0.0,
) -> str:  # fmt: skip
    """Return the MJCF of one Go1 on one course.

    Parameters
    ----------
    course : the boxes to stand on
    physics : solver, time step and joint gains
    num_boxes : pad the terrain to this many boxes; models of one batch need equal sizes
    friction : sliding friction of the ground; it has contact priority, so the feet's own does not count
    payload : mass added to the trunk [kg]
    """
    actuators = "\n".join(
        f'<position name="{joint}" joint="{joint}" kp="{physics.kp}" kv="{physics.kd}" '
        f'forcerange="{-TORQUE_LIMIT[part]} {TORQUE_LIMIT[part]}"/>'
        for joint in JOINTS
        for part in [joint.split("_")[1]]
    )
    feet = "\n".join(
        f'<contact name="{leg}_foot_touch" geom1="{leg}_foot" data="found force" reduce="netforce"/>'
        f'<framelinvel name="{leg}_foot_velocity" objtype="site" objname="{leg}_foot"/>'
        for leg in LEGS
    )
    touches = "\n".join(f'<contact name="{body}_touch" geom1="{body}"/>' for body in BODIES)
    home = _vec(1, 0, STAND_HEIGHT, 1, 0, 0, 0, *DEFAULT_DOF_POS)
    return f"""
<mujoco model="go1">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{physics.timestep}" integrator="implicitfast" cone="pyramidal"
          iterations="{physics.iterations}" ls_iterations="{physics.ls_iterations}"/>
  <default>
    <default class="terrain">
      <geom type="box" contype="1" conaffinity="0" condim="3" priority="1"/>
    </default>
    <default class="body">
      <geom contype="0" conaffinity="1" mass="0"/>
    </default>
    <default class="foot">
      <geom type="sphere" size="{FOOT_RADIUS}" contype="0" conaffinity="1" mass="0"/>
    </default>
  </default>
  <worldbody>
    {_terrain(course, num_boxes or len(course.boxes), friction)}
    <body name="trunk" pos="1 0 {STAND_HEIGHT}">
      <freejoint/>
      {_trunk_inertial(payload)}
      <geom name="trunk" class="body" type="box" size="0.188 0.0935 0.057"/>
      {"".join(_leg(leg) for leg in LEGS)}
    </body>
  </worldbody>
  <actuator>{actuators}</actuator>
  <sensor>{feet}{touches}</sensor>
  <keyframe><key name="home" qpos="{home}" ctrl="{_vec(*DEFAULT_DOF_POS)}"/></keyframe>
</mujoco>"""


def make_model(course: Course, physics: PhysicsConfig = PhysicsConfig(), **terrain) -> mujoco.MjModel:
    """Compile :func:`make_xml`, whose keyword arguments it takes."""
    return mujoco.MjModel.from_xml_string(make_xml(course, physics, **terrain))

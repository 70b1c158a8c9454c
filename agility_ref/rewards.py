"""Rewards: one function per term, one table of weights.

The terms are those of the Extreme Parkour code base, which the paper uses "as per
original paper" (section 3.2.2): github.com/chengxuxin/extreme-parkour,
``legged_gym/envs/base/legged_robot.py``.  In: a :class:`StepState`, the robots' state
after one step.  Out: each term as an array over robots; the reward is

    reward = dt * sum_k weight_k * term_k

What is simplified: nothing depends on simulator internals beyond contact forces, and
the squared torque *changes* (weight -1e-7 there) are left out.
"""

from dataclasses import dataclass

from agility_ref.go1 import DEFAULT_DOF_POS

import numpy as np

STUMBLE_RATIO = 4.0  # a foot stumbles when it is pushed sideways this many times as hard as upwards
DRAG_CLEARANCE = 0.05  # [m] a foot that moves is to keep this far off the ground
STANDING_SHARE = 0.3  # of the commanded speed: slower than this a robot stands


@dataclass
class StepState:
    """What the reward terms read, for N robots after one step."""

    dt: float  # time between two actions [s]
    base_lin_vel: np.ndarray  # (N, 3) velocity of the trunk in its own frame [m/s]
    base_ang_vel: np.ndarray  # (N, 3) angular velocity of the trunk in its own frame [rad/s]
    projected_gravity: np.ndarray  # (N, 3) unit gravity vector in the trunk's frame; (0, 0, -1) when level
    goal_velocity: np.ndarray  # (N,) world velocity along the direction of the current waypoint [m/s]
    speed: np.ndarray  # (N,) horizontal speed [m/s]
    heading_error: np.ndarray  # (N,) angle from the robot's heading to the current waypoint [rad], in +-pi
    command: np.ndarray  # (N,) commanded forward speed [m/s]
    on_level_course: np.ndarray  # (N,) bool, robots on the walk course
    dof_pos: np.ndarray  # (N, 12) [rad]
    dof_vel: np.ndarray  # (N, 12) [rad/s]
    last_dof_vel: np.ndarray  # (N, 12) one step earlier [rad/s]
    torque: np.ndarray  # (N, 12) [N m]
    action: np.ndarray  # (N, 12) as given by the policy
    last_action: np.ndarray  # (N, 12) one step earlier
    foot_force: np.ndarray  # (N, 4, 3) ground force on each foot in the world frame [N]
    foot_contact: np.ndarray  # (N, 4) bool, foot touches the ground
    foot_on_edge: np.ndarray  # (N, 4) bool, foot in contact within 5 cm of an edge
    foot_speed: np.ndarray  # (N, 4) horizontal speed of the feet [m/s]
    foot_clearance: np.ndarray  # (N, 4) height of the feet over the ground under them [m]
    body_contact: np.ndarray  # (N, 9) bool, trunk, thighs and calves touching the terrain


def tracking_goal_vel(s: StepState) -> np.ndarray:
    """V . direction to waypoint / max(|v|, command); faster than asked earns nothing more.

    The original caps v . direction, so that a robot at 1.4 times the commanded speed may head
    45 degrees off its waypoint for the full reward: it runs past and must turn back.  Here the
    velocity itself is capped, and direction counts at any speed.
    """
    return s.goal_velocity / np.maximum(s.speed, s.command)


def tracking_yaw(s: StepState) -> np.ndarray:
    """exp(-|heading error|)."""
    return np.exp(-np.abs(s.heading_error))


def lin_vel_z(s: StepState) -> np.ndarray:
    """v_z^2, halved off the level course as in the original, where bodies must rise and fall."""
    return s.base_lin_vel[:, 2] ** 2 * np.where(s.on_level_course, 1.0, 0.5)


def ang_vel_xy(s: StepState) -> np.ndarray:
    """w_x^2 + w_y^2."""
    return s.base_ang_vel[:, 0] ** 2 + s.base_ang_vel[:, 1] ** 2


def orientation(s: StepState) -> np.ndarray:
    """g_x^2 + g_y^2, on the level course only as in the original."""
    tilt = s.projected_gravity[:, 0] ** 2 + s.projected_gravity[:, 1] ** 2
    return tilt * s.on_level_course


def _sum_of_squares(x: np.ndarray) -> np.ndarray:
    return np.einsum("ij,ij->i", x, x)


def dof_acc(s: StepState) -> np.ndarray:
    """sum_j ((qd_j - last qd_j) / dt)^2."""
    return _sum_of_squares(s.dof_vel - s.last_dof_vel) / s.dt**2


def torques(s: StepState) -> np.ndarray:
    """sum_j tau_j^2."""
    return _sum_of_squares(s.torque)


def action_rate(s: StepState) -> np.ndarray:
    """|a - last a|, the norm and not its square, as in the original."""
    return np.sqrt(_sum_of_squares(s.action - s.last_action))


def hip_pos(s: StepState) -> np.ndarray:
    """Sum over the 4 hip joints of (q - default)^2."""
    return _sum_of_squares(s.dof_pos[:, 0::3] - DEFAULT_DOF_POS[0::3])


def dof_error(s: StepState) -> np.ndarray:
    """Sum over all 12 joints of (q - default)^2."""
    return _sum_of_squares(s.dof_pos - DEFAULT_DOF_POS)


def collision(s: StepState) -> np.ndarray:
    """Number of trunk, thighs and calves that touch the terrain."""
    return np.count_nonzero(s.body_contact, axis=1).astype(np.float64)


def feet_stumble(s: StepState) -> np.ndarray:
    """1 if any foot is pushed sideways more than 4 times as hard as upwards."""
    sideways = s.foot_force[:, :, 0] ** 2 + s.foot_force[:, :, 1] ** 2
    return (sideways > STUMBLE_RATIO**2 * s.foot_force[:, :, 2] ** 2).any(axis=1).astype(np.float64)


def feet_edge(s: StepState) -> np.ndarray:
    """Number of feet in contact within 5 cm of an edge."""
    return np.count_nonzero(s.foot_on_edge, axis=1).astype(np.float64)


def feet_drag(s: StepState) -> np.ndarray:
    """Sum over feet of speed times what is missing to a clearance of 5 cm [m^2/s].

    Not in the original.  Without it robots learn to shuffle, and stub their toes on the first
    edge; a foot that stands still or swings high costs nothing.
    """
    return (s.foot_speed * np.clip(DRAG_CLEARANCE - s.foot_clearance, 0.0, DRAG_CLEARANCE)).sum(axis=1)


def gait_sync(s: StepState) -> np.ndarray:
    """Diagonal pairs of feet (FR RL, FL RR) out of step, on the level course only.

    A pair is out of step while one of its feet stands and the other does not, and both pairs
    are while no foot stands.  Not in the original.  Of all gaits that earn the same it picks
    the trot, without much flight.
    """
    c = s.foot_contact
    pairs = (c[:, 0] != c[:, 3]).astype(np.float64) + (c[:, 1] != c[:, 2])
    return np.where(c.any(axis=1), pairs, 2.0) * s.on_level_course


def standing(s: StepState) -> np.ndarray:
    """What is missing to 0.3 times the commanded speed towards the waypoint, as a fraction, off the level course.

    Not in the original.  A robot that faces the waypoint and stands still earns ``tracking_yaw``.
    A beginner that tries a gap falls half the time and earns no more: without this term,
    standing still pays.
    """
    return np.clip(1.0 - s.goal_velocity / (STANDING_SHARE * s.command), 0.0, 1.0) * ~s.on_level_course


def alive(s: StepState) -> np.ndarray:
    """1 on the level course, 0 elsewhere, where it would pay to stand before an obstacle.

    Not in the original, which keeps a beginner from falling on purpose by clipping at zero.
    """
    return s.on_level_course.astype(np.float64)


TERMS = {
    f.__name__: f
    for f in (
        tracking_goal_vel, tracking_yaw, lin_vel_z, ang_vel_xy, orientation, dof_acc, torques,
        action_rate, hip_pos, dof_error, collision, feet_stumble, feet_edge, feet_drag, gait_sync, standing, alive,
    )
}  # fmt: skip


@dataclass(frozen=True)
class RewardConfig:
    """The weight of every term [1/s]; docs/training.md shows what changing them does."""

    tracking_goal_vel: float = 1.5  # speed towards the waypoint; original 1.5
    tracking_yaw: float = 0.5  # facing the waypoint; original 0.5
    lin_vel_z: float = -0.8  # bouncing; original -1
    ang_vel_xy: float = -0.02  # rolling and pitching rates; original -0.05
    orientation: float = -1.0  # tilt on level ground; original -1
    dof_acc: float = -2.5e-7  # joint acceleration; original -2.5e-7
    torques: float = -1e-5  # joint torque; original -1e-5
    action_rate: float = -0.03  # change of action; original -0.1, which stops a beginner from moving at our budgets
    hip_pos: float = -0.5  # legs spread sideways; original -0.5
    dof_error: float = -0.04  # distance from the home pose; original -0.04
    collision: float = -0.5  # touching the terrain with anything but the feet; original -10
    feet_stumble: float = -0.2  # kicking vertical faces; original -1
    feet_edge: float = -0.5  # stepping on edges; original -1, there only on the harder courses
    feet_drag: float = -2.0  # feet that move close to the ground; original 0
    gait_sync: float = -0.3  # diagonal feet out of step, and flight, on the level course; original 0
    standing: float = -0.5  # not getting on; cancels what standing earns by facing the waypoint; original 0
    alive: float = 0.5  # not having fallen, on the level course; original 0, with the sum clipped at zero


def compute_reward(state: StepState, weights: RewardConfig) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the reward (N,) and its weighted terms, which sum to it exactly."""
    terms = {name: weight * state.dt * TERMS[name](state) for name, weight in vars(weights).items()}
    return sum(terms.values()), terms

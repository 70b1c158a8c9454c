"""Rewards, waypoints and the end of an episode, from a log.

A log holds T steps of N robots: every array has the axes **(T, N, ...), time first**.  Vectors are those of
the **world** (x ahead, y left, z up); quaternions have their **real part last**, (x, y, z, w), and turn vectors of
the trunk into those of the world.  Feet come in the order FL, FR, RL, RR.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Log:
    """What was recorded, after every step."""

    position: np.ndarray
    """(T, N, 3) of the trunk [m]."""
    quaternion: np.ndarray
    """(T, N, 4) of the trunk, x y z w."""
    velocity: np.ndarray
    """(T, N, 3) of the trunk, in the world [m/s]."""
    waypoint: np.ndarray
    """(T, N, 2) where each robot is to go [m]."""
    command: np.ndarray
    """(T, N) commanded speed [m/s]."""
    level: np.ndarray
    """(T, N) bool, whether the course is the level one."""
    action: np.ndarray
    """(T, N, 12)."""
    start: np.ndarray
    """(T, N) bool, whether this is the first step of an episode."""
    foot_force: np.ndarray
    """(T, N, 4, 3) of the ground on the feet, in the world [N]."""
    foot_velocity: np.ndarray
    """(T, N, 4, 3) in the world [m/s]."""
    foot_clearance: np.ndarray
    """(T, N, 4) height of the feet over the ground under them [m]."""


def goal_speed(log: Log) -> np.ndarray:
    """Horizontal speed towards the waypoint, divided by the larger of horizontal speed and command, (T, N)."""
    ### BEGIN SOLUTION
    v = log.velocity[..., :2]
    to_goal = log.waypoint - log.position[..., :2]
    towards = (v * to_goal).sum(-1) / np.maximum(np.linalg.norm(to_goal, axis=-1), 1e-6)
    return towards / np.maximum(np.linalg.norm(v, axis=-1), log.command)
    ### END SOLUTION


def facing(log: Log) -> np.ndarray:
    """exp(-|angle between the robot's heading and the direction of the waypoint|), (T, N).

    The heading is the direction in which the trunk's x axis points, seen from above; the angle is in 0 ... pi.
    """
    ### BEGIN SOLUTION
    x, y, z, w = np.moveaxis(log.quaternion, -1, 0)
    yaw = np.arctan2(2 * (x * y + w * z), w**2 + x**2 - y**2 - z**2)
    to_goal = log.waypoint - log.position[..., :2]
    error = np.arctan2(to_goal[..., 1], to_goal[..., 0]) - yaw
    return np.exp(-np.abs((error + np.pi) % (2 * np.pi) - np.pi))
    ### END SOLUTION


def bounce(log: Log) -> np.ndarray:
    """Squared velocity along the **trunk's** z axis [m^2/s^2], half of it where the course is not level, (T, N)."""
    ### BEGIN SOLUTION
    x, y, z, w = np.moveaxis(log.quaternion, -1, 0)
    up = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), w**2 - x**2 - y**2 + z**2], axis=-1)
    return (log.velocity * up).sum(-1) ** 2 * np.where(log.level, 1.0, 0.5)
    ### END SOLUTION


def jerk(log: Log) -> np.ndarray:
    """|action - action one step earlier|, the Euclidean norm, (T, N); before the first step the action was 0."""
    ### BEGIN SOLUTION
    before = np.concatenate([np.zeros_like(log.action[:1]), log.action[:-1]])
    before = np.where(log.start[..., None], 0.0, before)
    return np.linalg.norm(log.action - before, axis=-1)
    ### END SOLUTION


def stumble(log: Log) -> np.ndarray:
    """1.0 where any foot is pushed sideways more than four times as hard as upwards, else 0.0, (T, N)."""
    ### BEGIN SOLUTION
    sideways = np.linalg.norm(log.foot_force[..., :2], axis=-1)
    return (sideways > 4 * np.abs(log.foot_force[..., 2])).any(-1).astype(float)
    ### END SOLUTION


def drag(log: Log) -> np.ndarray:
    """Sum over feet of their horizontal speed times what is missing to a clearance of 0.05 m, (T, N) [m^2/s].

    What is missing is at least 0 and at most 0.05 m.
    """
    ### BEGIN SOLUTION
    speed = np.linalg.norm(log.foot_velocity[..., :2], axis=-1)
    return (speed * np.clip(0.05 - log.foot_clearance, 0.0, 0.05)).sum(-1)
    ### END SOLUTION


def waypoints_reached(position: np.ndarray, waypoints: np.ndarray, radius: float, hold: int) -> np.ndarray:
    """Count the waypoints that were reached up to and including every step, (T, N) int.

    Waypoints come in order.  The current one is reached when the robot was nearer than ``radius`` in ``hold`` steps
    **in a row**; from the next step on the following waypoint is the current one, and its steps are counted anew.

    Parameters
    ----------
    position : (T, N, 2) [m]
    waypoints : (N, W, 2) [m], for each robot its own
    radius : [m]
    hold : steps
    """
    ### BEGIN SOLUTION
    steps, robots = position.shape[:2]
    total = waypoints.shape[1]
    count, timer = np.zeros(robots, int), np.zeros(robots, int)
    reached = np.zeros((steps, robots), int)
    for t in range(steps):
        goal = waypoints[np.arange(robots), np.minimum(count, total - 1)]
        near = np.linalg.norm(position[t] - goal, axis=-1) < radius
        timer = (timer + 1) * near
        arrived = (timer == hold) & (count < total)
        count = count + arrived
        timer[arrived] = 0
        reached[t] = count
    return reached
    ### END SOLUTION


def fallen(
    position: np.ndarray, quaternion: np.ndarray, support: np.ndarray, width: float, max_tilt: float, clearance: float
) -> np.ndarray:
    """Say how a robot has fallen, (T, N) of strings: "tipped", "outside", "low", or "" if it has not.

    Tipped: the angle between the trunk's z axis and the vertical is larger than ``max_tilt``.  Outside: farther than
    half of ``width`` from the middle of the lane, y = 0, or x below 0.  Low: the trunk is less than ``clearance``
    above the surface that should carry it.  The first that applies, in this order.

    Parameters
    ----------
    position : (T, N, 3) [m]
    quaternion : (T, N, 4), x y z w
    support : (T, N) height of the surface [m]
    width, clearance : [m]
    max_tilt : [rad]
    """
    ### BEGIN SOLUTION
    x, y, z, w = np.moveaxis(quaternion, -1, 0)
    tilt = np.arccos(np.clip(w**2 - x**2 - y**2 + z**2, -1.0, 1.0))
    outside = (np.abs(position[..., 1]) > width / 2) | (position[..., 0] < 0)
    low = position[..., 2] < support + clearance
    return np.select([tilt > max_tilt, outside, low], ["tipped", "outside", "low"], "")
    ### END SOLUTION


def ends(fell: np.ndarray, reached: np.ndarray, total: int, limit: int) -> tuple[np.ndarray, np.ndarray]:
    """Return ``terminated`` and ``truncated``, both (T, N) bool: where each robot's **only** episode ends, and how.

    Episodes begin with step 0.  An episode is truncated in the step in which the last waypoint is reached, **even if
    the robot falls in that step**; it terminates where the robot falls; and it is truncated with its ``limit``-th
    step if nothing else ended it before or in that step.  What comes after the end is marked False.

    Parameters
    ----------
    fell : (T, N) bool
    reached : (T, N) int, waypoints reached so far
    total : waypoints of a course
    limit : steps
    """
    ### BEGIN SOLUTION
    finished = reached >= total
    terminated = fell & ~finished
    late = (np.arange(len(fell)) >= limit - 1)[:, None]
    truncated = finished | (late & ~terminated)
    done = terminated | truncated
    first = done & (np.cumsum(done, axis=0) == 1)
    return terminated & first, truncated & first
    ### END SOLUTION

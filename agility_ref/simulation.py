"""Simulation: N Go1s in one ``mujoco.batch``, each on a course of its own.

In:  courses, friction and payload of each, joint targets.
Out: poses, velocities, contacts and torques, as views of the simulator's memory.
"""

import mujoco
import numpy as np
from mujoco import batch

from agility_ref.go1 import PhysicsConfig, make_model
from agility_ref.placement import Placement
from agility_ref.terrain import Course

DIVERGED = [
    int(w)
    for w in (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
]


class Simulation:
    """N simulated robots.  Every array is live: reading it sees, writing it changes the simulation.

    Attributes
    ----------
    models : one compiled model a course
    batch : the simulator
    home : (19,) qpos of the home pose
    qpos, qvel : (N, 19), (N, 18) trunk position, quaternion wxyz and joints; their velocities
    ctrl : (N, 12) joint targets [rad]
    sensors : (N, 37), see :func:`~agility_ref.go1.make_xml`
    foot_pos : (N, 4, 3) centres of the feet [m]
    torque : (N, 12) [N m]
    errors : simulations that failed so far
    """

    def __init__(
        self,
        courses: list[Course],
        num_robots: int,
        config: PhysicsConfig,
        conditions: list[tuple[float, float]],
        num_threads: int = 0,
    ):
        """Compile one model a course and start the robots on the first, in the home pose.

        Parameters
        ----------
        courses : where robots can be put
        num_robots : N
        config : simulator and joint controller
        conditions : friction of the ground and payload [kg], for each course
        num_threads : 0 for all cores; results do not depend on it
        """
        num_boxes = max(len(course.boxes) for course in courses)
        self.models = [
            make_model(course, config, num_boxes=num_boxes, friction=friction, payload=payload)
            for course, (friction, payload) in zip(courses, conditions, strict=True)
        ]
        self.batch = batch.Batch(self.models[0], num_robots, num_threads)
        self._placement = Placement(self.batch, self.models)
        self.batch.reset(keyframe=0, stage=mujoco.mjtStage.mjSTAGE_NONE)
        self.home, self._start = self.models[0].key_qpos[0].copy(), self.batch.state[0].copy()
        self.qpos, self.qvel = self.batch.bind("qpos"), self.batch.bind("qvel")
        self.ctrl = self.batch.bind("ctrl")
        self.sensors = self.batch.bind("sensordata")
        self.foot_pos = self.batch.bind("site_xpos")
        self.torque = self.batch.bind("actuator_force")
        self.errors = 0

    def place(self, ids: np.ndarray, course: np.ndarray, qpos: np.ndarray) -> None:
        """Put robots ``ids`` at rest on courses (n,), indices of the models, in poses qpos (n, 19)."""
        self._placement.place(ids, course)
        self.batch.state[ids] = self._start  # no velocity, no warm start of the solver
        self.qpos[ids] = qpos

    def step(self, num_steps: int) -> np.ndarray:
        """Run physics steps; return which robots' simulations failed, (N,) bool."""
        failed = np.zeros(len(self.qpos), bool)
        try:
            self.batch.step(nstep=num_steps)
        except batch.SimulationError as error:
            failed[error.ids] = True
        # MuJoCo resets a simulation that diverges to its default pose and counts a warning.
        failed |= (self.batch.warning[:, DIVERGED, 1] > 0).any(axis=1)
        if failed.any():
            self.batch.warning[failed] = 0
            self.errors += int(failed.sum())
        return failed

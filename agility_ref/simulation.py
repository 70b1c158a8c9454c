"""Simulation: N Go1s in one ``mujoco.batch``, each on a course of its own.

A model per course is the plain way (``Batch.set_models``), but a model takes 40 to 70 kB, and 50
of them pass through the processor's cache at every step.  Here all robots share one model, and
only the fields in which the models differ are held per robot (``Batch.expand``): the boxes, the
friction and what follows from the payload.  The physics is the same to the last bit, at a speed
that does not depend on the number of courses (docs/performance.md).

In:  courses, friction and payload of each, joint targets.
Out: poses, velocities, contacts and torques, as views of the simulator's memory.
"""

import os

from agility_ref.errors import MANY, UserError
from agility_ref.go1 import PhysicsConfig, make_model
from agility_ref.terrain import Course

import mujoco
import numpy as np
from mujoco import batch


def bounding_volumes(tree: mujoco.MjModel, model: mujoco.MjModel) -> np.ndarray:
    """Return ``model``'s bounding volumes (nbvh, 6), centre and half size, in the tree of another model.

    The compiler sorts the boxes of a course into a tree of its own; which box hangs where cannot
    differ between robots, so all use one tree.  Any tree gives the same contacts.
    """
    first, count = tree.body_bvhadr[0], tree.body_bvhnum[0]  # of the world body, which holds the terrain
    low, high = np.zeros((2, count, 3))
    for node in reversed(range(count)):  # children come after their parents
        geom = tree.bvh_nodeid[first + node]
        if geom >= 0:
            low[node], high[node] = (model.geom_pos[geom] + s * model.geom_size[geom] for s in (-1, 1))
        else:
            children = tree.bvh_child[first + node]
            low[node], high[node] = low[children].min(axis=0), high[children].max(axis=0)
    volumes = tree.bvh_aabb.copy()
    volumes[first : first + count] = np.hstack([(low + high) / 2, (high - low) / 2])
    return volumes


class Placement:
    """Per-robot model fields of a batch.

    Parameters
    ----------
    simulations : the batch; its own model must be ``models[0]``
    models : one per course, of equal sizes
    """

    def __init__(self, simulations: batch.Batch, models: list[mujoco.MjModel]):
        names = [name for name in batch.MODEL_FIELDS if not name.startswith("opt.")]
        tables = {name: np.stack([getattr(m, name) for m in models]) for name in names if name != "bvh_aabb"}
        tables["bvh_aabb"] = np.stack([bounding_volumes(models[0], m) for m in models])
        self._fields = [
            (simulations.expand(name), table) for name, table in tables.items() if (table != table[0]).any()
        ]

    def place(self, ids: np.ndarray, course: np.ndarray) -> None:
        """Put robots ``ids`` on courses ``course``, indices of the models."""
        for values, table in self._fields:
            values[ids] = table[course].reshape(len(ids), *values.shape[1:])


DIVERGED = [int(getattr(mujoco.mjtWarning, f"mjWARN_BAD{what}")) for what in ("QPOS", "QVEL", "QACC")]


class Simulation:
    """N simulated robots.  Every array is live: reading it sees, writing it changes the simulation.

    Attributes
    ----------
    models : one compiled model per course
    batch : the simulator
    home : (19,) qpos of the home pose
    qpos, qvel : (N, 19), (N, 18) trunk position, quaternion wxyz and joints; their velocities
    ctrl : (N, 12) joint targets [rad]
    sensors : (N, 37), see :meth:`columns`
    foot_pos : (N, 4, 3) centres of the feet [m]
    torque : (N, 12) [N m]
    """

    def __init__(
        self, courses: list[Course], num_robots: int, config: PhysicsConfig,
        conditions: list[tuple[float, float]], num_threads: int = 0,
    ):  # fmt: skip
        """Compile one model per course and start the robots on the first, in the home pose.

        Parameters
        ----------
        courses : where robots can be put
        num_robots : N
        config : simulator and joint controller
        conditions : friction of the ground and payload [kg], for each course
        num_threads : 0 for what AGILITY_REF_THREADS says, else all cores; results do not depend on it
        """
        shared = os.environ.get("AGILITY_REF_THREADS", "0")  # for jobs that share a machine
        if not shared.isdecimal() or int(shared) > MANY:
            raise UserError(f"AGILITY_REF_THREADS is a number of threads, not {shared!r}")
        num_boxes = max(len(course.boxes) for course in courses)
        self.models = [
            make_model(course, config, num_boxes=num_boxes, friction=friction, payload=payload)
            for course, (friction, payload) in zip(courses, conditions, strict=True)
        ]
        self.batch = batch.Batch(self.models[0], num_robots, num_threads or int(shared))
        self._placement = Placement(self.batch, self.models)
        self.batch.reset(keyframe=0, stage=mujoco.mjtStage.mjSTAGE_NONE)
        self.home, self._start = self.models[0].key_qpos[0].copy(), self.batch.state[0].copy()
        self.qpos, self.qvel = self.batch.bind("qpos"), self.batch.bind("qvel")
        self.ctrl, self.sensors = self.batch.bind("ctrl"), self.batch.bind("sensordata")
        self.foot_pos, self.torque = self.batch.bind("site_xpos"), self.batch.bind("actuator_force")

    def columns(self, names: tuple[str, ...]) -> np.ndarray:
        """Return where the named sensors of :func:`~agility_ref.go1.make_xml` stand in ``sensors``."""
        found = [self.models[0].sensor(name) for name in names]
        return np.concatenate([sensor.adr + np.arange(sensor.dim[0]) for sensor in found])

    def place(self, ids: np.ndarray, course: np.ndarray, qpos: np.ndarray) -> None:
        """Put robots ``ids`` at rest on courses (n,), indices of the models, in poses qpos (n, 19)."""
        self._placement.place(ids, course)
        self.batch.state[ids] = self._start  # no velocity, no warm start of the solver
        self.qpos[ids] = qpos

    def load_state(self, course: np.ndarray, physics: np.ndarray) -> None:
        """Put all robots on courses (N,) in states ``batch.state`` (N, k) of before."""
        self._placement.place(np.arange(len(course)), course)
        self.batch.state[:] = physics

    def step(self, num_steps: int) -> np.ndarray:
        """Run physics steps; return which robots' simulations failed, (N,) bool."""
        failed = np.zeros(len(self.qpos), bool)
        try:
            self.batch.step(nstep=num_steps)
        except batch.SimulationError as error:
            failed[error.ids] = True
        # MuJoCo resets a simulation that diverges to its default pose and counts a warning.
        failed |= (self.batch.warning[:, DIVERGED, 1] > 0).any(axis=1)
        self.batch.warning[failed] = 0
        return failed

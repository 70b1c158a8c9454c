"""Placement: the robots of one batch on courses of their own.

A model a course is the plain way (``Batch.set_models``), but a model takes 40 to 70 kB, and 50
of them pass through the processor's cache at every step.  Here all robots share one model, and
only the fields in which the models differ are held per robot (``Batch.expand``): the boxes, the
friction and what follows from the payload.  The physics is the same to the last bit, at a speed
that does not depend on the number of courses (docs/performance.md).

In:  a batch and one compiled model a course.  Out: :class:`Placement`, which moves robots.
"""

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
    models : one a course, of equal sizes
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

"""The observation's layout and its mirror image."""

from dataclasses import replace

import numpy as np
import pytest

from agility_ref.env import Go1Env
from agility_ref.go1 import DEFAULT_DOF_POS
from agility_ref.observation import (
    MIRROR_ACTION_INDEX,
    MIRROR_ACTION_SIGN,
    MIRROR_INDEX,
    MIRROR_SIGN,
    OBS_DIM,
    SCANDOTS,
    observation_slices,
)
from agility_ref.task import EnvConfig
from agility_ref.terrain import make_course
from agility_ref.world import World

SLICES = observation_slices()


def test_mirroring_twice_is_nothing():
    np.testing.assert_array_equal(MIRROR_INDEX[MIRROR_INDEX], np.arange(OBS_DIM))
    np.testing.assert_array_equal(MIRROR_SIGN * MIRROR_SIGN[MIRROR_INDEX], 1.0)


def test_mirror_image_of_a_turned_robot():
    """A robot left of the middle that faces left, beside its mirror image: they observe each other's mirror image."""
    course = make_course("beam", 0.5, 3)
    flipped = replace(
        course,
        boxes=tuple(replace(b, y0=-b.y1, y1=-b.y0) for b in course.boxes),
        waypoints=course.waypoints * [1, -1],
    )
    config = replace(EnvConfig().clean(), scandot_period=1)
    env = Go1Env(World([course, flipped]), 2, config, lambda ids, fraction: ids)
    rng = np.random.default_rng(0)
    env.command[:] = 1.0
    env._qpos[:, 0], env._qpos[:, 1] = 2.1, (0.2, -0.2)  # before the first beam
    env._qpos[:, 3:7] = [[0.98, 0.05, 0.02, 0.19], [0.98, -0.05, 0.02, -0.19]]
    joints = DEFAULT_DOF_POS + rng.uniform(-0.1, 0.1, 12)
    env._qpos[:, 7:] = joints, joints[MIRROR_ACTION_INDEX] * MIRROR_ACTION_SIGN
    action = rng.uniform(-0.3, 0.3, 12)
    observation, reward, *_ = env.step(np.stack([action, action[MIRROR_ACTION_INDEX] * MIRROR_ACTION_SIGN]))
    one, other = observation
    assert np.ptp(one[SCANDOTS]) > 0.1
    # The real trunk's centre of mass lies 2 mm left of its middle: nearly, not exactly.
    tolerance = np.full(OBS_DIM, 5e-3)
    tolerance[SLICES["dof_vel"]] = 0.2
    assert (np.abs(one[MIRROR_INDEX] * MIRROR_SIGN - other) < tolerance).all()
    assert (np.abs(one - other) > 10 * tolerance).any()
    assert reward[0] == pytest.approx(reward[1], abs=1e-3)

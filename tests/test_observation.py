"""The observation's layout and its mirror image."""

from dataclasses import replace

from agility_ref.env import EnvConfig, Go1Env
from agility_ref.go1 import DEFAULT_DOF_POS
from agility_ref.observation import (
    MIRROR_ACTION_INDEX,
    MIRROR_ACTION_SIGN,
    MIRROR_INDEX,
    MIRROR_SIGN,
    OBS_DIM,
    SCANDOT_X,
    SCANDOT_Y,
    SCANDOTS,
    SIGHT_MARGIN,
    observation_slices,
    sight,
)
from agility_ref.terrain import make_course
from agility_ref.world import World

import numpy as np
import pytest

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


# --- what a policy's own courses show it ---------------------------------------------------


def straight_ahead(bound):
    """Bounds (12,) of the scandots in the middle, from 0.45 m behind the trunk to 1.2 m before it."""
    return bound[SCANDOTS].reshape(len(SCANDOT_X), len(SCANDOT_Y))[:, len(SCANDOT_Y) // 2]


def test_who_climbs_up_sees_nothing_deep_ahead_and_one_step_behind():
    """Steps of 0.1 + 0.35 / 2 = 0.275 m, treads of at least 0.5 m.  Ahead the ground only rises; behind, within
    0.45 m, at most one step lies below."""
    low, high = sight(World([make_course("climb-up", 0.5, seed) for seed in range(4)]))
    ahead, behind = SCANDOT_X > 0.1, SCANDOT_X < -0.1
    np.testing.assert_allclose(straight_ahead(high)[ahead], SIGHT_MARGIN, atol=1e-6)
    np.testing.assert_allclose(straight_ahead(high)[behind], 0.275 + SIGHT_MARGIN, atol=1e-6)
    assert (straight_ahead(low)[ahead] <= -0.275 - SIGHT_MARGIN + 1e-6).all()


def test_who_leaps_sees_the_pit_everywhere_and_nothing_high():
    """The pit is 0.05 + 0.95 / 2 = 0.525 m deep; a robot in mid-leap has it below."""
    low, high = sight(World([make_course("gap", 0.5, 0)]))
    np.testing.assert_allclose(straight_ahead(high), 0.525 + SIGHT_MARGIN, atol=1e-6)
    np.testing.assert_allclose(straight_ahead(low), -SIGHT_MARGIN, atol=1e-6)


def test_sight_bounds_the_scandots_only():
    low, high = sight(World([make_course("walk", 0.0, 0)]), OBS_DIM + 2)
    rest = np.r_[0 : SCANDOTS.start, SCANDOTS.stop : OBS_DIM + 2]
    assert np.isneginf(low[rest]).all() and np.isposinf(high[rest]).all()
    assert np.isfinite(low[SCANDOTS]).all() and (low < high).all()


def test_robots_on_their_own_courses_see_what_is_within_their_sight():
    """Standing robots at the start of every course, where the margin has to hold noise and the drop onto the feet."""
    world = World([make_course(kind, 0.5, 1) for kind in ("climb", "gap", "beam", "walk")])
    low, high = sight(world)
    env = Go1Env(world, 4, EnvConfig(), lambda ids, fraction: ids)
    observation, _ = env.reset(0)
    for _ in range(20):
        assert ((observation >= low) & (observation <= high)).all()
        observation, *_ = env.step(np.zeros((4, 12)))

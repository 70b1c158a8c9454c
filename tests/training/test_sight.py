"""What a policy's own courses show it."""

from agility_ref.env import EnvConfig, Go1Env
from agility_ref.observation import SCANDOT_X, SCANDOT_Y, SCANDOTS
from agility_ref.terrain import make_course
from agility_ref.training.sight import SIGHT_DEPTH, SIGHT_MARGIN, sight
from agility_ref.world import World

import numpy as np


def straight_ahead(bound):
    """Bounds (12,) of the scandots in the middle, from 0.45 m behind the trunk to 1.2 m before it."""
    return bound[SCANDOTS].reshape(len(SCANDOT_X), len(SCANDOT_Y))[:, len(SCANDOT_Y) // 2]


def test_who_climbs_up_sees_nothing_deep_ahead_and_one_step_behind():
    """Steps of 0.1 + 0.35 x 0.4 = 0.24 m, treads of at least 0.5 m.  Ahead the ground only rises; behind, within
    0.45 m, at most one step lies below."""
    low, high = sight(World([make_course("climb-up", 0.4, seed) for seed in range(4)]))
    ahead, behind = SCANDOT_X > 0.1, SCANDOT_X < -0.1
    np.testing.assert_allclose(straight_ahead(high)[ahead], SIGHT_MARGIN, atol=1e-6)
    np.testing.assert_allclose(straight_ahead(high)[behind], 0.24 + SIGHT_MARGIN, atol=1e-6)
    assert (straight_ahead(low)[ahead] <= -0.24 - SIGHT_MARGIN + 1e-6).all()


def test_who_leaps_sees_the_pit_everywhere_and_nothing_high():
    """The pit is 0.05 + 0.95 / 2 = 0.525 m deep; a robot in mid-leap has it below."""
    low, high = sight(World([make_course("gap", 0.5, 0)]))
    np.testing.assert_allclose(straight_ahead(high), 0.525 + SIGHT_MARGIN, atol=1e-6)
    np.testing.assert_allclose(straight_ahead(low), -SIGHT_MARGIN, atol=1e-6)


def test_to_who_knows_no_pit_no_ground_is_deeper_than_a_step():
    """Two steps of 0.1 + 0.35 = 0.45 m lie 0.9 m below the feet of who stands before them; a step up is seen in full."""
    low, high = sight(World([make_course("climb", 1.0, seed) for seed in range(4)]))
    np.testing.assert_allclose(straight_ahead(high)[SCANDOT_X > 0.1], SIGHT_DEPTH, atol=1e-6)
    assert straight_ahead(low).min() <= -0.45 - SIGHT_MARGIN + 1e-6
    _, high = sight(World([make_course(kind, 1.0, seed) for seed in range(4) for kind in ("climb", "gap")]))
    np.testing.assert_allclose(straight_ahead(high), 1.0 + SIGHT_MARGIN, atol=1e-6)  # where scandots end


def test_sight_bounds_the_scandots_only():
    low, high = sight(World([make_course("walk", 0.0, 0)]))
    rest = np.r_[0 : SCANDOTS.start]
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

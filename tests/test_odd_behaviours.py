"""Detectors by hand: columns are episodes, rows control steps of 0.02 s."""

from dataclasses import replace

import numpy as np
import pytest

from agility_ref.odd_behaviours import (
    abandoned_leap,
    duration,
    inside,
    kicked_back,
    leapt_down,
    odd_behaviours,
    onsets,
    passes,
)
from agility_ref.terrain import Course, Obstacle
from agility_ref.trace import Trace

W, U, D, L, B = range(5)  # walk, climb-up, climb-down, leap, beam
SKILLS = ("walk", "climb-up", "climb-down", "leap", "beam")


def column(values, kind=None):
    return np.array(values, kind)[:, None]


def test_onsets_and_duration_of_runs():
    mask = column([1, 1, 0, 0, 1, 0, 1, 1, 1], bool)
    np.testing.assert_array_equal(onsets(mask)[:, 0], [1, 0, 0, 0, 1, 0, 1, 0, 0])
    np.testing.assert_array_equal(duration(mask)[:, 0], [1, 2, 0, 0, 1, 0, 1, 2, 3])


def test_inside_takes_the_spans_of_its_own_episode():
    spans = np.array([[[1.0, 2.0], [4.0, 5.0]], [[3.0, 3.5], [np.nan, np.nan]]])
    x = np.array([[0.9, 0.9], [1.0, 1.5], [3.2, 3.2], [4.5, 4.5]])
    np.testing.assert_array_equal(inside(x, spans), [[0, 0], [1, 0], [0, 1], [1, 0]])


@pytest.mark.parametrize("skills, pit, expected", [
    ([W, L, L, U, U, W], None, 3),  # leapt for 2 steps, then climbs: abandoned
    ([W, L, U, U, U, W], None, None),  # one step of leap is a flicker
    ([L, L, L, L, U, U], None, None),  # after 4 steps the leap may be over ...
    ([L, L, L, L, U, U], 4, 4),  # ... but not above a pit
    ([L, L, L, L, U, U], 5, None),  # the pit comes too late: climb-up acts already
    ([W, L, L, W, U, U], None, None),  # walk came between
    ([W, L, L, D, D, D], None, None),  # climbing down is no fake
    ([W, L, L, -1, -1, -1], None, None),  # the episode ended
])  # fmt: skip
def test_abandoned_leap(skills, pit, expected):
    over_pit = np.zeros((6, 1), bool)
    if pit is not None:
        over_pit[pit:] = True
    found = abandoned_leap(column(skills), over_pit, L, U, begun=2, over=3)
    np.testing.assert_array_equal(np.flatnonzero(found), [] if expected is None else [expected])


def test_passing_an_edge_is_forwards_and_within_the_episode():
    x = column([0.8, 0.95, 1.05, 0.9, 1.0, 0.5, 1.2])
    alive = column([1, 1, 1, 1, 1, 1, 0], bool)
    edges = np.array([[1.0, np.nan]])
    # 0.95 -> 1.05 and 0.9 -> 1.0; back is no passing, and 0.5 -> 1.2 is the next episode's start
    np.testing.assert_array_equal(np.flatnonzero(passes(x, alive, edges)), [1, 3])


def test_leapt_down():
    x = column([0.8, 0.95, 1.05, 0.9, 1.1, 1.2])
    edges = np.array([[1.0]])
    for skill, expected in (
        ([L, L, W, W, W, W], [1]),  # leaps off, comes back, walks off
        ([W, W, L, L, L, L], [3]),
        ([D, D, L, W, D, D], []),
    ):
        np.testing.assert_array_equal(np.flatnonzero(leapt_down(x, column(skill), edges, L)), expected)


def test_kicked_back_needs_to_be_near_and_faster_than_a_push():
    vx = column([-0.6, -0.4, -0.6, 0.9, -2.0])
    near = column([1, 1, 0, 1, 1], bool)
    np.testing.assert_array_equal(kicked_back(vx, near)[:, 0], [1, 0, 0, 0, 1])


def hand_made(skills=SKILLS):
    """One episode: a leap given up for climb-up, a kick before the up-step at 2 m, a leap off the one at 3 m."""
    obstacles = (Obstacle(2.0, 2.0, "climb-up"), Obstacle(3.0, 3.0, "climb-down"))
    course = Course("climb", 0.5, (), obstacles, np.zeros((8, 2)))
    chosen = [L] * 6 + [U] * 2 + [B] * 3 + [W] + [L] * 2 + [-1]
    x = [1.0] * 6 + [1.1] * 2 + [1.5, 1.5, 1.4] + [1.45] + [2.95, 3.1] + [1.0]
    vx = [0.5] * 8 + [0.3, -0.9, -0.8] + [0.5] + [2.0, 2.0] + [0.0]
    position, velocity = np.zeros((15, 1, 3)), np.zeros((15, 1, 3))
    position[:, 0, 0], velocity[:, 0, 0] = x, vx
    skill = column(chosen)
    return Trace("p", "climb", skills, 0.02, [course], skill, skill, position, velocity, np.zeros(1))


def test_a_hand_made_episode_has_one_of_each():
    assert odd_behaviours(hand_made()) == {
        # six steps of leap are 0.12 s: begun, and not yet over
        "abandoned_leap": {"events": 1, "episodes": 1, "chances": 1},
        # the robot is between 2.95 and 3.1 m under leap
        "leapt_down": {"events": 1, "episodes": 1, "chances": 1},
        # x = 1.5, 1.5, 1.4, 1.45 lie in the 0.6 m before 2 m: one approach, on the beam policy
        "beam_before_up_step": {"events": 1, "episodes": 1, "chances": 1},
        # -0.9 and -0.8 m/s are one kick
        "kicked_back": {"events": 1, "episodes": 1, "chances": 1},
    }


def test_what_a_policy_lacks_is_none():
    found = odd_behaviours(hand_made(("walk", "climb", "stand", "leap")))
    assert found["beam_before_up_step"] is None and found["kicked_back"] is None
    assert found["abandoned_leap"]["events"] == 1  # its one skill for climbing counts as climb-up


def test_two_events_of_one_episode_and_steps_after_the_end():
    """The hand-made episode twice over within one, and a down-step that is walked."""
    one = hand_made()
    recorded = {name: getattr(one, name) for name in ("skill", "position", "velocity")}
    twice = {name: np.concatenate([values[:14], values[:14], values[14:]]) for name, values in recorded.items()}
    twice["skill"][26:28] = W  # the second time it walks off
    twice["position"][-1, 0, 0] = 1.5  # after the end it stands before the up-step
    found = odd_behaviours(replace(one, oracle=twice["skill"], **twice))
    assert found["abandoned_leap"] == {"events": 2, "episodes": 1, "chances": 2}
    assert found["leapt_down"] == {"events": 1, "episodes": 1, "chances": 2}
    assert found["beam_before_up_step"] == {"events": 2, "episodes": 1, "chances": 2}

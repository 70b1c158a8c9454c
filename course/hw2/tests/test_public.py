"""Public tests: one robot, one step, by hand; and a recording."""

import adapters
import numpy as np
import pytest
from recording import record

HALF = np.sqrt(0.5)


def log(**changes):
    """One robot that stands at the origin, level, facing along x, for one step, and what is different."""
    still = {
        "position": np.zeros(3), "quaternion": [0, 0, 0, 1], "velocity": np.zeros(3), "waypoint": [1, 0], "command": 0.8,
        "level": True, "action": np.zeros(12), "start": True, "foot_force": np.zeros((4, 3)),
        "foot_velocity": np.zeros((4, 3)), "foot_clearance": np.zeros(4),
    }  # fmt: skip
    return adapters.Log(**{name: np.array(value)[None, None] for name, value in (still | changes).items()})


def value(function, **changes):
    got = np.asarray(function(log(**changes)))
    assert got.shape == (1, 1), f"{function.__name__} of one step and one robot has shape (1, 1), not {got.shape}"
    return float(got[0, 0])


def test_terms_by_hand():
    speed = adapters.goal_speed
    assert value(speed, velocity=[0.4, 0, 0]) == pytest.approx(0.5), "0.4 m/s straight on, 0.8 commanded: 0.5"
    assert value(speed, velocity=[1.6, 0, 0]) == pytest.approx(1), "twice the commanded speed earns no more than 1"
    assert value(speed, velocity=[0.4, 0, 9]) == pytest.approx(0.5), "only the horizontal speed counts"
    assert value(adapters.facing, waypoint=[0, 2]) == pytest.approx(np.exp(-np.pi / 2)), (
        "a waypoint on the left: a quarter turn"
    )
    turned = value(adapters.facing, quaternion=[0, 0, HALF, HALF], waypoint=[0, 2])
    assert turned == pytest.approx(1), "a robot that is turned to its left (z = w = 0.707) faces a waypoint there"
    assert value(adapters.bounce, velocity=[0, 0, 2]) == pytest.approx(4), "level, 2 m/s upwards: 4"
    assert value(adapters.bounce, velocity=[0, 0, 2], level=False) == pytest.approx(2), (
        "half of it off the level course"
    )
    assert value(adapters.jerk, action=np.full(12, 0.5)) == pytest.approx(np.sqrt(3)), "the norm of twelve times 0.5"
    force = np.zeros((4, 3))
    force[2] = (-5, 0, 1)
    assert value(adapters.stumble, foot_force=force) == 1, "5 N sideways and 1 N upwards: a stumble"
    assert value(adapters.drag, foot_velocity=np.full((4, 3), 1.0), foot_clearance=np.full(4, 0.04)) == pytest.approx(
        0.04 * np.sqrt(2)
    ), "four feet, sqrt(2) m/s, 1 cm missing"


def test_waypoints_by_hand():
    x = np.array([0, 0.9, 1.0, 0.5, 0.9, 1.0, 1.0, 1.0, 1.9, 2.0, 2.0])
    position = np.stack([x, 0 * x], axis=-1)[:, None]
    got = np.asarray(adapters.waypoints_reached(position, np.array([[[1.0, 0], [2.0, 0]]]), 0.2, 3))[:, 0].tolist()
    expected = [0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2]
    assert got == expected, f"three steps in a row within 0.2 m of (1, 0), then of (2, 0): {expected}, not {got}"


def test_falls_by_hand():
    position = np.array([[[1, 0, 0.3], [1, 0, 0.3], [1, 2.1, 0.3], [1, 0, 0.04], [1, 2.1, 0.0]]])
    quaternion = np.array([[[0, 0, 0, 1], [HALF, 0, 0, HALF], [0, 0, HALF, HALF], [0, 0, 0, 1], [1, 0, 0, 0]]])
    got = np.asarray(adapters.fallen(position, quaternion, np.zeros((1, 5)), 4.0, 1.4, 0.05))[0].tolist()
    expected = ["", "tipped", "outside", "low", "tipped"]
    assert got == expected, (
        f"standing; on its side; turned, but upright, and off the lane; low; all at once: {expected}, not {got}"
    )


def test_ends_by_hand():
    fell = np.array([[0, 1, 0, 0, 0], [0, 0, 0, 1, 1]]).T.astype(bool)
    reached = np.array([[0, 0, 1, 2, 2], [0, 0, 1, 2, 2]]).T
    terminated, truncated = adapters.ends(fell, reached, 2, 5)
    got = np.argwhere(terminated).tolist(), np.argwhere(truncated).tolist()
    assert got == ([[1, 0]], [[3, 1]]), (
        f"robot 0 falls in step 1 and nothing counts after that; robot 1 finishes in step 3, falling: not {got}"
    )


NAMES = {
    "goal_speed": "tracking_goal_vel",
    "facing": "tracking_yaw",
    "bounce": "lin_vel_z",
    "jerk": "action_rate",
    "stumble": "feet_stumble",
    "drag": "feet_drag",
}


@pytest.mark.parametrize("term", NAMES)
def test_recording_term_by_term(term):
    recorded, expected = record(0)
    got = np.asarray(getattr(adapters, term)(recorded))
    expected = expected[NAMES[term]]
    assert got.shape == expected.shape, f"{term} has shape {got.shape}, the recording (T, N) is {expected.shape}"
    wrong = ~np.isclose(got, expected, rtol=1e-4, atol=1e-5)
    t, n = np.argwhere(wrong)[0] if wrong.any() else (0, 0)
    assert not wrong.any(), (
        f"{term} differs in {wrong.mean():.0%} of the recording, first at step {t}, robot {n}: {got[t, n]:.5g}, not {expected[t, n]:.5g}"
    )

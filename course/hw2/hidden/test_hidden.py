"""Hidden tests: other recordings, and random paths and falls against a slow reference."""

import adapters
import numpy as np
import pytest
from recording import record
from test_public import NAMES


def compare(term, seed, part=slice(None)):
    recorded, expected = record(seed)
    got, expected = np.asarray(getattr(adapters, term)(recorded))[part], expected[NAMES[term]][part]
    wrong = ~np.isclose(got, expected, rtol=1e-4, atol=1e-5)
    return wrong, got, expected


@pytest.mark.parametrize("term", NAMES)
def test_other_recordings(term, seed):
    wrong, got, expected = compare(term, seed)
    assert not wrong.any(), (
        f"{term} differs in {wrong.mean():.0%} of a recording: {got[wrong][0]:.5g}, not {expected[wrong][0]:.5g}"
    )


def test_first_steps(seed):
    """The log has two episodes, one behind the other."""
    wrong, got, expected = compare("jerk", seed, slice(50, 51))
    assert not wrong.any(), (
        f"jerk in the first step of the second episode: {got[wrong][:1]}, not {expected[wrong][:1]}; "
        "before the first step of an episode the action was 0"
    )


def test_bounce_is_the_trunks(seed):
    """A trunk rolled by 90 degrees moves along its own z axis when it moves sideways."""
    recorded, _ = record(seed)
    n = recorded.velocity.shape[1]
    rolled = np.tile([np.sqrt(0.5), 0, 0, np.sqrt(0.5)], (100, n, 1))
    got = np.asarray(adapters.bounce(adapters.Log(**vars(recorded) | {"quaternion": rolled})))
    expected = recorded.velocity[..., 1] ** 2 * np.where(recorded.level, 1.0, 0.5)
    assert np.allclose(got, expected), (
        "rolled onto its side a trunk's z axis is the world's y axis: use the trunk's frame"
    )


def test_waypoints_of_random_paths(seed):
    rng = np.random.default_rng(seed)
    steps, robots, total = 300, 6, 4
    waypoints = np.cumsum(rng.uniform(0.02, 0.4, (robots, total, 2)), axis=1)
    waypoints[:, 2] = waypoints[:, 1] + 0.01  # reached one after the other, at the same place
    along = np.clip(np.cumsum(rng.uniform(-0.02, 0.045, (steps, robots)), axis=0), 0, total)
    position = np.empty((steps, robots, 2))
    for n in range(robots):
        corners = np.vstack([[0, 0], waypoints[n]])
        for axis in range(2):
            position[:, n, axis] = np.interp(along[:, n], np.arange(total + 1), corners[:, axis])
    position += rng.normal(0, 0.03, position.shape)
    hold, expected = int(rng.integers(2, 5)), np.zeros((steps, robots), int)
    for n in range(robots):
        count = since = 0
        for t in range(steps):
            if count < total:
                since = since + 1 if np.hypot(*(position[t, n] - waypoints[n, count])) < 0.15 else 0
                if since == hold:
                    count, since = count + 1, 0
            expected[t, n] = count
    got = np.asarray(adapters.waypoints_reached(position, waypoints, 0.15, hold))
    wrong = np.argwhere(got != expected)
    assert not len(wrong), (
        f"hold {hold} steps in a row: at step and robot {wrong[0].tolist()} {expected[tuple(wrong[0])]} waypoints"
    )


def test_falls_at_random(seed):
    rng = np.random.default_rng(seed)
    position = rng.uniform((-0.3, -2.5, 0), (3, 2.5, 0.5), (20, 30, 3))
    axis = rng.normal(size=(20, 30, 3)) * (1, 1, 0.5)
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    half = rng.uniform(0, np.pi / 2, (20, 30, 1))
    quaternion = np.concatenate([np.sin(half) * axis, np.cos(half)], axis=-1)
    support = rng.uniform(-0.2, 0.3, (20, 30))
    got = np.asarray(adapters.fallen(position, quaternion, support, 4.0, 1.2, 0.05))
    for t, n in np.ndindex(20, 30):
        x, y = quaternion[t, n, :2]
        tilt = np.arccos(1 - 2 * (x * x + y * y))
        px, py, pz = position[t, n]
        expected = (
            "tipped"
            if tilt > 1.2
            else "outside"
            if abs(py) > 2 or px < 0
            else "low"
            if pz < support[t, n] + 0.05
            else ""
        )
        assert got[t, n] == expected, (
            f"position {position[t, n].round(2)}, tilt {tilt:.2f}, support {support[t, n]:.2f}: {expected!r}, not {got[t, n]!r}"
        )


def test_ends_at_random(seed):
    rng = np.random.default_rng(seed)
    fell = rng.random((40, 60)) < 0.03
    reached = np.cumsum(rng.random((40, 60)) < 0.08, axis=0)
    terminated, truncated = map(np.asarray, adapters.ends(fell, reached, 3, 35))
    for n in range(60):
        for t in range(40):
            finished = reached[t, n] >= 3
            if finished or fell[t, n] or t == 34:
                kind = "truncated" if finished or not fell[t, n] else "terminated"
                break
        got = np.flatnonzero(terminated[:, n]).tolist(), np.flatnonzero(truncated[:, n]).tolist()
        expected = ([t], []) if kind == "terminated" else ([], [t])
        assert got == expected, (
            f"the limit is 35 steps; this episode is {kind} at step {t}, once: {expected}, not {got}"
        )

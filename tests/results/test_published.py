from collections import deque

from agility_ref.evaluate import METRICS
from agility_ref.results import published
from agility_ref.results.published import as_published

import numpy as np

# Five steps of two robots that begin anew when an episode ends.  The first ends in steps 2 and 5,
# the second in step 3; what it does after that is under way and does not count.

DONE = np.array([[0, 0], [1, 0], [0, 1], [0, 0], [1, 0]], bool)
RUN_REWARD = np.array([[1.0, 0.5], [2.0, 0.5], [3.0, 1.0], [-1.0, 100.0], [4.0, 100.0]])
PASSED = np.array([[1, 3], [2, 7], [0, 8], [1, 1], [8, 5]])
FEET = np.array([[0, 1], [2, 0], [1, 1], [0, 3], [4, 0]])


def test_as_published_by_hand():
    run = as_published(RUN_REWARD, PASSED, FEET, DONE)
    np.testing.assert_array_equal(run["ends"], [[1, 0], [2, 1], [4, 0]])
    # 1 + 2; 0.5 + 0.5 + 1; 3 - 1 + 4
    np.testing.assert_allclose(run["reward"], [3.0, 2.0, 6.0])
    np.testing.assert_array_equal(run["episode_length"], [2, 3, 3])
    # before the last step: 1, 7, 1 of "7"; the second waypoint of the first episode is not counted,
    # and all eight of the second are a seven
    np.testing.assert_allclose(run["waypoint_fraction"], [1 / 7, 1.0, 1 / 7])
    # all steps of all robots, under way or not: 12 feet in 10 robot steps
    assert run["edge_violation"].mean() == 1.2


def test_as_published_forgets_all_but_the_last(monkeypatch):
    monkeypatch.setattr(published, "PUBLISHED_MEMORY", 3)
    run = as_published(RUN_REWARD, PASSED, FEET, DONE)
    np.testing.assert_array_equal(run["edge_violation"], [3, 4, 0])  # the last step and a half
    monkeypatch.setattr(published, "PUBLISHED_MEMORY", 2)
    run = as_published(RUN_REWARD, PASSED, FEET, DONE)
    np.testing.assert_allclose(run["reward"], [2.0, 6.0])
    np.testing.assert_array_equal(run["ends"], [[2, 1], [4, 0]])


def test_an_episode_of_one_step_has_passed_nothing():
    run = as_published(np.ones((2, 1)), np.array([[8], [8]]), np.zeros((2, 1)), np.ones((2, 1), bool))
    np.testing.assert_array_equal(run["episode_length"], [1, 1])
    np.testing.assert_array_equal(run["waypoint_fraction"], [0.0, 0.0])


def test_as_published_agrees_with_queues_filled_step_by_step():
    rng = np.random.default_rng(0)
    steps, robots = 400, 9
    reward, feet = rng.standard_normal((steps, robots)), rng.integers(0, 5, (steps, robots))
    done, passed = rng.random((steps, robots)) < 0.4, rng.integers(0, 9, (steps, robots))
    rewards, lengths, waypoints, edges = (deque(maxlen=1000) for _ in range(4))
    total, length, before = np.zeros(robots), np.zeros(robots, int), np.zeros(robots, int)
    for t in range(steps):
        total += reward[t]
        length += 1
        edges.extend(feet[t])
        for n in range(robots):
            if done[t, n]:
                rewards.append(total[n])
                lengths.append(length[n])
                waypoints.append(before[n] / 7)
                total[n], length[n], before[n] = 0.0, 0, 0
            else:
                before[n] = passed[t, n]
    run = as_published(reward, passed, feet, done)
    assert len(rewards) == 1000
    for name, queue in zip(METRICS, (rewards, lengths, waypoints, edges), strict=True):
        np.testing.assert_allclose(run[name], queue, atol=1e-12, err_msg=name)

"""Public tests: small lanes that can be drawn on paper."""

import adapters
import numpy as np
from adapters import Lane

LANE = Lane(1.2, 0.6, 0.2)  # 3 rows of 6 cells


def same(got, expected, what):
    got, expected = np.asarray(got), np.asarray(expected)
    assert got.shape == expected.shape, f"{what}: shape {got.shape}, expected {expected.shape}; the first axis is y"
    wrong = ~((got == expected) | (np.isnan(got.astype(float)) & np.isnan(expected.astype(float))))
    assert not wrong.any(), f"{what}: wrong at {np.argwhere(wrong)[:3].tolist()}:\n{got}\nexpected\n{expected}"


def test_heights_by_hand():
    boxes = np.array([[0.4, 0.2, 1.2, 0.6, 0.3], [0.0, 0.0, 0.8, 0.4, 0.1]])
    hole = np.nan
    expected = [
        [0.1, 0.1, 0.1, 0.1, hole, hole],
        [0.1, 0.1, 0.3, 0.3, 0.3, 0.3],
        [hole, hole, 0.3, 0.3, 0.3, 0.3],
    ]
    same(adapters.height_map(boxes, LANE), expected, "two boxes that overlap, the lower one last")


def test_edges_by_hand():
    heights = np.zeros((3, 6))
    heights[:, 3:] = 0.3
    heights[:, 5] = 0.35
    expected = np.zeros((3, 6), bool)
    expected[:, [2, 3]] = True
    same(adapters.edge_map(heights, LANE, 0.1, 0.12), expected, "a step along x, reach of 0.6 cells")
    expected[:, [1, 4]] = True
    same(adapters.edge_map(heights, LANE, 0.1, 0.32), expected, "a step along x, reach of 1.6 cells")
    heights = np.zeros((3, 6))
    heights[2] = 0.2
    expected = np.zeros((3, 6), bool)
    expected[[1, 2]] = True
    same(adapters.edge_map(heights, LANE, 0.1, 0.12), expected, "a step along y")


def test_regions_by_hand():
    got = adapters.region_map(np.array([[0.4, 0.6, 2]]), LANE, 0.2, 0.4)
    same(got, [0, 2, 2, 2, 2, 0], "an obstacle from 0.4 to 0.6 m with a lead of 0.2 and a tail of 0.4")
    got = adapters.region_map(np.array([[0.8, 1.0, 3], [0.0, 0.3, 1]]), LANE, 1.0, 1.0)
    same(got, [1, 1, 1, 3, 3, 3], "two claims that meet: neither goes beyond the middle, 0.55 m, between the obstacles")


def test_scandots_by_hand():
    heights = np.arange(18.0).reshape(3, 6)
    pose = np.array([[0.5, 0.3, 1.0, 0.0]])
    got = adapters.scandots(heights, LANE, pose, np.array([0.0, 0.2, 0.4]), np.array([0.0, 0.2]), -9.0)
    same(got, [[[7.0, 8.0, 9.0], [13.0, 14.0, 15.0]]], "facing along x: ground minus trunk, (robots, left, ahead)")
    pose[0, 3] = np.pi / 2
    got = adapters.scandots(heights, LANE, pose, np.array([0.0, 0.2]), np.array([0.0, 0.2]), -9.0)
    same(got, [[[7.0, 13.0], [6.0, 12.0]]], "facing to the left: ahead is +y, left is -x")

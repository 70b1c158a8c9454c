"""Hidden tests: random boxes against a slow reference, cell by cell, and the courses of agility_ref."""

from agility_ref import world
from agility_ref.terrain import CELL, LANE_LENGTH, LANE_WIDTH, make_course

import adapters
import numpy as np
from adapters import Lane
from test_public import same

FINE = Lane(LANE_LENGTH, LANE_WIDTH, CELL)


def lane_of(rng):
    cell = float(rng.choice([0.05, 0.1, 0.25]))
    return Lane(cell * int(rng.integers(14, 22)), cell * int(rng.integers(6, 11)), cell)


def boxes_of(rng, lane, count=6):
    low = rng.uniform(-0.2, 0.8, (count, 2)) * (lane.length, lane.width)
    size = rng.uniform(0.2, 0.7, (count, 2)) * (lane.length, lane.width)
    return np.column_stack([low, low + size, rng.uniform(-1, 1, count)])


def ground_of(rng, lane):
    """Heights of random steps, with holes and without the student's height map."""
    heights = rng.choice([0.0, 0.05, 0.2, 0.4, np.nan], lane.shape, p=[0.4, 0.2, 0.2, 0.1, 0.1])
    return np.repeat(heights, 2, axis=1)[:, : lane.shape[1]]


def boxes_and_map(kind, seed):
    course = make_course(kind, 0.7, seed)
    shift = LANE_WIDTH / 2
    return course, np.array([[b.x0, b.y0 + shift, b.x1, b.y1 + shift, b.top] for b in course.boxes])


def test_heights_of_random_boxes(seed):
    rng = np.random.default_rng(seed)
    lane = lane_of(rng)
    boxes = boxes_of(rng, lane)
    expected = np.full(lane.shape, np.nan)
    for j, i in np.ndindex(*lane.shape):
        x, y = (i + 0.5) * lane.cell, (j + 0.5) * lane.cell
        tops = [top for x0, y0, x1, y1, top in boxes if x0 <= x <= x1 and y0 <= y <= y1]
        if tops:
            expected[j, i] = max(tops)
    same(adapters.height_map(boxes, lane), expected, "random boxes, some lower than 0: highest top, NaN where none is")


def test_heights_of_a_course(seed):
    course, boxes = boxes_and_map("climb-gap", seed)
    got = np.asarray(adapters.height_map(boxes, FINE))
    same(np.round(got, 4), np.round(world.height_map(course).T.astype(float), 4), "a Climb+Gap course of agility_ref")


def test_edges_of_random_ground(seed):
    rng = np.random.default_rng(seed)
    lane = lane_of(rng)
    heights = ground_of(rng, lane)
    reach, drop = float(rng.uniform(0.6, 2.4)) * lane.cell, 0.1
    ny, nx = lane.shape
    expected = np.zeros(lane.shape, bool)
    for j, i in np.ndindex(ny, nx):
        for di, dj in ((1, 0), (0, 1)):
            if i + di >= nx or j + dj >= ny:
                continue
            a, b = heights[j, i], heights[j + dj, i + di]
            if (np.isnan(a) and np.isnan(b)) or abs(a - b) <= drop:
                continue
            for k in range(-5, 6):  # cells along the same axis, k = 0 before the border, 1 after it
                jk, ik = j + k * dj, i + k * di
                if abs(k - 0.5) * lane.cell <= reach and 0 <= jk < ny and 0 <= ik < nx:
                    expected[jk, ik] = True
    same(adapters.edge_map(heights, lane, drop, reach), expected, "random steps and holes, edges along x and along y")


def test_edges_of_a_course(seed):
    course, _ = boxes_and_map("beam", seed)
    heights = world.height_map(course)
    got = adapters.edge_map(heights.T.astype(float), FINE, world.EDGE_MIN_DROP, world.EDGE_DISTANCE + 1e-6)
    same(got, np.isfinite(world.edge_map(heights)).T, "a beam course: reach 0.05 m with cells of 0.02 m is 3 cells")


def test_edges_change_nothing(seed):
    lane = Lane(1.0, 0.5, 0.1)
    heights = ground_of(np.random.default_rng(seed), lane)
    before = heights.copy()
    adapters.edge_map(heights, lane, 0.1, 0.2)
    same(heights, before, "edge_map changed the heights that it was given")


def test_regions_of_random_obstacles(seed):
    rng = np.random.default_rng(seed)
    lane = Lane(12.0, 1.0, 0.05)
    for _ in range(5):
        ends = np.sort(rng.uniform(0.5, 11.5, 8)).reshape(4, 2)
        obstacles = np.column_stack([ends, rng.permutation(4) + 1])
        lead, tail = rng.uniform(0.1, 1.5, 2)
        expected = np.zeros(lane.shape[1], int)
        for i in range(lane.shape[1]):
            x = (i + 0.5) * lane.cell
            for k, (x0, x1, skill) in enumerate(obstacles):
                before = (obstacles[k - 1][1] + x0) / 2 if k else -np.inf
                after = (x1 + obstacles[k + 1][0]) / 2 if k < 3 else np.inf
                if max(x0 - lead, before) <= x <= min(x1 + tail, after):
                    expected[i] = skill
        got = adapters.region_map(rng.permutation(obstacles), lane, lead, tail)
        same(got, expected, f"four obstacles in any order, lead {lead:.2f}, tail {tail:.2f}")


def test_regions_without_obstacles(seed):
    lane = Lane(1.0 + seed % 5, 1.0, 0.5)
    same(
        adapters.region_map(np.zeros((0, 3)), lane, 1.0, 1.0),
        np.zeros(lane.shape[1]),
        "no obstacle: walking everywhere",
    )


def test_scandots_at_random_poses(seed):
    rng = np.random.default_rng(seed)
    lane = lane_of(rng)
    heights = ground_of(rng, lane)
    ahead, left = np.sort(rng.uniform(-0.5, 1.0, 4)), np.sort(rng.uniform(-0.6, 0.6, 3))
    poses = np.column_stack(
        [rng.uniform(0, lane.length, 5), rng.uniform(0, lane.width, 5), *rng.uniform(-2, 2, (2, 5))]
    )
    got = np.asarray(adapters.scandots(heights, lane, poses, ahead, left, -0.77))
    expected = np.zeros((5, 3, 4))
    for n, b, a in np.ndindex(5, 3, 4):
        x, y, z, yaw = poses[n]
        point = np.array([x, y]) + [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]] @ np.array(
            [ahead[a], left[b]]
        )
        i = min(max(int(np.floor(point[0] / lane.cell)), 0), lane.shape[1] - 1)
        j = min(max(int(np.floor(point[1] / lane.cell)), 0), lane.shape[0] - 1)
        expected[n, b, a] = -0.77 if np.isnan(heights[j, i]) else heights[j, i] - z
    same(
        np.round(got, 9), np.round(expected, 9), "robots anywhere, turned anyhow: ground minus trunk, (N, left, ahead)"
    )


def test_scandots_beside_the_lane(seed):
    rng = np.random.default_rng(seed)
    lane = Lane(2.0, 1.0, 0.5)
    heights = rng.normal(size=lane.shape)
    poses = np.array([[-3.0, 0.6, 0.0, 0.0], [9.0, -4.0, 0.0, 0.0]])
    got = np.asarray(adapters.scandots(heights, lane, poses, np.zeros(1), np.zeros(1), -1.0)).ravel()
    same(got, [heights[1, 0], heights[0, 3]], "a dot beside the lane takes the nearest cell of the lane")

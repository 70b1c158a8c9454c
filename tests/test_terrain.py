from agility_ref import terrain
from agility_ref.terrain import (
    CELL,
    COURSE_KINDS,
    EASIEST,
    GRID_SHAPE,
    LANE_LENGTH,
    LANE_WIDTH,
    NUM_WAYPOINTS,
    SKILLS,
    START_LENGTH,
    Box,
    Course,
    Obstacle,
    make_course,
)
from agility_ref.world import EDGE_MIN_DROP, LEAD, TAIL, World, edge_map, height_map, region_map, scan_map, support_map

import numpy as np
import pytest

INF = np.inf
SEEDS = range(8)
DIFFICULTIES = (0.0, 0.37, 1.0)
WALK, UP, LEAP = (SKILLS.index(s) for s in ("walk", "climb-up", "leap"))


def lane(x0, x1, top, walkable=True):
    return Box(x0, x1, -LANE_WIDTH / 2, LANE_WIDTH / 2, top, walkable)


def course(boxes, obstacles=()):
    return Course("drawn", 0.0, tuple(boxes), tuple(obstacles), np.zeros((NUM_WAYPOINTS, 2)))


def all_courses(difficulties=DIFFICULTIES, seeds=SEEDS):
    return [(kind, make_course(kind, d, seed)) for kind in COURSE_KINDS for d in difficulties for seed in seeds]


def cell(x):
    return round(x / CELL)


# --- height map ---------------------------------------------------------------------


def test_height_map_around_a_step():
    # 5 m / 0.02 m = cell 250 is the first on the step
    heights = height_map(course([lane(0, 5, 0.0), lane(5, 18, 0.3)]))
    assert heights.shape == GRID_SHAPE
    np.testing.assert_array_equal(heights[248:252, 0], np.float32([0.0, 0.0, 0.3, 0.3]))
    np.testing.assert_array_equal(heights[:, 0], heights[:, -1])


def test_height_map_takes_the_higher_of_two_boxes():
    heights = height_map(course([lane(0, 18, 0.0), Box(4, 5, -0.1, 0.1, 0.2)]))
    # y: -0.1 m .. 0.1 m are cells 95 .. 104 of 200
    np.testing.assert_array_equal(heights[220, 94:106] > 0.1, [False] + [True] * 10 + [False])


def test_height_map_refuses_a_hole():
    with pytest.raises(AssertionError, match="hole"):
        height_map(course([lane(0, 5, 0.0), lane(6, 18, 0.0)]))


@pytest.mark.parametrize("kind", COURSE_KINDS)
def test_every_cell_is_covered(kind):
    for d in np.linspace(0, 1, 6):
        for seed in range(10):
            assert np.isfinite(height_map(make_course(kind, d, seed))).all()


def test_box_edges_lie_on_the_grid():
    for kind, c in all_courses():
        edges = np.array([(b.x0, b.x1, b.y0, b.y1) for b in c.boxes]) / CELL
        np.testing.assert_allclose(edges, np.round(edges), atol=1e-6, err_msg=kind)


def test_boxes_stay_in_the_lane():
    for kind, c in all_courses():
        for b in c.boxes:
            assert -1e-9 <= b.x0 < b.x1 <= LANE_LENGTH + 1e-9, kind
            assert -LANE_WIDTH / 2 - 1e-9 <= b.y0 < b.y1 <= LANE_WIDTH / 2 + 1e-9, kind


def test_courses_start_on_the_level_platform():
    for kind, c in all_courses():
        assert (height_map(c)[: cell(START_LENGTH)] == 0).all(), kind


# --- edge map -----------------------------------------------------------------------


def test_edge_map_of_one_step():
    heights = np.zeros((10, 1), np.float32)
    heights[5:] = 0.3
    # cell centres 0.01, 0.03 and 0.05 m from the border, on both sides of it
    np.testing.assert_array_equal(
        edge_map(heights)[:, 0], np.float32([INF, INF, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3, INF, INF])
    )


def test_edge_map_of_a_one_cell_post():
    heights = np.zeros((9, 9), np.float32)
    heights[4, 4] = 0.2
    marked = np.zeros((9, 9), bool)
    marked[1:8, 4] = marked[4, 1:8] = True  # three cells to each side of the two borders, along both axes
    np.testing.assert_array_equal(edge_map(heights) == np.float32(0.2), marked)


def test_edge_stands_at_the_upper_height():
    heights = np.full((8, 1), 0.5, np.float32)
    heights[4:] = -0.5
    assert set(edge_map(heights)[1:7, 0]) == {0.5}


@pytest.mark.parametrize("drop, is_edge", [(EDGE_MIN_DROP - 0.001, False), (EDGE_MIN_DROP + 0.001, True)])
def test_small_drops_are_no_edges(drop, is_edge):
    heights = np.zeros((8, 1), np.float32)
    heights[4:] = drop
    assert np.isfinite(edge_map(heights)).any() == is_edge


def test_edges_along_x_only_ignore_y():
    along_y = np.zeros((8, 8), np.float32)
    along_y[:, 4:] = 0.3
    assert np.isinf(edge_map(along_y, "x")).all()
    assert np.isfinite(edge_map(along_y, "xy")).any()
    np.testing.assert_array_equal(edge_map(along_y.T, "x"), edge_map(along_y.T, "xy"))


def test_edge_map_against_distances_to_borders():
    # Independent and slow: every cell against every border of a random map.
    rng = np.random.default_rng(0)
    heights = rng.choice([0.0, 0.05, 0.2, 0.4], (12, 10)).astype(np.float32)
    expected = np.full(heights.shape, INF, np.float32)
    for i in range(12):
        for j in range(10):
            for k in range(11):  # border between rows k and k + 1, at k + 1 cells from the origin
                a, b = heights[k, j], heights[k + 1, j]
                if abs(a - b) > EDGE_MIN_DROP and abs((i + 0.5) - (k + 1)) * CELL <= 0.05 + 1e-9:
                    expected[i, j] = min(expected[i, j], max(a, b))
            for k in range(9):
                a, b = heights[i, k], heights[i, k + 1]
                if abs(a - b) > EDGE_MIN_DROP and abs((j + 0.5) - (k + 1)) * CELL <= 0.05 + 1e-9:
                    expected[i, j] = min(expected[i, j], max(a, b))
    np.testing.assert_array_equal(edge_map(heights), expected)


# --- difficulty ---------------------------------------------------------------------


@pytest.mark.parametrize("d, cells", [(0.0, 5), (1.0, 40)])  # 0.10 m and 0.80 m of 0.02 m cells
def test_gap_width_on_the_map(d, cells):
    heights = height_map(make_course("gap", d, 3))[:, 100]
    starts = np.flatnonzero(np.diff((heights < 0).astype(int)) == 1)
    ends = np.flatnonzero(np.diff((heights < 0).astype(int)) == -1)
    np.testing.assert_array_equal(ends - starts, [cells] * 6)


@pytest.mark.parametrize("d, cells", [(0.0, 30), (1.0, 6)])  # 0.60 m and 0.12 m
def test_beam_width_on_the_map(d, cells):
    c = make_course("beam", d, 3)
    heights = height_map(c)
    for beam in c.obstacles:
        across = heights[cell((beam.x0 + beam.x1) / 2)]
        assert (across == 0).sum() == cells
        assert np.all(across[across < 0] == np.float32(-0.2))


@pytest.mark.parametrize("d, height", [(0.0, 0.10), (1.0, 0.45)])
@pytest.mark.parametrize("kind", ["climb", "climb-up", "climb-down"])
def test_step_height_on_the_map(kind, d, height):
    steps = np.abs(np.diff(height_map(make_course(kind, d, 3))[:, 100]))
    np.testing.assert_allclose(steps[steps > 0], height, atol=1e-6)


def test_climb_up_only_rises_and_climb_down_only_falls():
    assert (np.diff(height_map(make_course("climb-up", 0.5, 1))[:, 0]) >= 0).all()
    assert (np.diff(height_map(make_course("climb-down", 0.5, 1))[:, 0]) <= 0).all()


@pytest.mark.parametrize("name, sign", [
    ("step_height", 1), ("gap_width", 1), ("pit_depth", 1), ("roughness", 1), ("beam_width", -1),
])  # fmt: skip
def test_difficulty_is_monotone(name, sign):
    values = [getattr(terrain, name)(d) for d in np.linspace(0, 1, 41)]
    assert (sign * np.diff(values) >= 0).all()
    assert values[0] != values[-1]


@pytest.mark.parametrize("kind", COURSE_KINDS)
def test_easiest_courses_are_not_inside_out(kind):
    c = make_course(kind, EASIEST[kind], 0)
    assert all(b.x0 < b.x1 and b.y0 < b.y1 for b in c.boxes)
    assert all(o.x0 <= o.x1 for o in c.obstacles)
    heights, signs = height_map(c)[:, 100], {"climb-up": 1, "climb-down": -1}
    for o in c.obstacles:
        if o.skill in signs:
            assert signs[o.skill] * (heights[cell(o.x0)] - heights[cell(o.x0) - 1]) > 0


@pytest.mark.parametrize("kind", COURSE_KINDS)
def test_difficulties_out_of_range_are_refused(kind):
    for d in (EASIEST[kind] - 0.01, 1.01, float("nan")):
        with pytest.raises(ValueError, match="outside"):
            make_course(kind, d)


def test_walk_stays_within_its_roughness():
    for d, height in ((0.0, 0.02), (1.0, 0.06)):
        heights = height_map(make_course("walk", d, 5))[cell(START_LENGTH) :]
        assert 0.5 * height < np.ptp(heights) <= height + 1e-6


# --- courses ------------------------------------------------------------------------


def test_waypoints_lie_on_walkable_boxes():
    for kind, c in all_courses():
        assert c.waypoints.shape == (NUM_WAYPOINTS, 2)
        for x, y in c.waypoints:
            assert any(b.walkable and b.x0 <= x <= b.x1 and b.y0 <= y <= b.y1 for b in c.boxes), (kind, x, y)


def test_waypoints_lead_forward():
    for kind, c in all_courses():
        assert (np.diff(c.waypoints[:, 0]) > 0).all(), kind


@pytest.mark.parametrize("kind", COURSE_KINDS)
def test_same_seed_same_course(kind):
    a, b, other = (make_course(kind, 0.5, seed) for seed in (7, 7, 8))
    assert a.boxes == b.boxes
    np.testing.assert_array_equal(a.waypoints, b.waypoints)
    assert a.boxes != other.boxes


def test_unknown_kind_is_refused():
    with pytest.raises(ValueError, match="unknown course kind"):
        make_course("stairs", 0.5)


# --- oracle regions -----------------------------------------------------------------


def test_region_map_by_hand():
    regions = region_map(course([lane(0, 18, 0.0)], [Obstacle(5.0, 5.4, "leap")]))
    first, last = cell(5.0 - LEAD["leap"]), cell(5.4 + TAIL["leap"])
    assert (regions[:first] == WALK).all()
    assert (regions[first:last] == LEAP).all()
    assert (regions[last:] == WALK).all()


def test_an_obstacle_keeps_its_tail():
    # The leap's lead would begin before the tail of the step ends.
    obstacles = [Obstacle(5.0, 5.0, "climb-up"), Obstacle(5.6, 6.0, "leap")]
    assert 5.6 - LEAD["leap"] < 5.0 + TAIL["climb-up"]
    regions = region_map(course([lane(0, 18, 0.0)], obstacles))
    border = cell(5.0 + TAIL["climb-up"])
    assert (regions[cell(5.0) : border] == UP).all()
    assert (regions[border : cell(6.0)] == LEAP).all()


def test_regions_cover_every_obstacle():
    for kind, c in all_courses():
        regions = region_map(c)
        for o in c.obstacles:
            claimed = regions[cell(o.x0) : max(cell(o.x1), cell(o.x0) + 1)]
            assert (claimed == SKILLS.index(o.skill)).all(), (kind, o)


def test_walk_needs_one_skill_only():
    assert (region_map(make_course("walk", 1.0, 0)) == WALK).all()


# --- support ------------------------------------------------------------------------


def test_support_bridges_a_pit_at_the_lower_bank():
    pit = course([lane(0, 5, 0.0), lane(5, 6, -1.0, walkable=False), lane(6, 18, 0.2)])
    support = support_map(pit, body_reach=0.4)
    assert (support[: cell(6.4)] == 0.0).all()  # banks at 0 and 0.2; the rear feet may be 0.4 m behind
    np.testing.assert_array_equal(support[cell(6.4) + 1 :], np.float32(0.2))


def test_support_ignores_the_ground_beside_a_beam():
    assert (support_map(make_course("beam", 1.0, 0)) == 0.0).all()


def test_support_never_exceeds_the_surface_to_walk_on():
    for kind, c in all_courses(seeds=(0,)):
        support = support_map(c)
        for x, y in c.waypoints:
            assert support[cell(x)] <= height_map(c)[cell(x), cell(y + LANE_WIDTH / 2)] + 1e-6, kind


# --- world --------------------------------------------------------------------------


def test_world_stacks_its_courses():
    courses = [make_course(kind, 0.5, 0) for kind in COURSE_KINDS]
    world = World(courses)
    c, (nx, ny) = len(courses), GRID_SHAPE
    assert len(world) == c
    assert world.heights.shape == world.edges.shape == (c, nx, ny)
    assert world.regions.shape == world.support.shape == world.over_beam.shape == (c, nx)
    assert world.waypoints.shape == (c, NUM_WAYPOINTS, 2)
    assert list(world.kinds) == list(COURSE_KINDS)
    assert (world.difficulties == 0.5).all()
    np.testing.assert_array_equal(world.heights[3], height_map(courses[3]))


def test_world_over_beam_spans_the_beams():
    c = make_course("beam", 0.5, 0)
    over = World([c]).over_beam[0]
    assert over.sum() == sum(cell(o.x1) - cell(o.x0) for o in c.obstacles)
    assert all(over[cell((o.x0 + o.x1) / 2)] for o in c.obstacles)
    assert not World([make_course("gap", 0.5, 0)]).over_beam.any()


def test_world_edges_option():
    both, along_x = (World([make_course("beam", 1.0, 0)], edges=e).edges for e in ("xy", "x"))
    assert np.isfinite(both).sum() > np.isfinite(along_x).sum() > 0


def test_cells_clip_to_the_lane():
    world = World([make_course("walk", 0.0, 0)])
    i, j = world.cells(np.array([-1.0, 0.01, 9.01, 99.0]), np.array([-9.0, -1.99, 0.01, 9.0]))
    np.testing.assert_array_equal(i, [0, 0, 450, GRID_SHAPE[0] - 1])
    np.testing.assert_array_equal(j, [0, 0, 100, GRID_SHAPE[1] - 1])


def test_an_empty_world_is_refused():
    with pytest.raises(ValueError, match="at least one"):
        World([])


def test_scan_map_is_the_mean_of_a_patch():
    heights = np.zeros((20, 12), np.float32)
    heights[10:, 5] = 0.49  # a wall one cell thick from x = 10 on
    scan = scan_map(heights)
    # Over 7 x 7 cells the wall takes k of 7 rows and 1 of 7 columns: 0.49 k / 49
    assert scan[6, 5] == 0.0
    assert scan[7, 5] == pytest.approx(0.01)
    assert scan[12, 2] == pytest.approx(0.06)
    assert scan[14, 8] == pytest.approx(0.07)
    assert scan[14, 9] == scan[14, 1] == 0.0
    np.testing.assert_allclose(scan_map(np.full((20, 12), 0.3, np.float32)), 0.3, rtol=1e-6)


# --- heights, along the lane ----------------------------------------------------------------


def heights_along(kind, d):
    """Heights [m] of the surfaces that a robot meets on y = 0, in order."""
    heights = height_map(make_course(kind, d, 5))[:, GRID_SHAPE[1] // 2]
    return heights[np.flatnonzero(np.diff(heights, prepend=np.nan) != 0)].round(3).tolist()


@pytest.mark.parametrize("kind, levels", [
    ("climb-up", [0, 1, 2, 3, 4, 5, 6]),
    ("climb-down", [0, -1, -2, -3, -4, -5, -6]),
    ("climb", [0, 1, 2, 3, 2, 1, 0]),  # the third tread is followed by another of its height
])  # fmt: skip
def test_steps_rise_and_fall_by_the_step_height(kind, levels):
    h = terrain.step_height(1.0)
    assert heights_along(kind, 1.0) == pytest.approx([level * h for level in levels], abs=1e-3)


def test_climb_gap_goes_up_over_down_up_over_down_over():
    """ugudgd: a pit's floor lies pit_depth below the start platform, however high its banks."""
    h, pit = terrain.step_height(1.0), -terrain.pit_depth(1.0)
    assert heights_along("climb-gap", 1.0) == pytest.approx([0, h, pit, h, 2 * h, h, pit, h, 0], abs=1e-3)


def test_obstacles_of_gaps_span_them():
    course = make_course("gap", 0.5, 0)
    assert [o.x1 - o.x0 for o in course.obstacles] == pytest.approx([terrain.gap_width(0.5)] * 6)


def test_treads_hold_a_robot_behind_the_step():
    """0.5 m and the step height at least, where the robot pitches up."""
    for seed in range(20):
        xs = [o.x0 for o in make_course("climb-up", 1.0, seed).obstacles]
        assert np.diff(xs).min() >= 0.5 + terrain.step_height(1.0) - 0.02


def test_regions_by_numbers():
    obstacles = [
        Obstacle(3.0, 3.0, "climb-up"),
        Obstacle(6.0, 6.0, "climb-down"),
        Obstacle(9.0, 9.4, "leap"),
        Obstacle(12.0, 13.0, "beam"),
    ]
    regions = region_map(course([lane(0, 18, 0.0)], obstacles))
    borders = (np.flatnonzero(np.diff(regions)) + 1) * 0.02
    np.testing.assert_allclose(borders, [2.2, 3.46, 5.2, 6.46, 8.0, 9.76, 11.6, 13.3], atol=0.021)


def test_support_reaches_a_robots_length():
    support = support_map(course([lane(0, 5, 0.0), lane(5, 18, 0.3)]))
    assert support[cell(5.42)] == 0.0 and support[cell(5.48)] == np.float32(0.3)


@pytest.mark.parametrize("drop, is_edge", [(0.07, False), (0.08, True)])
def test_edges_drop_seven_and_a_half_centimetres(drop, is_edge):
    heights = np.zeros((8, 1), np.float32)
    heights[4:] = drop
    assert np.isfinite(edge_map(heights)).any() == is_edge


def test_the_two_tiles_of_a_row_differ():
    boxes = make_course("walk", 1.0, 0).boxes[1:]
    assert all(a.top != b.top for a, b in zip(boxes[::2], boxes[1::2], strict=True))

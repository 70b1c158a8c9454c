"""Wrong answers to assignment 1."""

from mutants import Mutant

FILE = "hw1/maps.py"

MUTANTS = (
    Mutant(
        "the last box wins",
        FILE,
        (("np.fmax(heights[cells], top)", "top"),),
        "test_heights_by_hand",
        "the lower one last",
    ),
    Mutant(
        "holes at height 0",
        FILE,
        (("heights = np.full((ny, nx), np.nan)", "heights = np.zeros((ny, nx))"),),
        "test_heights_of_random_boxes",
        "NaN where none is",
    ),
    Mutant(
        "x first",
        FILE,
        (("        heights[cells] = np.fmax(heights[cells], top)\n    return heights\n", "        heights[cells] = np.fmax(heights[cells], top)\n    return heights.T\n"),),
        "test_heights_by_hand",
        "the first axis is y",
    ),
    Mutant(
        "edges along x only",
        FILE,
        (("for axis in (0, 1):", "for axis in (1,):"),),
        "test_edges_by_hand",
        "a step along y",
    ),
    Mutant(
        "the upper side only",
        FILE,
        (("            marked[: len(border) - k] |= border[k:]  # k cells before the border\n", ""),),
        "test_edges_by_hand",
        "a step along x",
    ),
    Mutant(
        "reach counted in whole cells",
        FILE,
        (("reach / lane.cell + 0.5 + 1e-9", "reach / lane.cell"),),
        "test_edges_by_hand",
        "0.6 cells",
    ),
    Mutant(
        "no edge at a hole",
        FILE,
        (("np.where(np.isnan(heights), -1e9, heights)", "heights"),),
        "test_edges_of_random_ground",
        "holes",
    ),
    Mutant(
        "the later claim wins",
        FILE,
        (("max(x0 - lead, first) <= x) & (x <= min(x1 + tail, last)", "x0 - lead <= x) & (x <= x1 + tail"),),
        "test_regions_by_hand",
        "neither goes beyond the middle",
    ),
    Mutant(
        "obstacles taken in the order given",
        FILE,
        (("obstacles[np.argsort(obstacles[:, 0])]", "obstacles"),),
        "test_regions_of_random_obstacles",
        "in any order",
    ),
    Mutant(
        "turned the wrong way",
        FILE,
        (
            ("np.cos(yaw) * dx - np.sin(yaw) * dy", "np.cos(yaw) * dx + np.sin(yaw) * dy"),
            ("y + np.sin(yaw) * dx", "y - np.sin(yaw) * dx"),
        ),
        "test_scandots_by_hand",
        "facing to the left",
    ),
    Mutant(
        "negative indices wrap around",
        FILE,
        (
            ("np.clip(np.floor(px / lane.cell).astype(int), 0, nx - 1)", "np.floor(px / lane.cell).astype(int) % nx"),
            ("np.clip(np.floor(py / lane.cell).astype(int), 0, ny - 1)", "np.floor(py / lane.cell).astype(int) % ny"),
        ),
        "test_scandots_beside_the_lane",
        "nearest cell of the lane",
    ),
    Mutant(
        "agility_ref's own functions",
        FILE,
        (("    ny, nx = lane.shape\n    x = (np.arange(nx)", "    from agility_ref import world\n\n    return world.height_map(boxes)\n    x = (np.arange(nx)"),),
        "test_heights_by_hand",
        "agility_ref's own are others",
    ),
)  # fmt: skip

"""Wrong answers to assignment 2."""

from mutants import Mutant

FILE = "hw2/task.py"

MUTANTS = (
    Mutant(
        "speed in space, not on the ground",
        FILE,
        (("    v = log.velocity[..., :2]\n", "    v = log.velocity\n"), ("towards = (v * to_goal)", "towards = (v[..., :2] * to_goal)")),
        "test_terms_by_hand",
        "only the horizontal speed counts",
    ),
    Mutant(
        "divided by the command alone",
        FILE,
        (("np.maximum(np.linalg.norm(v, axis=-1), log.command)", "log.command"),),
        "test_terms_by_hand",
        "earns no more than 1",
    ),
    Mutant(
        "angle not wrapped",
        FILE,
        (("np.abs((error + np.pi) % (2 * np.pi) - np.pi)", "np.abs(error + 2 * np.pi)"),),
        "test_terms_by_hand",
        "a quarter turn",
    ),
    Mutant(
        "real part first",
        FILE,
        (
            ("    x, y, z, w = np.moveaxis(log.quaternion, -1, 0)\n    yaw", "    w, x, y, z = np.moveaxis(log.quaternion, -1, 0)\n    yaw"),
        ),
        "test_terms_by_hand",
        "a quarter turn|turned to its left",
    ),
    Mutant(
        "the world's z axis",
        FILE,
        (("(log.velocity * up).sum(-1) ** 2", "log.velocity[..., 2] ** 2"),),
        "test_bounce_is_the_trunks",
        "use the trunk's frame",
    ),
    Mutant(
        "action carried over from the last episode",
        FILE,
        (("    before = np.where(log.start[..., None], 0.0, before)\n", ""),),
        "test_first_steps",
        "the action was 0",
    ),
    Mutant(
        "squared norm",
        FILE,
        (("np.linalg.norm(log.action - before, axis=-1)", "((log.action - before) ** 2).sum(-1)"),),
        "test_recording_term_by_term",
        "jerk differs",
    ),
    Mutant(
        "all feet must stumble",
        FILE,
        ((".any(-1).astype(float)", ".all(-1).astype(float)"),),
        "test_terms_by_hand",
        "a stumble",
    ),
    Mutant(
        "time near a waypoint summed up",
        FILE,
        (("timer = (timer + 1) * near", "timer = timer + near"),),
        "test_waypoints_by_hand",
        "in a row",
    ),
    Mutant(
        "time not counted anew",
        FILE,
        (("arrived = (timer == hold)", "arrived = (timer >= hold)"), ("        timer[arrived] = 0\n", "")),
        "test_waypoints_of_random_paths",
        "in a row",
    ),
    Mutant(
        "any turn counts as tilt",
        FILE,
        (("tilt = np.arccos(np.clip(w**2 - x**2 - y**2 + z**2, -1.0, 1.0))", "tilt = 2 * np.arccos(np.clip(np.abs(w), 0.0, 1.0))"),),
        "test_falls_by_hand",
        "turned, but upright",
    ),
    Mutant(
        "a fall in the last step counts",
        FILE,
        (("terminated = fell & ~finished", "terminated = fell"), ("truncated = finished | (late & ~terminated)", "truncated = (finished | late) & ~terminated")),
        "test_ends_by_hand",
        "finishes in step 3, falling",
    ),
    Mutant(
        "one step too many",
        FILE,
        ((">= limit - 1", ">= limit"),),
        "test_ends_at_random",
        "limit is 35 steps",
    ),
    Mutant(
        "agility_ref's own functions",
        FILE,
        (("    v = log.velocity[..., :2]\n", "    from agility_ref import rewards\n\n    return rewards.tracking_goal_vel(log)\n    v = log.velocity[..., :2]\n"),),
        "test_terms_by_hand",
        "agility_ref's own are others",
    ),
)  # fmt: skip

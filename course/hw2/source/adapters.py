"""What the tests call.  Change a line here if you put a function somewhere else."""

from hw2.task import Log, bounce, drag, ends, facing, fallen, goal_speed, jerk, stumble, waypoints_reached

ASSIGNMENT = "hw2"
__all__ = [
    "Log", "bounce", "drag", "ends", "facing", "fallen", "goal_speed", "jerk", "stumble", "waypoints_reached",
]  # fmt: skip

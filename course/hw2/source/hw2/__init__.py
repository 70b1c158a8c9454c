"""Assignment 2: what the robot is asked to do."""

import agility_ref  # noqa: F401  (before numpy)

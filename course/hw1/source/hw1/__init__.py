"""Assignment 1: terrain as maps."""

import agility_ref  # noqa: F401  (before numpy)

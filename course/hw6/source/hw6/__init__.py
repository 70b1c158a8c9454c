"""Assignment 6: what may be claimed."""

import agility_ref  # noqa: F401  (before numpy)

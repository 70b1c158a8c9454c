"""Assignment 5: which skill, where?"""

import agility_ref  # noqa: F401  (before numpy and torch)

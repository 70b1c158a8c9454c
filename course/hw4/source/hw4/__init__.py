"""Assignment 4: half of a robot is enough, and what to practise next."""

import agility_ref  # noqa: F401  (before numpy and torch)

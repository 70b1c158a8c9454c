"""Assignment 3: PPO, and a robot that walks."""

import agility_ref  # noqa: F401  (before numpy and torch)

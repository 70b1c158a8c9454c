"""One generalist policy, or a bank of specialists?  A small, readable reproduction.

Start at :mod:`agility_ref.terrain`; every module imports only from those above it:
terrain, go1, rewards, curriculum, env, checkpoint, networks, ppo, policies, selector,
evaluate, stats, plots, runs, table1, cli.
"""

__version__ = "0.1.0"

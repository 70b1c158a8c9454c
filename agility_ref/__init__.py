"""One generalist policy, or a bank of specialists?  A small, readable reproduction.

Start at :mod:`agility_ref.terrain`; every module imports only from those above it:
terrain, go1, rewards, curriculum, env, checkpoint, networks, ppo, policies, selector,
evaluate, stats, plots, runs, table1, cli.
"""

import os

# Read by the numerical libraries when they are loaded.  Networks of 128 units gain nothing from
# more threads, and threads that spin while they wait take the simulation's cores.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__version__ = "0.1.0"

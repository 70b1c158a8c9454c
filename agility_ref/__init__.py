"""One generalist policy, or a bank of specialists?  A small, readable reproduction.

Start at :mod:`agility_ref.terrain`; every module imports only from those before it:
errors, terrain, world, go1, rewards, observation, task, curriculum, placement, simulation, env,
checkpoint, policies, progress, weights, networks, learner, ppo, selector, evaluate, stats, plots, runs,
cells, table1, table_output, verdicts, evidence, findings, trace, odd_behaviours, diagnosis;
then the pictures: diagnosis_figures, record, gait, scene, silhouette, pictures, panels, gallery,
graphics, video, viewer, window; and last cli_diagnose, cli_pictures and cli.
"""

import os

# Read by the numerical libraries when they are loaded.  Networks this small gain nothing from
# more threads, and threads that spin while they wait take the simulation's cores.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__version__ = "0.1.0"

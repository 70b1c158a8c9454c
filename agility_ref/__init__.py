"""One generalist policy, or a bank of specialists?  A small, readable reproduction.

Start at :mod:`agility_ref.terrain`; every module imports only from those before it:
errors, terrain, world, go1, rewards, observation, task, curriculum, placement, simulation, env,
checkpoint, policies, progress, weights, networks, learner, ppo, selector, evaluate, stats, plots, runs,
cells, table1, table_output, verdicts, evidence, findings, trace, odd_behaviours, diagnosis;
then the pictures: diagnosis_figures, record, gait, scene, silhouette, pictures, panels, gallery,
graphics, video, viewer, window; and last cli_diagnose, cli_pictures and cli.
"""

import os
import platform

# Read by the numerical libraries when they are loaded.  Networks this small gain nothing from
# more threads, and threads that spin while they wait take the simulation's cores.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# With AVX-512 numpy and its OpenBLAS round otherwise than without, and one robot that falls a step earlier changes
# every number of its episode.  Without it, all x86 processors since 2013 print the same Table 1.
if platform.machine() in ("x86_64", "AMD64"):
    os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")
    os.environ.setdefault("NPY_DISABLE_CPU_FEATURES", "X86_V4 AVX512_ICL AVX512_SPR")

__version__ = "0.1.0"

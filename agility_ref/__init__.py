"""One generalist policy, or a bank of specialists?  A small, readable reproduction.

The files of this folder are the paper, in the order terrain, world, go1, simulation, rewards,
observation, env, curriculum, policy, networks, ppo, selector, evaluate: each imports only from
those before it (and from errors, stats and files).  Four rooms hold the rest, each of which imports
only from the core and the rooms before it: training, pictures, results, cli.  gym is the adapter
for Gymnasium, over the core and pictures.
"""

import os
import platform
import sys
import warnings

# Read by the numerical libraries when they are loaded, so import this package before numpy.  Networks this small gain
# nothing from more threads, and threads that spin while they wait take the simulation's cores.
_SETTINGS = {"OMP_WAIT_POLICY": "PASSIVE", "OPENBLAS_NUM_THREADS": "1"}
# With AVX-512 numpy and its OpenBLAS round otherwise than without, and one robot that falls a step earlier changes
# every number of its episode.  Without it, all x86 processors since 2013 print the same Table 1.
if platform.machine() in ("x86_64", "AMD64"):
    _SETTINGS |= {"OPENBLAS_CORETYPE": "Haswell", "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR"}

if "numpy" in sys.modules and not _SETTINGS.keys() <= os.environ.keys():
    warnings.warn(
        "agility_ref was imported after numpy, too late to set its threads and rounding: put it first, and start anew",
        stacklevel=2,
    )
for _name, _value in _SETTINGS.items():
    os.environ.setdefault(_name, _value)

__version__ = "0.1.0"

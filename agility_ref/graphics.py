"""Which OpenGL renders without a display; asked before mujoco is imported.

MuJoCo reads the environment variable MUJOCO_GL once, when it is imported.  So this module
imports nothing of the kind, and the command line asks it first.
"""

import ctypes
import os
import sys

from agility_ref.errors import UserError

LIBRARIES = {"egl": ("libEGL.so.1", "libGL.so.1"), "osmesa": ("libOSMesa.so.8",)}  # Debian's names, in order
ADVICE = (
    "no OpenGL without a display here; on Debian: apt install libegl1 libgl1 (or libosmesa6); "
    "`agility-ref plot strobe` needs none"
)


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def choose_gl() -> str:
    """Set MUJOCO_GL unless it is set: EGL where it loads, else OSMesa; return the choice.

    Raises
    ------
    UserError : neither library is there
    """
    if "MUJOCO_GL" in os.environ or not sys.platform.startswith("linux"):
        return os.environ.get("MUJOCO_GL", "")
    for backend, libraries in LIBRARIES.items():
        if all(map(_loads, libraries)):
            os.environ["MUJOCO_GL"] = backend
            os.environ.setdefault("PYOPENGL_PLATFORM", backend)
            return backend
    raise UserError(ADVICE)

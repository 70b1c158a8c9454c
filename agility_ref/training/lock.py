"""Lock: one process at a time writes into a folder.

The lock is the operating system's, on a file beside the folder: it ends with the process that
holds it, however that ends, so that nothing has to be cleaned up after a crash.  Some network
file systems know no locks; there nobody is kept out.

In:  a folder.  Out: a context in which it is ours.
"""

import errno
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from agility_ref.errors import UserError

NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS)  # what a file system without locks answers
POLL_SECONDS = 0.5


def lock_path(folder: Path) -> Path:
    """Return the file that stands for a folder: beside it, for the folder itself may be renamed."""
    folder = Path(os.path.abspath(folder))
    return folder.with_name(f".{folder.name}.lock")


@contextmanager
def locked(folder: Path, wait: bool = False, quiet: bool = True) -> Iterator[None]:
    """Keep other processes, and other threads, out of a folder for the length of a block.

    Parameters
    ----------
    folder : need not exist
    wait : wait until it is free; otherwise refuse
    quiet : do not say that we wait

    Raises
    ------
    UserError : somebody else holds it
    """
    path = lock_path(folder)
    path.parent.mkdir(parents=True, exist_ok=True)
    file = _take(path)
    if file is None:
        holder = f"{folder} is being written by another process{_holder(path)}"
        if not wait:
            raise UserError(f"{holder}; wait for it, or give another folder")
        if not quiet:
            print(f"{holder}: waiting for it", flush=True)
        while file is None:
            time.sleep(POLL_SECONDS)
            file = _take(path)
    try:
        with suppress(OSError):  # of a full disk: then nobody is told who holds it
            os.ftruncate(file.fileno(), 0)
            os.write(file.fileno(), str(os.getpid()).encode())
        yield
    finally:
        with suppress(PermissionError):  # on Windows, where an open file cannot be deleted
            path.unlink(missing_ok=True)  # while we hold it: nobody else's is deleted
        file.close()


def _take(path: Path) -> IO[bytes] | None:
    """Return the open, locked file, or None where somebody else has locked it."""
    while True:
        file = open(path, "a+b")
        try:
            _lock(file)
            if os.path.samestat(os.fstat(file.fileno()), os.stat(path)):
                return file
        except FileNotFoundError:  # its holder deleted it between our opening and our locking it
            pass
        except OSError as error:
            if error.errno in NO_LOCKS:
                return file
            file.close()
            if isinstance(error, BlockingIOError | PermissionError):
                return None
            raise
        file.close()


def _lock(file: IO[bytes]) -> None:
    """Lock an open file without waiting; raise OSError where it is locked."""
    try:
        import fcntl
    except ImportError:  # Windows: one byte far behind the text, which others may read
        import msvcrt

        file.seek(2**30)
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
    else:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _holder(path: Path) -> str:
    try:
        number = path.read_text(encoding="ascii", errors="replace").strip()
    except OSError:
        return ""
    return f" ({number})" if number.isdecimal() else ""

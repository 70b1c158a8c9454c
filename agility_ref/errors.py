"""The one exception for mistakes of the person at the keyboard.

The command line prints its message on one line and exits with status 2; every other
exception is a fault of ours and keeps its traceback.
"""

import difflib
from collections.abc import Iterable

MANY = 2**24  # more robots, steps or units than any machine holds
MAX_SEED = 2**63 - 1  # beyond it torch and JSON lose digits, or fail


class UserError(Exception):  # not a ValueError, of which tyro would make a frame of several lines
    """What was given, and what is allowed, in one line."""


def require_at_least(least: float, most: float = float("inf"), /, **given: float) -> None:
    """Refuse numbers of a configuration that would divide by zero, loop for ever or fill the memory.

    Raises
    ------
    UserError : names the first field that is less than ``least``, more than ``most``, or not finite
    """
    for name, value in given.items():
        if not least <= value < float("inf"):
            raise UserError(f"{name.replace('_', '-')} must be a number of at least {least:g}, not {value}")
        if value > most:
            raise UserError(f"{name.replace('_', '-')} must be at most {most:g}, not {value}")


def require_pairs(hidden: tuple[int, ...]) -> None:
    """Refuse layers of an odd number of units with a UserError: half of them see the mirrored world."""
    if not hidden or any(not 2 <= units <= MANY or units % 2 for units in hidden):
        raise UserError(f"hidden must be one or more even numbers of units, for they come in pairs, not {hidden}")


def one_line(error: object) -> str:
    r"""Return what an error or a name says, without line breaks and whatever else a file may have put into it.

    >>> one_line(ValueError("no array\n\x1b[2J of that name"))
    'no array [2J of that name'
    """
    words = "".join(c if c.isprintable() else " " for c in str(error)).split()
    return " ".join(words)[:1000]


def unknown_name(what: str, given: str, allowed: Iterable[str]) -> UserError:
    """Return the error for a name that is not in ``allowed``, nearest names first."""
    allowed = list(allowed)
    near = difflib.get_close_matches(given, allowed, n=3, cutoff=0.4)
    hint = f"did you mean {' or '.join(near)}?" if near else f"choose from {', '.join(allowed)}"
    return UserError(f"unknown {what} {given!r}: {hint}")

"""The student's copy of an assignment: starter code, handout and public tests.

The source is marked as nbgrader's is: lines from ``### BEGIN SOLUTION`` to ``### END SOLUTION``
become a line that says what is missing.
"""

import shutil
from pathlib import Path

from agility_ref.errors import UserError
from course.assignment import Assignment

BEGIN, END = "### BEGIN SOLUTION", "### END SOLUTION"
STUB = ("# YOUR CODE HERE", "raise NotImplementedError")


def starter(source: str) -> str:
    r"""Return a marked source without its solutions.

    Raises
    ------
    ValueError : a mark without its partner

    Examples
    --------
    >>> print(starter("def f(x):\n    ### BEGIN SOLUTION\n    return 2 * x\n    ### END SOLUTION\n"), end="")
    def f(x):
        # YOUR CODE HERE
        raise NotImplementedError
    """
    lines, inside = [], False
    for line in source.splitlines():
        mark = line.strip()
        if mark in (BEGIN, END):
            if inside == (mark == BEGIN):
                raise ValueError(f"{mark} without its partner")
            inside = not inside
            if inside:
                indent = line[: len(line) - len(line.lstrip())]
                lines += [indent + stub for stub in STUB]
        elif not inside:
            lines.append(line)
    if inside:
        raise ValueError(f"{BEGIN} without its partner")
    return "\n".join(lines) + "\n"


def solved(source: str) -> str:
    """Return a marked source with its solutions, without the marks."""
    return "".join(line for line in source.splitlines(keepends=True) if line.strip() not in (BEGIN, END))


def release(assignment: Assignment, out: Path, solution: bool = False) -> list[Path]:
    """Write the student's copy, or the model solution, into a new folder; return the files.

    Raises
    ------
    UserError : ``out`` exists and is not an empty folder
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UserError(f"{out} exists already and is not empty: name a new folder")
    written = []
    for path, text in assignment.sources.items():
        written.append(out / path)
        written[-1].parent.mkdir(parents=True, exist_ok=True)
        written[-1].write_text(solved(text) if solution else starter(text), encoding="utf-8")
    written.append(out / "handout.md")
    written[-1].write_text(assignment.handout, encoding="utf-8")
    (out / "tests").mkdir()
    for path in assignment.tests(hidden=False):
        name = "conftest.py" if path.name == "conftest_for_students.py" else path.name
        written.append(out / "tests" / name)
        shutil.copy(path, written[-1])
    return written

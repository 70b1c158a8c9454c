"""Wrong answers: what students really write, as replacements in the model solution.

Each loses points on the test that it names, with a message that says what is wrong.
"""

import importlib
from dataclasses import dataclass
from pathlib import Path

from course.assignment import Assignment
from course.release import release


@dataclass(frozen=True)
class Mutant:
    """One wrong answer."""

    name: str
    """What was done wrong, a few words; docs/instructors.md lists it under this name."""
    file: str
    """In which file of the student's package."""
    replacements: tuple[tuple[str, str], ...]
    """Text of the solution, and what stands there instead."""
    test: str
    """The test function that loses points."""
    message: str
    """Regular expression found in that test's message."""


def write(mutant: Mutant, assignment: Assignment, out: Path) -> None:
    """Write the model solution with this mistake into the folder ``out``."""
    release(assignment, out, solution=True)
    path = out / mutant.file
    text = path.read_text(encoding="utf-8")
    for right, wrong in mutant.replacements:
        assert text.count(right) == 1, f"{mutant.name}: {right!r} is there {text.count(right)} times"
        text = text.replace(right, wrong)
    path.write_text(text, encoding="utf-8")


def of(name: str) -> tuple[Mutant, ...]:
    """Return the wrong answers to an assignment."""
    return importlib.import_module(f"mutants_{name}").MUTANTS

"""Where the parts of an assignment lie, and what its tests are worth."""

import csv
import re
from dataclasses import dataclass
from pathlib import Path

from agility_ref.errors import unknown_name

HERE = Path(__file__).parent
NAMES = tuple(path.parent.name for path in sorted(HERE.glob("hw*/handout.md")))
POINTS_ROW = re.compile(r"^\| `(test_\w+)` \| (\d+) \|", re.MULTILINE)


@dataclass(frozen=True)
class Assignment:
    """One assignment, by its name."""

    name: str

    @property
    def folder(self) -> Path:
        """Where it lies in the repository."""
        return HERE / self.name

    @property
    def points(self) -> dict[str, int]:
        """What every test function is worth: the table in the handout."""
        return {test: int(points) for test, points in POINTS_ROW.findall(self.handout)}

    @property
    def handout(self) -> str:
        """The sheet that students get."""
        return (self.folder / "handout.md").read_text(encoding="utf-8")

    @property
    def training(self) -> dict[str, float]:
        """Budget and threshold of the test that trains a robot: training.csv, empty where there is none."""
        path = self.folder / "tests" / "training.csv"
        if not path.exists():
            return {}
        with path.open(newline="", encoding="utf-8") as file:
            return {row["name"]: float(row["value"]) for row in csv.DictReader(file)}

    @property
    def sources(self) -> dict[Path, str]:
        """The marked files by their path in a student's copy."""
        files = sorted((self.folder / "source").rglob("*.py"))
        return {path.relative_to(self.folder / "source"): path.read_text(encoding="utf-8") for path in files}

    def tests(self, hidden: bool) -> list[Path]:
        """Return the files of the public tests and what they need, and of the hidden ones on demand."""
        folders = ("tests", "hidden") if hidden else ("tests",)
        files = [path for folder in folders for path in sorted((self.folder / folder).glob("*")) if path.is_file()]
        return [HERE / "conftest_for_students.py", *files]


def find(name: str) -> Assignment:
    """Look an assignment up.

    Raises
    ------
    UserError : there is none of that name
    """
    if name not in NAMES:
        raise unknown_name("assignment", name, NAMES)
    return Assignment(name)

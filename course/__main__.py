"""``python -m course release | grade | threshold``; docs/instructors.md shows them at work."""

import argparse
import sys
from pathlib import Path

from agility_ref.errors import UserError
from course import assignment
from course.release import release


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    top = argparse.ArgumentParser(prog="python -m course", description="Assignments: release them, grade them.")
    commands = top.add_subparsers(dest="command", required=True)

    give = commands.add_parser("release", help="write the student's copy of an assignment")
    give.add_argument("name", help=f"one of {', '.join(assignment.NAMES)}")
    give.add_argument("--out", type=Path, required=True, help="a new folder")
    give.add_argument("--solution", action="store_true", help="the model solution instead of the starter code")

    take = commands.add_parser("grade", help="grade one submission, or a folder of folders and zips")
    take.add_argument("name", help=f"one of {', '.join(assignment.NAMES)}")
    take.add_argument("submissions", type=Path, help="a submission, or a folder with one folder or zip per student")
    take.add_argument("--csv", type=Path, help="one row per student: score, points of every test, what went wrong")
    take.add_argument("--junit", type=Path, help="pytest's JUnit file; with several students one each, x.anna.xml")
    take.add_argument("--gradescope", type=Path, help="results.json for Gradescope; likewise")
    take.add_argument("--seeds", type=int, nargs="+", help="of the tests; drawn anew and printed unless given")
    take.add_argument("--seconds", type=int, default=120, help="limit for a submission, its training apart")
    take.add_argument("--memory", type=int, default=8, help="limit for a submission [GiB]")
    take.add_argument("--only", default="", metavar="WORD", help="only tests with this in their name")
    take.add_argument("--no-training", action="store_true", help="leave out tests that train a robot")

    tune = commands.add_parser("threshold", help="train the model solution on five seeds and print what it reaches")
    tune.add_argument("name", choices=["hw3"])
    tune.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    return top


def main(arguments: list[str] | None = None) -> int:
    """Run one command; return the exit status, 2 where the user made a mistake."""
    options = parser().parse_args(arguments)
    try:
        if options.command == "release":
            files = release(assignment.find(options.name), options.out, options.solution)
            print(f"{len(files)} files in {options.out}; students start with handout.md")
        elif options.command == "grade":
            from course.grade import grade_all  # needs POSIX limits, which releasing does not

            grade_all(assignment.find(options.name), options)
        else:
            from course.threshold import measure

            measure(options.seeds)
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())

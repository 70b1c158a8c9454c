"""Grading: each submission in a process of its own, on a copy, with limits of time, memory and output.

pytest runs the public and the hidden tests; the conftest of the tests writes one line per test, and what
is here adds up points.  This is no sandbox: it keeps accidents of one submission from the others, not
an attacker from the machine.
"""

import argparse
import csv
import json
import os
import resource
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

from course.assignment import HERE, Assignment
from course.submission import Rejected, copy_submission, find_root, find_submissions, put_back

MAX_FILE = 64 * 2**20  # bytes that a submission may write into one file, its captured output included


@dataclass
class Grade:
    """What one student gets."""

    student: str
    worth: dict[str, int]
    """Points of every test function."""
    earned: dict[str, float] = field(default_factory=dict)
    messages: dict[str, str] = field(default_factory=dict)
    """Why a test failed."""
    note: str = ""
    """What the instructor should know, one line; empty if all went well."""

    @property
    def score(self) -> float:
        """Points earned."""
        return round(sum(self.earned.values()), 2)

    def gradescope(self) -> dict:
        """Return the content of Gradescope's results.json."""
        tests = [
            {
                "name": name,
                "score": round(self.earned.get(name, 0.0), 2),
                "max_score": points,
                "output": self.messages.get(name, ""),
            }
            for name, points in self.worth.items()
        ]
        return {"score": self.score, "output": self.note, "tests": tests}


def one_line(text: str, limit: int = 300) -> str:
    """Return a message on one line: pytest's explanation of an assert is left to the JUnit file."""
    text = " ".join(text.split("\nassert ")[0].split())
    return text.removeprefix("AssertionError: ")[:limit]


def _limits(memory: int) -> None:
    """Set the limits of the submission's process."""
    resource.setrlimit(resource.RLIMIT_AS, (memory * 2**30,) * 2)
    resource.setrlimit(resource.RLIMIT_FSIZE, (MAX_FILE,) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _run(command: list[str], cwd: Path, env: dict, seconds: float, memory: int) -> str:
    """Run pytest; return how it died, or nothing."""
    process = subprocess.Popen(
        command, cwd=cwd, env=env, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        start_new_session=True, preexec_fn=lambda: _limits(memory),
    )  # fmt: skip
    try:
        status = process.wait(seconds)
    except subprocess.TimeoutExpired:
        return f"stopped after {seconds:g} s"
    finally:
        try:
            os.killpg(process.pid, signal.SIGKILL)  # whatever it has started
        except ProcessLookupError:
            pass
        process.wait()
    if status < 0:
        return f"the process died of {signal.Signals(-status).name}"
    return "" if status in (0, 1, 2) else f"the process ended with status {status}"


def grade(assignment: Assignment, student: str, source: Path, options: argparse.Namespace) -> tuple[Grade, str]:
    """Grade one submission; return the grade and pytest's JUnit file, empty if pytest did not get that far."""
    worth = {
        test: points
        for test, points in assignment.points.items()
        if options.only in test and not (options.no_training and test.startswith("test_training"))
    }
    with tempfile.TemporaryDirectory(prefix="course-", ignore_cleanup_errors=True) as scratch:
        work = Path(scratch)
        result = Grade(student, worth)
        try:
            copy_submission(source, work / "submission")
            root = find_root(work / "submission", assignment)
            put_back(root, assignment)
        except Rejected as reason:
            result.note = one_line(str(reason))
            return result, ""
        (work / "tests").mkdir()
        for path in assignment.tests(hidden=True):
            name = "conftest.py" if path.name == "conftest_for_students.py" else path.name
            shutil.copy(path, work / "tests" / name)
        (work / "tests" / "pytest.ini").write_text("[pytest]\n")
        report, junit = work / "report.jsonl", work / "junit.xml"
        seeds = " ".join(map(str, options.seeds))
        own = {"COURSE_SUBMISSION": str(root), "COURSE_SEEDS": seeds, "COURSE_REPORT": str(report)}
        path = os.pathsep.join(filter(None, [str(HERE.parent), os.environ.get("PYTHONPATH")]))
        env = os.environ | own | {"PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1", "MPLBACKEND": "Agg"}
        command = [
            sys.executable, "-P", "-m", "pytest", str(work / "tests"), "-q", "-c", str(work / "tests" / "pytest.ini"),
            "-p", "no:cacheprovider", f"--junit-xml={junit}", "--show-capture=no", "--tb=short", "--color=no",
        ]  # fmt: skip
        if options.no_training:
            command += ["-m", "not training"]
        if options.only:
            command += ["-k", options.only]
        seconds = options.seconds + (0 if options.no_training else assignment.training.get("seconds", 0))
        death = _run(command, root, env, seconds, options.memory)
        _add_up(result, _read(report), death)
        return result, junit.read_text(encoding="utf-8") if junit.exists() else ""


def _read(report: Path) -> list[dict]:
    """Return the lines of the conftest; the last may be torn where the process died."""
    lines = []
    for line in report.read_text(encoding="utf-8", errors="replace").splitlines() if report.exists() else []:
        try:
            lines.append(json.loads(line))
        except json.JSONDecodeError:
            break
    return lines


def _add_up(result: Grade, lines: list[dict], death: str) -> None:
    """Turn the lines of the conftest into points: a function earns the share of its cases that passed."""
    cases: dict[str, dict[str, str]] = defaultdict(dict)  # test function -> case -> outcome
    broken = [line["message"] for line in lines if line["test"] is None]
    for line in lines:
        if line["test"] is None:
            continue
        case = line["test"].split("::")[-1]
        name = case.split("[")[0]
        cases[name][case] = line["outcome"]  # a later one, of the same case, is worse
        if line["outcome"] not in ("started", "passed"):
            result.messages.setdefault(name, one_line(line["message"]))
    for name, points in result.worth.items():
        outcomes = list(cases[name].values())
        result.earned[name] = points * outcomes.count("passed") / max(len(outcomes), 1)
        if "started" in outcomes or not outcomes:
            result.messages.setdefault(name, death or "was not run")
    failed = [name for name in result.worth if result.earned[name] < result.worth[name]]
    if broken:  # the last line that pytest marks as the error says what is wrong
        errors = [line for line in broken[0].splitlines() if line.startswith("E  ")]
        result.note = one_line(f"cannot be imported: {errors[-1][4:] if errors else broken[0]}")
    elif death:
        result.note = death
    elif failed:
        result.note = one_line(
            f"{len(failed)} of {len(result.worth)} tests fail; {failed[0]}: {result.messages[failed[0]]}"
        )


def _own_file(path: Path, student: str, several: bool) -> Path:
    return path.with_name(f"{path.stem}.{student}{path.suffix}") if several else path


def grade_all(assignment: Assignment, options: argparse.Namespace) -> list[Grade]:
    """Grade every submission, print a line each and write the files that were asked for."""
    submissions = find_submissions(options.submissions)
    if options.seeds is None:
        options.seeds = [secrets.randbelow(1_000_000) for _ in range(3)]
    print(f"{assignment.name}, seeds {' '.join(map(str, options.seeds))} (--seeds to grade again with the same)")
    grades = []
    for student, source in submissions.items():
        result, junit = grade(assignment, student, source, options)
        grades.append(result)
        total = sum(result.worth.values())
        print(f"{student}: {result.score:g} of {total}{'  ' + result.note if result.note else ''}", flush=True)
        several = len(submissions) > 1
        if options.junit:
            path = _own_file(options.junit, student, several)
            path.unlink(missing_ok=True)
            if junit:
                path.write_text(junit, encoding="utf-8")
        if options.gradescope:
            text = json.dumps(result.gradescope(), indent=1)
            _own_file(options.gradescope, student, several).write_text(text + "\n", encoding="utf-8")
    if options.csv:
        with options.csv.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow(["student", "score", "of", "note", *grades[0].worth])
            for g in grades:
                points = [round(g.earned.get(test, 0.0), 2) for test in g.worth]
                table.writerow([g.student, g.score, sum(g.worth.values()), g.note, *points])
    return grades

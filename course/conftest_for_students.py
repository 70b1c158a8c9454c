"""What all tests of an assignment share: seeds, and a time limit for each test.

    pytest tests              all tests
    pytest tests -k iqm       those with "iqm" in their name

The grader runs the same tests, some more, and with other seeds.
"""

import json
import os
import signal
import sys
from pathlib import Path

import agility_ref  # noqa: F401  (before numpy)

import pytest

sys.path.insert(0, os.environ.get("COURSE_SUBMISSION", str(Path(__file__).resolve().parent.parent)))
SEEDS = [int(seed) for seed in os.environ.get("COURSE_SEEDS", "1 2 3").split()]
SECONDS = 20  # of processor time for one test, unless it says otherwise


HINT = (
    "; are the arguments, the shapes and the order of the axes those of the docstring? (agility_ref's own are others)"
)


class TooSlow(BaseException):
    """A test took longer than it may; no ``except Exception`` catches this."""


def pytest_configure(config):
    config.addinivalue_line("markers", "seconds(n): time limit of a test, of processor time")
    config.addinivalue_line("markers", "training: trains a robot, which takes minutes")


def pytest_generate_tests(metafunc):
    if "seed" in metafunc.fixturenames:
        metafunc.parametrize("seed", SEEDS)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    marker = item.get_closest_marker("seconds")
    seconds = int(marker.args[0] if marker else SECONDS)

    def stop(*_):
        raise TooSlow(f"stopped after {seconds} s of processor time: is there a loop that never ends?")

    timed = hasattr(signal, "SIGPROF")  # not on Windows
    if timed:
        before = signal.signal(signal.SIGPROF, stop)
        signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        return (yield)
    except Exception as error:
        if type(error) in (TypeError, AttributeError, IndexError, KeyError, ValueError):
            raise type(error)(f"{error}{HINT}") from error
        raise
    finally:
        if timed:
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.signal(signal.SIGPROF, before)


def _record(**fields):
    if "COURSE_REPORT" in os.environ:
        with open(os.environ["COURSE_REPORT"], "a", encoding="utf-8") as file:
            file.write(json.dumps(fields) + "\n")


def pytest_runtest_logstart(nodeid):
    _record(test=nodeid, outcome="started")


def pytest_runtest_logreport(report):
    if report.when == "call" or report.outcome != "passed":
        _record(test=report.nodeid, outcome=report.outcome, message=_message(report)[:2000])


def pytest_collectreport(report):
    if report.failed:
        _record(test=None, outcome="failed", message=str(report.longrepr)[-2000:])


def _message(report):
    crash = getattr(report.longrepr, "reprcrash", None)
    return crash.message if crash else str(report.longrepr or "")

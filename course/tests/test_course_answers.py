"""The starter scores nothing, the model solution everything, and every wrong answer loses points in the right place."""

import argparse
import re
import resource
from pathlib import Path

from course import grade
from course.assignment import NAMES, find
from course.release import release

import mutants
import pytest

SEEDS = [5001]
QUICK = ("hw2", "hw6")
SLOW = [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in NAMES]
WRONG = [
    pytest.param(name, mutant, id=f"{name}: {mutant.name}", marks=pytest.mark.slow)
    for name in NAMES
    for mutant in mutants.of(name)
]


def graded(name, folder, seeds=SEEDS, only="", training=False):
    options = argparse.Namespace(seeds=seeds, seconds=900, memory=8, no_training=not training, only=only)
    return grade.grade(find(name), "student", folder, options)[0]


@pytest.mark.parametrize("name", SLOW)
def test_starter_scores_nothing(name, tmp_path):
    release(find(name), tmp_path / "starter")
    found = graded(name, tmp_path / "starter")
    assert found.score == 0, {test: points for test, points in found.earned.items() if points}
    assert all("NotImplementedError" in message for message in found.messages.values()), found.messages


@pytest.mark.parametrize("name", SLOW)
def test_model_solution_scores_everything_within_a_minute(name, tmp_path):
    release(find(name), tmp_path / "solution", solution=True)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    found = graded(name, tmp_path / "solution", [6001, 6002, 6003])
    assert not found.note and found.score == sum(found.worth.values()), found.messages
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 60  # [s] of processor time


@pytest.mark.slow
def test_model_solution_of_hw3_walks(tmp_path):
    release(find("hw3"), tmp_path / "solution", solution=True)
    found = graded("hw3", tmp_path / "solution", only="test_training_walks", training=True)
    assert not found.note and found.score == 20, found.messages


@pytest.mark.parametrize(("name", "mutant"), WRONG)
def test_wrong_answer_loses_points_where_it_should(name, mutant, tmp_path):
    mutants.write(mutant, find(name), tmp_path / "wrong")
    found = graded(name, tmp_path / "wrong", only=mutant.test)
    assert found.earned[mutant.test] < found.worth[mutant.test], f"unnoticed; others: {found.messages}"
    assert re.search(mutant.message, found.messages[mutant.test]), found.messages[mutant.test]
    assert "cannot be imported" not in found.note


@pytest.mark.parametrize("name", NAMES)
def test_points_are_a_hundred_and_belong_to_the_tests(name):
    assignment = find(name)
    text = "".join(path.read_text(encoding="utf-8") for path in assignment.tests(hidden=True))
    functions = re.findall(r"^def (test_\w+)\(", text, re.MULTILINE)
    assert sorted(functions) == sorted(assignment.points)
    assert sum(assignment.points.values()) == 100


@pytest.mark.parametrize("name", NAMES)
def test_at_least_five_wrong_answers_each(name):
    names = [mutant.name for mutant in mutants.of(name)]
    assert len(set(names)) == len(names) >= 5
    assert "agility_ref's own functions" in names


def test_the_instructors_page_lists_every_wrong_answer():
    page = (Path(__file__).parents[2] / "docs" / "instructors.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (hw\d) \| (.+?) \| `(test_\w+)` \| .+ \|$", page, re.MULTILINE)
    assert rows == [(name, mutant.name, mutant.test) for name in NAMES for mutant in mutants.of(name)]

from math import isnan, nan

import numpy as np
import pytest

from agility_ref.verdicts import (
    NOT_MEASURED,
    NOT_REPRODUCED,
    REPRODUCED,
    UNDECIDED,
    Comparison,
    Finding,
    markdown,
    over_seeds,
    paired,
    text,
    usual_seeds,
)

YES, NO = Comparison("yes", 0.2, 0.1, 0.3, seeds=2), Comparison("no", -0.2, -0.3, -0.1, seeds=2)
OPEN, NOTHING = Comparison("open", 0.1, -0.1, 0.3, seeds=2), Comparison("nothing")


def finding(*comparisons, any_of=False):
    return Finding("A beats B.", "section 9", "Measured so.", comparisons, any_of)


# --- one comparison --------------------------------------------------------------------


@pytest.mark.parametrize("low, high, verdict", [
    (0.01, 0.3, REPRODUCED), (-0.3, -0.01, NOT_REPRODUCED), (-0.1, 0.2, UNDECIDED),
    (0.0, 0.2, UNDECIDED), (-0.2, 0.0, UNDECIDED), (0.0, 0.0, UNDECIDED),  # 0 at its end is covered
    (nan, nan, UNDECIDED),
])  # fmt: skip
def test_the_side_of_the_interval_decides(low, high, verdict):
    assert Comparison("a - b", 0.0, low, high, seeds=1).verdict == verdict


@pytest.mark.parametrize("low, high, verdict", [
    (-0.09, 0.09, REPRODUCED), (0.01, 0.09, REPRODUCED), (0.11, 0.3, NOT_REPRODUCED), (-0.3, -0.11, NOT_REPRODUCED),
    (0.05, 0.15, UNDECIDED), (-0.3, 0.3, UNDECIDED), (0.0, 0.1, UNDECIDED),
])  # fmt: skip
def test_equality_needs_the_interval_within_the_margin(low, high, verdict):
    assert Comparison("a - b", 0.0, low, high, seeds=1, margin=0.1).verdict == verdict


def test_nothing_to_compare():
    assert NOTHING.verdict == NOT_MEASURED and str(NOTHING) == "-"
    assert paired("a - b", None).verdict == paired("a - b", np.ones(3), None).verdict == NOT_MEASURED


def test_paired_by_hand():
    # 0.5 - 0.25, 0.625 - 0.25, 1 - 0.5: mean 0.375, and no resample leaves 0.25 to 0.5
    a, b = np.tile([[0.5, 0.625, 1.0]], 4), np.tile([[0.25, 0.25, 0.5]], 4)
    comparison = paired("a - b", a, b, paper=0.1)
    assert comparison.difference == 0.375
    assert 0.25 <= comparison.low < 0.375 < comparison.high <= 0.5
    assert (comparison.verdict, comparison.seeds, comparison.paper) == (REPRODUCED, 1, 0.1)


def test_few_episodes_leave_it_open():
    comparison = paired("a - b", np.full((3, 9), 0.5), np.zeros((3, 9)))
    assert comparison.difference == 0.5 and comparison.verdict == UNDECIDED and isnan(comparison.low)


def test_paired_with_a_number():
    assert paired("a - 1", np.full((2, 4), 1.5), 1.0).difference == 0.5
    assert paired("a", np.full((2, 4), 1.5)).difference == 1.5


@pytest.mark.parametrize("differences, verdict, mean", [
    ([], NOT_MEASURED, nan), ([0.4], UNDECIDED, 0.4), ([0.4, 0.2], UNDECIDED, 0.3),
    ([0.4, 0.2, 0.3], REPRODUCED, 0.3), ([-0.4, -0.2, -0.3], NOT_REPRODUCED, -0.3), ([0.4, 0.1, 0.1], UNDECIDED, 0.2), ([-0.4, 0.2, 0.2], UNDECIDED, 0.0),
])  # fmt: skip
def test_an_interval_over_seeds_needs_three(differences, verdict, mean):
    comparison = over_seeds("gen-3", np.array(differences))
    assert comparison.verdict == verdict and comparison.seeds == len(differences)
    assert comparison.difference == pytest.approx(mean, nan_ok=True)
    assert isnan(comparison.low) == (len(differences) < 3)


def test_seeds_by_policies():
    comparison = over_seeds("baseline - x", np.array([[0.1, 0.3], [0.2, 0.4], [0.3, 0.5]]))
    assert comparison.difference == pytest.approx(0.3) and comparison.seeds == 3


# --- claims ----------------------------------------------------------------------------


@pytest.mark.parametrize("comparisons, both, either", [
    ((YES, YES), REPRODUCED, REPRODUCED),
    ((YES, OPEN), UNDECIDED, REPRODUCED),
    ((YES, NO), NOT_REPRODUCED, REPRODUCED),
    ((OPEN, NO), NOT_REPRODUCED, UNDECIDED),
    ((NO, NO), NOT_REPRODUCED, NOT_REPRODUCED),
    ((NOTHING, NOTHING), NOT_MEASURED, NOT_MEASURED),
    ((YES, NOTHING), UNDECIDED, REPRODUCED),
    ((NO, NOTHING), NOT_REPRODUCED, UNDECIDED),
    ((OPEN, NOTHING), UNDECIDED, UNDECIDED),
    ((), NOT_MEASURED, NOT_MEASURED),
])  # fmt: skip
def test_and_or(comparisons, both, either):
    assert finding(*comparisons).verdict == both
    assert finding(*comparisons, any_of=True).verdict == either


# --- as text ---------------------------------------------------------------------------


def test_text_has_every_verdict():
    printed = text([finding(YES), finding(NO, NOTHING), finding(Comparison("p", 0.1, 0.05, 0.2, 2, paper=-0.25))])
    assert printed.count("A beats B.") == 3
    assert printed.startswith("REPRODUCED: A beats B. (section 9)\n")
    assert "NOT REPRODUCED: A" in printed and "+0.20 [+0.10, +0.30]" in printed and "paper -0.25" in printed
    assert "One training seed" not in printed


def test_one_seed_is_said():
    one = finding(Comparison("a - b", 0.2, 0.1, 0.3, seeds=1))
    assert "One training seed" in text([one]) and "One training seed" in markdown([one], "x")
    assert "One training seed" not in markdown([finding(YES)], "x")


def test_markdown_lists_claims_then_comparisons():
    page = markdown([finding(YES, OPEN), finding(NO)], "preset quick")
    assert page.startswith("# Findings of the paper: preset quick\n")
    lines = page.splitlines()
    assert "| undecided | A beats B. | section 9 |" in lines and "| not reproduced | A beats B. | section 9 |" in lines
    assert "| yes | +0.20 [+0.10, +0.30] | 2 | reproduced | - |" in lines
    assert "section 9.  Measured so.  **Undecided.**" in lines


def test_no_findings_at_all():
    assert text([]) == "" and markdown([], "x").endswith("|---|---|---|\n")


def test_usual_seeds_ignore_what_was_not_measured():
    three = Comparison("a", 0.1, 0.0, 0.2, seeds=3)
    assert usual_seeds([finding(NOTHING, NOTHING, three)]) == 3

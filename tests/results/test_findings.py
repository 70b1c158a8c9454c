import json
from math import isnan, nan

from agility_ref.errors import UserError
from agility_ref.evaluate import METRICS
from agility_ref.results import findings
from agility_ref.results.cells import Cell
from agility_ref.results.findings import (
    CLAIMS,
    NOT_MEASURED,
    NOT_REPRODUCED,
    REPRODUCED,
    UNDECIDED,
    Claim,
    Comparison,
    Evidence,
    Finding,
    Row,
    gather,
    markdown,
    over_seeds,
    paired,
    paper_mean,
    read_ablations,
    text,
    training_curve,
    usual_seeds,
)
from agility_ref.training import weights
from agility_ref.training.policies import ENVIRONMENTS, POLICIES
from agility_ref.training.runs import TrainConfig

import numpy as np
import pytest

N = 40
NOISE = np.random.default_rng(0).uniform(-0.2, 0.2, N)  # hard and easy courses, the same for every policy


def make_cells(means, seeds=(0,), metric="waypoint_fraction", spread=0.02):
    """Cells whose metric is means[policy, environment], 0.5 elsewhere, plus the courses' and some noise."""
    cells = {}
    for policy in POLICIES:
        for environment in ENVIRONMENTS:
            for seed in seeds:
                rng = np.random.default_rng([sum(map(ord, policy + environment)), seed])
                score = means.get((policy, environment), 0.5) + NOISE + spread * rng.standard_normal(N)
                arrays = {m: score if m == metric else np.full(N, 0.5) for m in METRICS}
                arrays["difficulty"] = np.arange(N) / N
                cells[policy, environment, seed] = Cell(policy, environment, seed, arrays, {})
    return cells


def judge(claim, cells=None, curves=None, ablations=()):
    return Evidence(cells or {}, curves or {}, list(ablations)).judge(CLAIMS[claim])


def with_choices(cells, policy, **choices):
    for seed in {seed for _, _, seed in cells}:
        cell = cells[policy, "climb-gap", seed]
        cell.arrays.update({name: np.full(N, value) + 0.01 * NOISE for name, value in choices.items()})
    return cells


# --- verdicts on made-up cells ---------------------------------------------------------

SKILL_TERRAINS = ("gap", "beam", "climb")


@pytest.mark.parametrize("selector, gen5, verdict", [(0.8, 0.6, REPRODUCED), (0.6, 0.8, NOT_REPRODUCED)])
def test_selectors_against_generalists(selector, gen5, verdict):
    means = {(p, t): selector for p in ("oracle", "ps-sl-5") for t in SKILL_TERRAINS}
    means |= {("gen-5", t): gen5 for t in SKILL_TERRAINS} | {("gen-3", t): 0.3 for t in SKILL_TERRAINS}
    finding = judge("selectors-on-skill-terrains", make_cells(means))
    assert finding.verdict == verdict and len(finding.comparisons) == 12
    against = {c.text: c.verdict for c in finding.comparisons}
    assert against["oracle - gen-3 on gap"] == REPRODUCED and against["ps-sl-5 - gen-5 on beam"] == verdict


def test_a_difference_within_the_noise_is_undecided():
    cells = make_cells({}, spread=0.3)
    assert judge("ps-rl-3-on-climb-gap", cells).verdict == UNDECIDED


def test_differences_have_the_right_size_and_the_papers_beside_them():
    means = {("gen-3", "climb-gap"): 0.7, ("oracle", "climb-gap"): 0.4}
    finding = judge("generalists-on-climb-gap", make_cells(means))
    first = finding.comparisons[0]
    assert first.text == "gen-3 - oracle on climb-gap"
    # the courses' own difficulty cancels; 40 differences of noise 0.02 * sqrt 2 remain
    assert first.difference == pytest.approx(0.3, abs=0.015) and first.high - first.low < 0.03
    assert first.paper == pytest.approx(0.80 - 0.90)  # Table 1


def test_rewards_are_judged_apart_from_waypoints():
    cells = make_cells({("gen-3", "climb-gap"): 5.0, ("gen-5", "climb-gap"): 4.0}, metric="reward")
    assert judge("generalists-reward-on-climb-gap", cells).verdict == REPRODUCED
    assert judge("generalists-on-climb-gap", cells).verdict == UNDECIDED


def test_the_alias_names_the_selector_of_the_table():
    finding = judge("ps-rl-3-on-climb-gap", make_cells({("ps-rl-3-oracle", "climb-gap"): 0.9}))
    assert finding.verdict == REPRODUCED
    assert [c.paper for c in finding.comparisons] == pytest.approx([0.87 - 0.71, 0.87 - 0.80, 0.87 - 0.81])


@pytest.mark.parametrize("switches, wanted, share, wanted_share, verdicts", [
    (5.0, 1.0, 0.5, 0.5, (REPRODUCED, NOT_REPRODUCED)),  # flickers
    (0.0, 1.0, 1.0, 0.5, (NOT_REPRODUCED, REPRODUCED)),  # has collapsed
    (1.5, 1.0, 0.6, 0.5, (NOT_REPRODUCED, NOT_REPRODUCED)),  # neither
    (2.0, 1.0, 0.95, 0.5, (UNDECIDED, UNDECIDED)),  # on both thresholds
    (0.0, 0.0, 1.0, 1.0, (UNDECIDED, UNDECIDED)),  # stands where one skill is right
])  # fmt: skip
@pytest.mark.parametrize("reward", ["env", "oracle"])
def test_flicker_and_collapse(switches, wanted, share, wanted_share, verdicts, reward):
    cells = make_cells({}, seeds=(0, 1))
    with_choices(cells, f"ps-rl-3-{reward}", switches_per_second=switches, wanted_switches_per_second=wanted,
                 commonest_share=share, wanted_commonest_share=wanted_share)  # fmt: skip
    finding = judge(f"ps-rl-3-{reward}-unsteady", cells)
    assert tuple(c.verdict for c in finding.comparisons) == verdicts
    assert finding.verdict == (
        REPRODUCED if REPRODUCED in verdicts else UNDECIDED if UNDECIDED in verdicts else NOT_REPRODUCED
    )
    assert finding.comparisons[0].difference == pytest.approx(switches - 2 * wanted, abs=0.01)


def test_specialists_at_home_and_elsewhere():
    at_home = {("leap", "gap"): 0.9, ("beam", "beam"): 0.9, ("climb", "climb"): 0.9}
    assert judge("specialists-elsewhere", make_cells(at_home)).verdict == REPRODUCED
    finding = judge("specialists-elsewhere", make_cells(at_home | {("leap", "climb"): 0.95}))
    assert finding.verdict == NOT_REPRODUCED
    assert [c.text for c in finding.comparisons if c.verdict == NOT_REPRODUCED] == ["climb - leap on climb"]


def test_courses_of_two_terrains_are_paired_by_difficulty():
    # Both lose 0.5 from the easiest course to the hardest, but are played in opposite orders.
    cells = make_cells({}, spread=0.0)
    easy_first = np.arange(N) / N
    for terrain, difficulty in (("gap", easy_first), ("beam", easy_first[::-1])):
        cells["walk", terrain, 0].arrays.update(difficulty=difficulty, waypoint_fraction=0.9 - 0.5 * difficulty)
    (found,) = Evidence(cells, {}, []).measure(Row("walk", "walk", "gap", "beam"))
    assert (found.difference, found.low, found.high) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


@pytest.mark.parametrize("climb, hardest, equal", [
    (0.8, REPRODUCED, REPRODUCED), (0.2, NOT_REPRODUCED, NOT_REPRODUCED), (0.7, REPRODUCED, UNDECIDED),
])  # fmt: skip
def test_order_of_terrains(climb, hardest, equal):
    means = {(p, t): 0.8 for p in ("ps-sl-5", "ps-rl-3-oracle") for t in ("gap", "beam")}
    means |= {(p, "climb"): climb for p in ("ps-sl-5", "ps-rl-3-oracle")} | {("ps-sl-5", "climb-gap"): 0.5}
    cells = make_cells(means)
    assert judge("climb-gap-hardest", cells).verdict == hardest
    assert judge("others-equally-hard", cells).verdict == equal


def test_pairs_use_the_seeds_that_both_have():
    cells = make_cells({}, seeds=(0, 1, 2))
    del cells["gen-3", "climb-gap", 1], cells["oracle", "climb-gap", 2]
    finding = judge("generalists-on-climb-gap", cells)
    assert [c.seeds for c in finding.comparisons] == [1, 2, 2, 3]


def test_without_cells_nothing_is_measured():
    for claim in CLAIMS:
        assert judge(claim).verdict == NOT_MEASURED, claim


def test_claims_are_different_and_say_how_they_are_measured():
    found = [judge(claim, with_everything()) for claim in CLAIMS]
    assert len({f.claim.text for f in found}) == len(CLAIMS)
    assert all(f.claim.measure and f.claim.section and f.comparisons for f in found)


def with_everything():
    cells, choices = make_cells({}), ("switches_per_second", "commonest_share")
    for policy in ("ps-rl-3-env", "ps-rl-3-oracle"):
        with_choices(cells, policy, **{f"{w}{name}": 0.5 for name in choices for w in ("", "wanted_")})
    return cells


# --- learning curves -------------------------------------------------------------------


def make_curves(generalist, specialist, seeds=3):
    """Levels at 100, 200, ... 500 steps; a generalist goes on to 900."""
    curves = {}
    for seed in range(seeds):
        for name in ("climb", "leap", "climb-up", "climb-down", "beam"):
            curves[name, seed] = {"steps": np.arange(100.0, 600.0, 100.0), "level": np.array(specialist) + 0.01 * seed}
        for name in ("gen-3", "gen-5"):
            # The level of all kinds together counts its easy ground and is not looked at.
            levels = {
                f"level_{kind}": np.array(generalist) for kind in ("climb", "gap", "climb-up", "climb-down", "beam")
            }
            curves[name, seed] = {"steps": np.arange(100.0, 1000.0, 100.0), "level": np.ones(9)} | levels
    return curves


FAST_THEN_FLAT, SLOW_THEN_HIGH = [0.0, 0.4, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5], [0.0, 0.1, 0.3, 0.6, 0.9]


def test_generalists_early_and_late():
    curves = make_curves(FAST_THEN_FLAT, SLOW_THEN_HIGH)
    early = judge("generalists-early", curves=curves)
    # a quarter of the way from 100 to 500 is 200: 0.4 against 0.1, 0.11, 0.12
    assert early.verdict == REPRODUCED and early.comparisons[0].difference == pytest.approx(0.29)
    late = judge("generalists-plateau", curves=curves)
    # 0.9, 0.91, 0.92 against 0.5
    assert late.verdict == REPRODUCED and late.comparisons[1].difference == pytest.approx(0.41)


def test_generalists_that_are_slow_and_end_high():
    curves = make_curves([0.0, 0.05, 0.2, 0.5, 0.8, 0.9, 1.0, 1.0, 1.0], SLOW_THEN_HIGH)
    assert judge("generalists-early", curves=curves).verdict == NOT_REPRODUCED
    assert judge("generalists-plateau", curves=curves).verdict == NOT_REPRODUCED


def test_two_curves_are_too_few():
    finding = judge("generalists-plateau", curves=make_curves(FAST_THEN_FLAT, SLOW_THEN_HIGH, seeds=2))
    assert finding.verdict == UNDECIDED and "2 of 3 seeds" in finding.comparisons[0].text


def test_curves_that_lack_a_specialist_are_left_out():
    curves = make_curves(FAST_THEN_FLAT, SLOW_THEN_HIGH, seeds=4)
    del curves["leap", 2]
    assert [c.seeds for c in judge("generalists-plateau", curves=curves).comparisons] == [3, 3]


def test_training_curve_of_an_own_run_and_of_shipped_weights(tmp_path, monkeypatch, finished_run):
    shipped = {"leap-quick-seed1.npz": {"curve": {"steps": [1, 2], "level": [0.1, 0.2]}}, "ps-sl-5-quick-seed1.npz": {}}
    (tmp_path / "manifest.json").write_text(json.dumps(shipped))
    monkeypatch.setattr(weights, "FOLDER", tmp_path)
    training = TrainConfig(preset="quick", seed=1, out=str(tmp_path / "runs"))
    assert training_curve("leap", training)["level"].tolist() == [0.1, 0.2]
    assert training_curve("beam", training) is None and training_curve("ps-sl-5", training) is None
    folder = finished_run(tmp_path / "runs", "leap", 1)
    assert training_curve("leap", training) is None  # the weights in use left no curve
    (folder / "progress.csv").write_text("steps,level\n10,0.5\n20,0.75\n")
    assert training_curve("leap", training)["level"].tolist() == [0.5, 0.75]


# --- ablations -------------------------------------------------------------------------


def ablation_rows(effect, name="no-curriculum", seeds=3):
    rows = []
    for seed in range(seeds):
        for policy in ("climb", "leap"):
            base = {"policy": policy, "seed": seed}
            rows += [
                {"ablation": "baseline", "steps": 100, "waypoint_fraction": 0.0, **base},
                {"ablation": "baseline", "steps": 200, "waypoint_fraction": 0.8 + 0.01 * seed, **base},
                {"ablation": name, "steps": 200, "waypoint_fraction": 0.8 - effect, **base},
                {"ablation": name, "steps": 100, "waypoint_fraction": 0.9, **base},
            ]
    return rows


@pytest.mark.parametrize("effect, seeds, verdict", [
    (0.5, 3, REPRODUCED), (-0.1, 3, NOT_REPRODUCED), (-0.01, 3, UNDECIDED), (0.5, 2, UNDECIDED),
])  # fmt: skip
def test_ablations(effect, seeds, verdict):
    finding = judge("curriculum", ablations=ablation_rows(effect, seeds=seeds))
    assert finding.verdict == verdict
    # the last steps count: 0.80, 0.81, 0.82 against 0.8 - effect
    assert finding.comparisons[0].difference == pytest.approx(effect + 0.005 * (seeds - 1))
    assert judge("action-stacking", ablations=ablation_rows(effect)).verdict == NOT_MEASURED


@pytest.mark.parametrize("gain, verdict", [(0.3, REPRODUCED), (-0.3, NOT_REPRODUCED)])
def test_action_stacking_hurts_if_policies_without_it_are_better(gain, verdict):
    rows = ablation_rows(-gain, "action-repeat-1")  # 0.8 + gain, against 0.80 to 0.82
    finding = judge("action-stacking", ablations=rows)
    assert [c.text for c in finding.comparisons] == ["action-repeat-1 - baseline (climb, leap)"]
    assert finding.comparisons[0].difference == pytest.approx(gain - 0.01)
    assert finding.verdict == verdict


def test_a_seed_that_lacks_a_policy_is_left_out():
    rows = [r for r in ablation_rows(0.5, seeds=4) if (r["policy"], r["seed"]) != ("leap", 3)]
    assert judge("curriculum", ablations=rows).comparisons[0].seeds == 3


def test_read_ablations(tmp_path):
    path = tmp_path / "ablations.csv"
    assert read_ablations(path) == []
    path.write_text("ablation,policy,seed,steps,waypoint_fraction,more\nbaseline,leap,1,2e6,0.5,x\n")
    assert read_ablations(path) == [
        {"ablation": "baseline", "policy": "leap", "seed": 1, "steps": 2_000_000, "waypoint_fraction": 0.5}
    ]


@pytest.mark.parametrize("content", [
    "ablation,policy\nbaseline,leap\n", "ablation,policy,seed,steps,waypoint_fraction\nbaseline,leap,one,2,0.5\n",
    "ablation,policy,seed,steps,waypoint_fraction\nbaseline,leap,1\n",
])  # fmt: skip
def test_bad_ablations_are_refused(tmp_path, content):
    path = tmp_path / "ablations.csv"
    path.write_text(content)
    with pytest.raises(UserError, match=r"ablations\.csv does not hold"):
        read_ablations(path)


# --- all together ----------------------------------------------------------------------


def test_paper_means():
    assert paper_mean("ps-rl-3-oracle", "climb", "waypoint_fraction") == 0.89
    assert np.isnan(paper_mean("ps-rl-3-env", "climb", "waypoint_fraction"))
    assert np.isnan(paper_mean("climb", "beam", "reward"))


def test_compare_takes_the_first_minus_each_other_one():
    cells = make_cells({("walk", "gap"): 0.5, ("leap", "gap"): 0.75, ("beam", "gap"): 0.25, ("leap", "beam"): 0.5})
    del cells["walk", "beam", 0]
    found = {c.text: c for c in findings.compare(cells, ("walk", "leap", "beam"))}
    assert len(found) == 8 and findings.compare(cells, ()) == []
    assert found["walk - leap on gap"].difference == pytest.approx(-0.25, abs=0.02)
    assert found["walk - beam on gap"].difference == pytest.approx(0.25, abs=0.02)
    assert found["walk - leap on beam"].seeds == 0  # only one of them was there


def test_check_and_write(tmp_path, monkeypatch):
    monkeypatch.setattr(weights, "FOLDER", tmp_path)
    training = TrainConfig(out=str(tmp_path / "runs"))
    found = findings.check(with_everything(), training, tmp_path / "none.csv")
    assert len(found) == len(CLAIMS)
    page = findings.write(found, tmp_path, "preset quick").read_text()
    assert page.startswith("# Findings of the paper: preset quick\n")
    assert all(f"## {f.claim.text}" in page for f in found)


def test_gather_reads_the_curves_of_the_seeds_in_the_table(tmp_path, finished_run):
    for seed in (0, 1):
        folder = finished_run(tmp_path, "leap", seed)
        (folder / "progress.csv").write_text("steps,level\n10,0.5\n")
    evidence = gather(make_cells({}, seeds=(1,)), TrainConfig(out=str(tmp_path)), tmp_path / "none.csv")
    assert [seed for policy, seed in evidence.curves if policy == "leap"] == [1]
    assert {seed for _, seed in evidence.curves} == {1}


YES, NO = Comparison("yes", 0.2, 0.1, 0.3, seeds=2), Comparison("no", -0.2, -0.3, -0.1, seeds=2)
OPEN, NOTHING = Comparison("open", 0.1, -0.1, 0.3, seeds=2), Comparison("nothing")


def finding(*comparisons, any_of=False):
    return Finding(Claim("A beats B.", "section 9", "Measured so.", any_of=any_of), comparisons)


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
    assert paired("a", np.full((2, 4), 1.5), 0.0).difference == 1.5


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


def test_thresholds_stand_in_the_texts():
    for reward in ("env", "oracle"):
        measure = CLAIMS[f"ps-rl-3-{reward}-unsteady"].measure
        assert f"more than {findings.FLICKER:g} times" in measure and f"more than {findings.COLLAPSE:.0%} of" in measure
    assert f"after {findings.EARLY:.0%} of" in CLAIMS["generalists-early"].measure
    equal = CLAIMS["others-equally-hard"]
    assert all(f"within +-{row.margin}," in equal.measure for row in equal.rows)

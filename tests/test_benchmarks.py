import csv
import importlib
import json
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

from agility_ref import go1
from agility_ref.curriculum import CurriculumConfig
from agility_ref.env import EnvConfig
from agility_ref.errors import UserError
from agility_ref.evaluate import Evaluation, EvaluationConfig
from agility_ref.files import read_npz
from agility_ref.observation import OBS_DIM, SCANDOTS
from agility_ref.ppo import PPOConfig
from agility_ref.results import findings
from agility_ref.results.findings import read_ablations
from agility_ref.selector import Single, oracle_hierarchy
from agility_ref.terrain import Obstacle, make_course
from agility_ref.training.policies import POLICIES
from agility_ref.training.runs import TrainConfig, train_policy
from agility_ref.world import World

import mujoco
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))

import ablations
import climb_gap
import common
import evaluation_seeds
import fidelity
import learning
import oracle_regions
import physics
import pushes
import skills_table
import time_to_skill
import time_to_walk
import variants

TINY = {
    "preset": "quick",
    "ppo": PPOConfig(num_envs=8, num_steps=4, num_minibatches=1, update_epochs=1, hidden=(8,)),
    "curriculum": CurriculumConfig(num_levels=2, variants=1),
}


@pytest.fixture
def tiny(monkeypatch):
    """Make every training a tiny one, and every warm start one of 64 steps."""
    monkeypatch.setattr("agility_ref.training.weights.shipped", lambda *key: None)
    for module in (time_to_skill, ablations):
        monkeypatch.setattr(module, "TrainConfig", lambda **given: TrainConfig(**TINY | given))
    small = {name: replace(spec, budget=(64, 64)) for name, spec in POLICIES.items()}
    monkeypatch.setattr("agility_ref.training.policies.POLICIES", small)


def fixed_judge(*fractions):
    """Return a judge that gives one number after the other."""
    left = iter(fractions)
    return lambda policy: {"waypoint_fraction": next(left), "falls": 0.25}


# --- every script -------------------------------------------------------------------------

SCRIPTS = sorted(path.stem for path in Path(common.__file__).parent.glob("*.py"))


@pytest.mark.parametrize(
    "name",
    [
        name
        for name in SCRIPTS
        if name not in ("common", "learning", "crash_test", "fuzz_commands", "fuzz_files", "variants")
    ],
)
def test_every_script_has_settings_with_help(name, capsys, monkeypatch):
    script = importlib.import_module(name)  # without the optional packages that it may want to run
    monkeypatch.setattr(sys, "argv", [f"benchmarks/{name}.py", "--help"])
    with pytest.raises(SystemExit) as stop:
        common.start(script.main, script.Config)
    assert stop.value.code == 0 and "--json" in capsys.readouterr().out


def run_variant(name, *words):
    """Run a variant in a process of its own, for it changes the package for good."""
    command = [sys.executable, variants.__file__, name, *map(str, words)]
    return subprocess.run(command, cwd=Path(__file__).parent.parent, capture_output=True, text=True, timeout=300)


@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.slow) for name in variants.VARIANTS])
def test_a_variant_trains_and_plays(name, tmp_path):
    small = (
        "--ppo.num-envs 8 --ppo.num-steps 4 --ppo.hidden 8 --curriculum.num-levels 2 --curriculum.variants 1".split()
    )
    run = ("walk", "--preset", "quick", "--steps", 64, "--out", tmp_path, *small)
    assert run_variant(name, "train", *run).returncode == 0
    play = ("walk", "--preset", "quick", "--environment", "walk", "--episodes", 1, "--runs", tmp_path)
    assert "waypoint_fraction" in run_variant(name, "evaluate", *play).stdout
    weight = read_npz(tmp_path / "walk" / "seed0" / "policy.npz")[0]["actor.0.weight"]
    unseen = {"critic-sees-more": 10, "told-of-pushes": 6}.get(name, 0)  # by the actor, of what is shown beyond OBS_DIM
    assert (weight[:, OBS_DIM:] == 0).all(axis=0).sum() == unseen


def test_an_unknown_variant_is_one_line():
    done = run_variant("near-start", "train", "walk")
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "near-starts" in done.stderr


# --- learning -----------------------------------------------------------------------------


def test_it_is_the_training_of_the_command_line(tiny, tmp_path):
    """Same weights to the last bit, whatever is evaluated on the way."""
    config = TrainConfig(**TINY, out=str(tmp_path), seed=3)
    train_policy("walk", replace(config, steps=64), quiet=True)
    expected, meta = read_npz(train_policy("leap", replace(config, steps=160), quiet=True) / "policy.npz")
    walk = learning.learn("walk", config, 64)
    leap = learning.learn("leap", config, 160, learning.own_courses("leap", "quick", 1), 32, start=walk)
    assert leap.steps == meta["steps"] == 160
    assert [point["steps"] for point in leap.curve] == [64, 96, 128, 160]
    for name, array in leap.arrays.items():
        assert np.array_equal(array, expected[name]), name


def test_training_ends_at_the_goal_and_at_its_budget():
    config = TrainConfig(**TINY)
    stopped = learning.learn("walk", config, 320, fixed_judge(0.0, 0.4, 0.8, 1.0), 64, goal=0.8)
    assert [p["waypoint_fraction"] for p in stopped.curve] == [0.0, 0.4, 0.8] and stopped.steps == 128
    to_the_end = learning.learn("walk", config, 80, fixed_judge(0.0, 0.1, 0.2), 64)
    assert [p["steps"] for p in to_the_end.curve] == [0, 64, 96]  # whole iterations of 32
    seconds = [p["seconds"] for p in to_the_end.curve]
    assert seconds[0] == 0.0 and seconds == sorted(seconds) and to_the_end.seconds >= seconds[-1]
    with pytest.raises(UserError, match="nothing to train"):
        learning.learn("walk", config, 80, start=to_the_end)


def test_evaluations_are_not_on_the_clock(monkeypatch):
    now = [0.0]

    def look():
        now[0] += 1.0
        return now[0]

    def judge(policy):
        now[0] += 1000.0
        return {"waypoint_fraction": 0.0, "falls": 0.0}

    monkeypatch.setattr(learning.time, "perf_counter", look)
    trained = learning.learn("walk", TrainConfig(**TINY), 96, judge, 32)
    assert len(trained.curve) == 4 and now[0] > 4000.0
    assert 3.0 <= trained.seconds < 100.0


def test_no_level_without_a_curriculum():
    config = TrainConfig(**TINY | {"curriculum": CurriculumConfig(num_levels=2, variants=1, enabled=False)})
    trained = learning.learn("walk", config, 32, fixed_judge(0.0, 0.0), 32)
    assert [p["level"] for p in trained.curve] == [None, None]


@pytest.mark.parametrize("name", ["oracle", "ps-rl-3", "ps-sl-5", "distilled", "post-gen", "wlak"])
def test_selectors_are_refused(name):
    with pytest.raises(UserError):
        learning.check_skill(name)


# --- time to a skill ----------------------------------------------------------------------


def curve(*fractions):
    return [
        {"steps": 100 * k, "seconds": 2.0 * k, "waypoint_fraction": f, "falls": 0.1, "level": 0.5}
        for k, f in enumerate(fractions)
    ]


def test_crossings_are_the_first_evaluations_at_or_above():
    points = time_to_skill.crossings(curve(0.1, 0.5, 0.4, 0.9), (0.5, 0.8, 0.9, 0.95))
    assert [p and p["steps"] for p in points] == [100, 300, 300, None]


def test_medians_need_every_seed():
    made = [
        time_to_skill.describe(s, learning.Trained({}, 300, 6.0, curve(*f)), (0.5, 0.8))
        for s, f in enumerate([(0.0, 0.6, 0.9), (0.0, 0.1, 0.5), (0.6, 0.7, 0.9)])
    ]
    assert time_to_skill.medians(made) == {"0.5": {"steps": 100.0, "seconds": 2.0}, "0.8": None}
    assert [run["best"] for run in made] == [0.9, 0.5, 0.9]


def test_time_to_skill_counts_the_warm_start(tiny, tmp_path, capsys):
    config = time_to_skill.Config(
        "leap", "quick", (0, 1), (0.5,), every=32, steps=96, episodes=1, out=str(tmp_path), json=True
    )
    time_to_skill.main(config)
    printed = json.loads(capsys.readouterr().out)
    assert [point["steps"] for point in printed["runs"][0]["curve"]] == [64, 96]
    assert printed["runs"][0]["curve"][0]["seconds"] > 0.0  # walk's
    with open(tmp_path / "time-to-leap-quick.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["seed"], row["steps"]) for row in rows] == [("0", "64"), ("0", "96"), ("1", "64"), ("1", "96")]
    assert (tmp_path / "time-to-leap-quick.png").exists()


def test_time_to_walk_is_its_quick_case(tiny, capsys, monkeypatch):
    asked = []
    monkeypatch.setattr(time_to_skill, "main", asked.append)
    time_to_walk.main(time_to_walk.Config(seeds=(4,), goal=0.7, json=True))
    (config,) = asked
    assert (config.policy, config.preset, config.seeds, config.thresholds) == ("walk", "quick", (4,), (0.7,))
    assert config.out == "" and config.json and config.steps == 0


def test_a_mistake_is_one_line(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["benchmarks/time_to_skill.py", "oracle"])
    with pytest.raises(SystemExit) as stop:
        common.start(time_to_skill.main, time_to_skill.Config)
    err = capsys.readouterr().err
    assert stop.value.code == 2 and err.count("\n") == 1 and err.startswith("time_to_skill.py: oracle")


# --- fidelity -----------------------------------------------------------------------------


def test_a_candidate_changes_the_robots_and_only_while_it_lasts():
    euler = next(candidate for candidate in physics.candidates() if candidate.name == "Euler")
    course, seen = make_course("climb", 0.5, 0), []
    with fidelity.edited(euler):
        seen.append(go1.make_model(course).opt.integrator)
    seen.append(go1.make_model(course).opt.integrator)
    assert seen == [mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtIntegrator.mjINT_IMPLICITFAST]


def test_fidelity_trains_under_a_candidate_once_and_plays_both_physics(tiny, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(fidelity, "TrainConfig", lambda **given: TrainConfig(**TINY | given))
    config = fidelity.Config(candidates=("5 ms x 4",), policies=("walk",), runs=str(tmp_path), episodes=2, json=True)
    fidelity.main(config)
    first = json.loads(capsys.readouterr().out)["fidelity"]
    monkeypatch.setattr(fidelity, "train_policy", None)  # the second time there is nothing to train
    fidelity.main(config)
    assert json.loads(capsys.readouterr().out)["fidelity"] == first
    _, meta = read_npz(tmp_path / "5-ms-x-4" / "walk" / "seed0" / "policy.npz")
    assert meta["config"]["env"]["physics"]["timestep"] == 0.005
    assert first[0]["candidate"] == "5 ms x 4" and 0.0 <= first[0]["waypoint_fraction"] <= 1.0


def test_fine_physics_keeps_the_control_period():
    chosen = go1.PhysicsConfig()
    finer = fidelity.fine(chosen)
    assert finer.timestep == 0.0025 and finer.substeps == 8  # 0.02 s / 2.5 ms
    assert (finer.iterations, finer.ls_iterations) == (100, 50) and finer.kp == chosen.kp


# --- ablations ----------------------------------------------------------------------------


@pytest.mark.parametrize("ablation", ablations.ABLATIONS[1:], ids=lambda a: a.name)
def test_an_ablation_changes_what_it_says_and_nothing_else(ablation):
    before, after = asdict(TrainConfig()), asdict(ablation.apply(TrainConfig()))
    said = {("", key) for key in ablation.train}
    said |= {(part, key) for part in ("env", "ppo", "curriculum") for key in getattr(ablation, part)}
    changed = {("", k) for k, v in before.items() if not isinstance(v, dict) and after[k] != v}
    changed |= {(p, k) for p, v in before.items() if isinstance(v, dict) for k in v if after[p][k] != v[k]}
    assert changed == said and said


def test_findings_know_the_names():
    names = [a.name for a in ablations.ABLATIONS]
    rows = [row for claim in findings.CLAIMS.values() for row in claim.rows if row.metric == "ablation"]
    asked = {name for row in rows for name in (row.a, row.b)}
    assert asked == {"baseline", "no-curriculum", "action-repeat-1"} <= set(names)
    assert len(set(names)) == len(names)


def test_joints_reach_as_far_at_any_action_scale():
    for ablation in ablations.ABLATIONS:
        env = ablation.apply(TrainConfig()).env
        assert env.action_scale * env.action_limit == pytest.approx(1.2)


def test_evaluation_has_none_of_trainings_own():
    task = learning.evaluation_task(TrainConfig().env)
    assert task == EnvConfig()
    assert learning.evaluation_task(replace(task, action_repeat=3, stall_seconds=5.0)).action_repeat == 3


SMALL = ablations.Config(
    only=("baseline", "from-scratch", "no-curriculum"), policies=("leap",), seeds=(0,), preset="quick",
    steps=128, every=64, episodes=1,
)  # fmt: skip


def test_ablations_resume_and_collect(tiny, tmp_path, capsys, monkeypatch):
    config = replace(SMALL, runs=str(tmp_path / "runs"), out=str(tmp_path / "results"))
    ablations.main(config)
    rows = read_ablations(tmp_path / "results" / "ablations-quick.csv")
    steps = {name: [r["steps"] for r in rows if r["ablation"] == name] for name in config.only}
    assert steps == {"baseline": [64, 128], "from-scratch": [0, 64, 128], "no-curriculum": [64, 128]}
    assert (tmp_path / "results" / "ablations-quick.png").exists()
    assert (config.root / "baseline" / "warm-start" / "walk" / "seed0" / "DONE").exists()
    assert not (config.root / "from-scratch" / "warm-start").exists()

    def never(*args, **kwargs):
        raise AssertionError("a finished run was trained again")

    monkeypatch.setattr(ablations, "learn", never)
    ablations.main(config)
    (config.root / "baseline" / "leap" / "seed0" / "DONE").unlink()
    with pytest.raises(AssertionError, match="trained again"):
        ablations.main(config)
    ablations.main(replace(config, collect=True))
    assert {r["ablation"] for r in read_ablations(tmp_path / "results" / "ablations-quick.csv")} == set(config.only[1:])


def test_runs_of_another_recipe_are_refused(tiny, tmp_path, monkeypatch):
    config = replace(SMALL, only=("from-scratch",), runs=str(tmp_path), out=str(tmp_path))
    ablations.main(config)
    changed = TINY | {"env": EnvConfig(action_scale=0.31)}
    monkeypatch.setattr(ablations, "TrainConfig", lambda **given: TrainConfig(**changed | given))
    with pytest.raises(UserError, match="another recipe"):
        ablations.main(config)


def test_an_unknown_ablation_is_named(tmp_path):
    with pytest.raises(UserError, match="did you mean no-curriculum"):
        ablations.main(replace(SMALL, only=("no-curiculum",), runs=str(tmp_path)))
    with pytest.raises(UserError, match="nothing to train after"):
        ablations.main(replace(SMALL, steps=64, runs=str(tmp_path)))
    with pytest.raises(UserError, match="no finished run"):
        ablations.main(replace(SMALL, collect=True, runs=str(tmp_path)))


def test_the_summary_compares_the_same_seeds():
    def seeds(*last):
        return {k: curve(0.0, value) for k, value in enumerate(last)}

    found = {"leap": {"baseline": seeds(0.8, 0.6), "mirror": seeds(0.9, 0.5, 0.1)}}
    base, mirror = ablations.summary_rows(found)
    assert base["waypoints"] == "0.70 (0.60 to 0.80)" and base["minus baseline"] == ""
    assert mirror["seeds"] == 3 and mirror["minus baseline"] == "+0.00 (-0.10 to +0.10)"
    ablations.draw(found).canvas.draw()


# --- the table of skills ------------------------------------------------------------------


def played(name, waypoints, course):
    n = len(waypoints)
    numbers = np.array(waypoints, float)
    return Evaluation(
        name, course, EvaluationConfig(n), np.zeros(n), np.full(n, 10), numbers, np.full(n, 0.1),
        numbers < 0.5, np.zeros(n), None, None,
    )  # fmt: skip


@pytest.fixture
def evaluations():
    """Two seeds of leap, one of gen-3, which plays two of its courses here."""
    return {
        ("leap", 0, "gap", None): played("leap", [1.0, 0.6], "gap"),
        ("leap", 1, "gap", None): played("leap", [0.4, 0.4], "gap"),
        ("leap", 0, "gap", 0.5): played("leap", [0.25, 0.75], "gap"),
        ("leap", 1, "gap", 0.5): played("leap", [0.25, 0.25], "gap"),
        ("gen-3", 0, "gap", None): played("gen-3", [0.9, 0.4], "gap"),
        ("gen-3", 0, "walk", None): played("gen-3", [1.0, 1.0], "walk"),
        ("walk", 0, "walk", None): played("walk", [0.9, 0.9], "walk"),
    }


def test_rows_of_the_skills_table(evaluations, make_policy):
    policies = {
        (name, seed): replace(make_policy(), meta={"steps": 3_000_000, "wall_seconds": 90.0 + 60 * seed})
        for name, seed, _, _ in evaluations
    }
    rows = skills_table.csv_rows(evaluations, policies)
    assert len(rows) == 7 and json.loads(json.dumps(rows)) == rows
    leap, gen, _ = skills_table.skills_rows(rows)
    assert leap["waypoints"] == "0.60 (0.40)" and leap["falls"] == "0.50 (1.00)" and leap["own training"] == "2.0 min"
    assert gen["courses"] == "gap, walk" and gen["waypoints"] == "0.82" and gen["seeds"] == 1
    (fixed, *_) = skills_table.difficulty_rows(rows)
    assert fixed == {"waypoints of": "leap on gap", "d = 0.5": "0.38 (0.25)"}


def test_generalists_are_compared_with_the_specialist_of_each_course(evaluations):
    gap, walk = skills_table.generalist_figures(evaluations)
    assert (gap["specialist"], gap["seeds"]) == ("leap", [0])  # the seed that both have
    assert gap["difference"][0] == pytest.approx(-0.15) and walk["difference"][0] == pytest.approx(0.1)
    mean = skills_table.generalist_rows([gap, walk])[-1]
    assert mean["course"] == "mean" and mean["difference"] == "-0.03"


def test_a_course_without_a_specialist_is_compared_with_nobody(evaluations):
    extra = {("post-gen", 0, course, None): played("post-gen", [0.5, 0.5], course) for course in ("climb-gap", "gap")}
    figures = [f for f in skills_table.generalist_figures(evaluations | extra) if f["generalist"] == "post-gen"]
    assert [f["course"] for f in figures] == ["gap"]


def test_every_course_has_one_specialist():
    assert set(skills_table.SPECIALISTS.values()) == {n for n in skills_table.SKILLS if "gen" not in n}
    assert "climb-gap" not in skills_table.SPECIALISTS  # which no single skill can cross


def test_skills_table_plays_what_there_is(tiny, tmp_path, capsys, finished_run):
    for name in ("walk", "leap"):
        finished_run(tmp_path / "runs", name, preset="quick", wall_seconds=60.0)
    config = skills_table.Config(
        ("walk", "leap", "beam"), "quick", str(tmp_path / "runs"), episodes=1, csv=str(tmp_path / "t.csv"), json=True
    )
    skills_table.main(config)
    out, err = capsys.readouterr()
    assert "missing: no weights for beam" in err
    assert {row["policy"] for row in json.loads(out)["rows"]} == {"walk", "leap"}
    with open(tmp_path / "t.csv", newline="") as file:
        assert len(list(csv.DictReader(file))) == 2 * 6
    with pytest.raises(UserError, match="no weights for beam"):
        skills_table.main(replace(config, policies=("beam",)))
    with pytest.raises(UserError, match=r"oracle is no specialist or generalist; give one of .*post-gen"):
        skills_table.main(replace(config, policies=("oracle",)))
    with pytest.raises(UserError, match="no weights for post-gen"):  # which is one, and nothing here trains it
        skills_table.main(replace(config, policies=("post-gen",)))


# --- two evaluations ----------------------------------------------------------------------


def test_agreement_by_hand():
    one = np.array([[0.5, 0.4, 0.6], [0.5, 0.4, 0.6], [0.5, 0.4, 0.6], [0.2, 0.2, 0.2]])
    two = np.array([[0.55, 0.45, 0.65], [0.63, 0.53, 0.73], [0.9, 0.8, 1.0], [0.2, 0.2, 0.2]])
    found = evaluation_seeds.agreement(one, two)
    # Half widths of 0.1 each: the difference may be sqrt(0.02) = 0.141.
    assert found["difference within its interval"].tolist() == [True, True, False, True]
    assert found["intervals overlap"].tolist() == [True, True, False, True]
    assert found["second within the first's"].tolist() == [True, False, False, True]


def test_agreement_does_not_depend_on_the_order():
    rng = np.random.default_rng(0)
    one, two = (np.sort(rng.random((50, 3)))[:, [1, 0, 2]] for _ in range(2))
    for name in ("difference within its interval", "intervals overlap"):
        there, back = (evaluation_seeds.agreement(*pair)[name] for pair in ((one, two), (two, one)))
        assert (there == back).all() and 0 < there.mean() < 1


def test_a_table_agrees_with_itself(capsys):
    table = str(Path(common.__file__).parent.parent / "docs" / "full" / "table1.csv")
    evaluation_seeds.main(evaluation_seeds.Config(table, table, json=True))
    shares = json.loads(capsys.readouterr().out)["agreement"]
    assert all(value == 1.0 for metric in shares.values() for name, value in metric.items() if name != "cells")
    with pytest.raises(UserError, match="no file at nowhere"):
        evaluation_seeds.read_cells("nowhere")


# --- Climb+Gap ----------------------------------------------------------------------------


def test_unbounded_skills_see_what_there_is_and_the_others_do_not(five_skills):
    zeros = np.zeros(OBS_DIM, np.float32)
    blind = {name: replace(skill, low=zeros, high=zeros) for name, skill in five_skills.items()}
    oracle = climb_gap.unbounded(oracle_hierarchy("oracle", blind), ("leap",))
    observation = np.random.default_rng(0).uniform(-1.0, 1.0, (2, OBS_DIM)).astype(np.float32)
    for name, skill in zip(climb_gap.ALL, oracle.skills, strict=True):
        shown = five_skills[name] if name == "leap" else blind[name]
        np.testing.assert_array_equal(skill(observation), shown(observation))


def test_a_shallow_climb_takes_a_pit_for_a_step(five_skills):
    """Ground 1 m below the feet, the end of the scandots, reads as 0.35 m; whoever leaps sees it as it is."""
    climb, leap = (replace(five_skills[name], high=np.full(OBS_DIM, 5.0, np.float32)) for name in ("climb-up", "leap"))
    three = {"walk": five_skills["walk"], "climb": climb, "leap": leap}
    by_name = dict(zip(three, climb_gap.shallow(oracle_hierarchy("oracle", three), 0.35).skills, strict=True))
    deep, step = (np.zeros((1, OBS_DIM), np.float32) for _ in range(2))
    deep[:, SCANDOTS], step[:, SCANDOTS] = 1.0, 0.35
    np.testing.assert_allclose(by_name["climb"](deep), by_name["climb"](step), atol=1e-6)
    np.testing.assert_array_equal(by_name["leap"](deep), leap(deep))
    assert not np.allclose(leap(deep), leap(step))


def test_the_layout_of_climb_gap_is_that_of_the_table(monkeypatch, five_skills):
    built = []
    monkeypatch.setattr(climb_gap, "World", lambda courses: built.extend(courses) or World(courses))
    config = climb_gap.Config(episodes=2)
    climb_gap.play(oracle_hierarchy("oracle", five_skills), climb_gap.CLIMB_GAP, config)
    expected = make_course("climb-gap", 0.5, np.random.default_rng([0, 1]))
    assert built[1].boxes == expected.boxes and len(built) == 2


# --- pushes -------------------------------------------------------------------------------


def test_a_fall_is_put_down_to_the_pushes_shortly_before_it():
    fell = np.zeros((6, 2), bool)
    fell[4, 0] = True  # robot 1 never falls
    soon = pushes.falls_soon(fell, 2)
    assert soon[:, 0].tolist() == [False, False, True, True, True, False] and not soon[:, 1].any()


def test_pushes_and_regions_are_of_specialists():
    with pytest.raises(UserError, match="gen-3 is no specialist"):
        pushes.main(pushes.Config(policies=("gen-3",)))
    with pytest.raises(UserError, match="unknown skill 'walk'"):
        oracle_regions.main(oracle_regions.Config(skills=("walk",)))


def test_a_robot_is_at_an_obstacle_from_shortly_before_it_to_its_end():
    gaps = (Obstacle(2.0, 2.5, "leap"), Obstacle(4.0, 4.1, "leap"))
    x = np.array([1.84, 1.86, 2.4, 2.6, 3.84, 4.05, 4.2])
    assert pushes.near(x, gaps).tolist() == [False, True, True, False, False, True, False]


def test_pushes_are_counted_as_they_strike(monkeypatch, five_skills):
    """Every 0.2 s, so one in every five steps of an episode, give or take one at either end."""
    lengths, rollout = [], pushes.rollout

    def spy(*given, **named):
        r = rollout(*given, **named)
        lengths.extend(pushes.in_first_episode(r["done"]).sum(axis=0))
        return r

    monkeypatch.setattr(pushes, "rollout", spy)
    evaluation = EvaluationConfig(episodes=3, difficulty=1.0)
    played = pushes.play(Single("leap", five_skills["leap"]), "gap", evaluation, 0.2, 1.0)
    struck = sum(count for count, _ in played.falls.values())
    assert abs(struck - sum(lengths) / 5) <= len(lengths)
    assert played.falls["elsewhere"][0] > 0 and all(after <= count for count, after in played.falls.values())
    calm = pushes.play(Single("leap", five_skills["leap"]), "gap", evaluation, 0.0, 1.0)
    assert calm.falls == dict.fromkeys(pushes.PLACES, (0, 0))

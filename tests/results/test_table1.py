import csv
import json
import math
import platform
import subprocess
import sys
from pathlib import Path

from agility_ref.errors import UserError
from agility_ref.evaluate import METRICS, Evaluation, EvaluationConfig
from agility_ref.results import cells, table1
from agility_ref.results.cells import Cell
from agility_ref.results.table1 import (
    ENVIRONMENT_LABELS,
    PAPER_LABELS,
    paper_cells,
    parse_seeds,
    seeds_with_weights,
    summarise,
    table_lines,
    table_rows,
)
from agility_ref.stats import wilson_interval
from agility_ref.training.policies import TABLE_ROWS
from agility_ref.training.runs import TrainConfig

import mujoco
import numpy as np
import pytest

TWO = EvaluationConfig(episodes=2)


def make_cell(policy="walk", environment="gap", seed=0, protocol="complete", steps=1000, **metrics):
    n = len(next(iter(metrics.values()), (0, 0)))
    arrays = {m: np.asarray(metrics.get(m, np.zeros(n)), float) for m in METRICS}
    return Cell(policy, environment, seed, arrays, {"steps": steps, "evaluation": {"protocol": protocol}})


# --- the paper's figures ---------------------------------------------------------------


def test_43_cells():
    paper = paper_cells()
    assert len(paper) == 43
    missing = [(e, p) for e in ENVIRONMENT_LABELS.values() for p in PAPER_LABELS.values() if (e, p) not in paper]
    assert missing == [("Beam", "Climb")]


def test_every_cell_has_a_row_and_a_column():
    for environment, policy in paper_cells():
        assert environment in ENVIRONMENT_LABELS.values()
        assert policy in [PAPER_LABELS[name] for name in TABLE_ROWS]


def test_known_cells():
    paper = paper_cells()
    assert paper["Climb", "Climb"]["waypoint_fraction"] == (0.99, 0.07)
    assert paper["Gap", "PS-SL-5"]["reward"] == (20.82, 7.25)
    assert paper["Climb+Gap", "CD"]["edge_violation"] == (1.09, 0.59)


def test_dashes_are_nan():
    paper = paper_cells()
    assert all(math.isnan(x) for x in paper["Beam", "PS-RL-3"]["reward"])
    assert all(math.isnan(x) for x in paper["Gap", "Oracle"]["edge_violation"])
    dashes = [m for figures in paper.values() for m, v in figures.items() if math.isnan(v[0])]
    # the three hierarchies have no edge violation on any of four terrains, and one reward is missing
    assert sorted(dashes) == ["edge_violation"] * 12 + ["reward"]


def test_lines_are_the_papers_and_four_more():
    lines = table_lines()
    assert len(lines) == len(set(lines)) == 43 + 16
    rows = table_rows({})
    assert [(r.environment, r.policy) for r in rows if r.paper] == list(paper_cells())  # in the paper's order
    assert {r.policy for r in rows if r.paper is None} == {"PS-RL-3 (env)", "PS-RL-3 (oracle)", "Distilled", "Post-GEN"}
    assert all(r.ours is None for r in rows)


# --- seeds -----------------------------------------------------------------------------


@pytest.mark.parametrize("words, seeds", [
    (["0"], (0,)), (["0", "2", "1"], (0, 1, 2)), (["0,2"], (0, 2)), (["1,", "1"], (1,)), (["all"], None),
])  # fmt: skip
def test_parse_seeds(words, seeds):
    assert parse_seeds(words) == seeds


@pytest.mark.parametrize("words", [[], [""], ["-1"], ["a"], ["all", "1"], ["1.5"]])
def test_bad_seeds(words):
    with pytest.raises(UserError, match="numbers such as 0 1 2, or all"):
        parse_seeds(words)


def test_seeds_with_weights_need_every_skill(tmp_path, monkeypatch, finished_run):
    monkeypatch.setattr("agility_ref.training.weights.FOLDER", tmp_path / "shipped")
    training = TrainConfig(out=str(tmp_path / "runs"))
    for name, seeds in {"walk": (0, 1, 12), "climb": (1, 12), "leap": (0, 1, 12), "ps-rl-3-oracle": (0, 12)}.items():
        for seed in seeds:
            finished_run(tmp_path / "runs", name, seed)
    (tmp_path / "runs" / "walk" / "seed1" / "DONE").unlink()
    (tmp_path / "shipped").mkdir()
    (tmp_path / "shipped" / "climb-full-seed0.npz").touch()
    (tmp_path / "shipped" / "climb-quick-seed3.npz").touch()
    (tmp_path / "shipped" / "climb-up-full-seed4.npz").touch()
    assert seeds_with_weights("walk", training) == (0, 12)
    assert seeds_with_weights("climb", training) == (0, 1, 12)
    assert seeds_with_weights("ps-rl-3", training) == (0, 12)
    assert seeds_with_weights("gen-3", training) == (0,)  # none: the error will name this one


# --- summary ---------------------------------------------------------------------------


def test_summary_pools_the_episodes_of_all_seeds():
    a, b = make_cell(reward=[1.0, 3.0]), make_cell(seed=1, reward=[5.0, 7.0], steps=2001)
    ours = summarise([a, b])
    # mean 4; deviations -3 -1 1 3: sqrt((9 + 1 + 1 + 9) / 4) = sqrt 5
    assert ours.mean_std["reward"] == pytest.approx((4.0, 5**0.5))
    assert ours.iqm["reward"][0] == 4.0  # 1 | 3 5 | 7
    assert ours.iqm["reward"][1] < 4.0 < ours.iqm["reward"][2]
    assert ours.steps == 1500 and ours.seeds == (0, 1)


def test_success_is_all_eight_waypoints():
    ours = summarise([make_cell(waypoint_fraction=[1.0, 0.875] + [1.0] * 7 + [0.0])])
    # 8 of 10, whose Wilson interval is in stats.py
    assert ours.success == pytest.approx((0.8, 0.4902, 0.9433), abs=1e-4)


def test_success_that_no_seed_has_is_not_certain():
    # Wilson for 0 of 10 episodes, not of 20: both seeds play the same courses
    ours = summarise([make_cell(seed=k, waypoint_fraction=[0.5] * 10) for k in (0, 1)])
    assert ours.success == pytest.approx((0.0, *wilson_interval(0, 10))) and ours.success[2] > 0.25


def test_seeds_that_disagree_widen_the_success_interval():
    ours = summarise([make_cell(seed=k, waypoint_fraction=[float(k)] * 10) for k in (0, 1)])
    assert ours.success == (0.5, 0.0, 1.0)


def test_seeds_may_differ_in_episodes_as_published():
    a, b = (make_cell(seed=k, protocol="as-published", reward=r) for k, r in enumerate(([1.0, 2.0, 6.0], [3.0])))
    ours = summarise([a, b])
    # mean 3; deviations -2 -1 3 0: sqrt((4 + 1 + 9 + 0) / 3), the sample deviation
    assert ours.mean_std["reward"] == pytest.approx((3.0, (14 / 3) ** 0.5))
    assert ours.iqm == {} and ours.success is None


# --- computing -------------------------------------------------------------------------


@pytest.fixture
def played(tmp_path, monkeypatch, finished_run):
    """Weights of walk and climb, seeds 0 and 1; return the log of what a fake simulation played."""
    monkeypatch.setattr("agility_ref.training.weights.shipped", lambda *key: None)
    monkeypatch.setattr("agility_ref.training.weights.FOLDER", tmp_path / "nothing")
    for name in ("walk", "climb"):
        for seed in (0, 1):
            finished_run(tmp_path / "runs", name, seed)
    log = []

    def evaluate(policy, environment, config):
        log.append((policy.name, environment))
        rng = np.random.default_rng([len(policy.name), len(environment)])
        values = {m: rng.random(config.episodes) for m in METRICS}
        n = config.episodes
        return Evaluation(policy.name, environment, config, **values, fell=np.zeros(n, bool),
                          difficulty=np.zeros(n), skill=None, oracle=None)  # fmt: skip

    monkeypatch.setattr(cells, "evaluate_by_protocol", evaluate)
    return log


def compute(tmp_path, seeds=(0,), folder="cells"):
    return table1.compute(TWO, TrainConfig(out=str(tmp_path / "runs")), tmp_path / folder, seeds)


def test_compute_without_weights_says_what_is_missing(tmp_path, monkeypatch):
    monkeypatch.setattr("agility_ref.training.weights.shipped", lambda *key: None)
    found, missing = compute(tmp_path)
    assert found == {} and len(missing) == len(set(missing)) > 0
    assert all("agility-ref train" in line for line in missing)


def test_compute_fills_the_cells_that_have_weights(tmp_path, played):
    found, missing = compute(tmp_path)
    filled = {(r.environment, r.policy) for r in table_rows(found) if r.ours}
    assert filled == {(e, "Walk") for e in ENVIRONMENT_LABELS.values()} | {
        (e, "Climb") for e in ENVIRONMENT_LABELS.values() if e != "Beam"
    }
    assert list(found) == [(p, e, 0) for p, e in played] and len(found) == 7
    assert any("agility-ref train leap" in line for line in missing)


def test_a_bad_config_is_an_error_even_without_weights(tmp_path):
    with pytest.raises(UserError, match="episodes"):
        table1.compute(EvaluationConfig(episodes=0), TrainConfig(out=str(tmp_path)), tmp_path / "cells")


def test_compute_all_seeds(tmp_path, played, finished_run):
    finished_run(tmp_path / "runs", "walk", 5)
    found, _ = compute(tmp_path, None)
    rows = {(r.environment, r.policy): r for r in table_rows(found)}
    assert rows["Gap", "Walk"].ours.seeds == (0, 1, 5) and rows["Gap", "Climb"].ours.seeds == (0, 1)


def test_a_seed_without_weights_leaves_the_others(tmp_path, played):
    found, missing = compute(tmp_path, (0, 7))
    rows = {(r.environment, r.policy): r for r in table_rows(found)}
    assert rows["Gap", "Walk"].ours.seeds == (0,)
    assert any("train walk --preset full --seed 7" in line for line in missing)


def test_an_interrupted_table_goes_on(tmp_path, played, monkeypatch):
    whole = [row.ours for row in table_rows(compute(tmp_path, (0, 1), "whole")[0])]
    everything, simulation = list(played), cells.evaluate_by_protocol
    played.clear()

    def stops(policy, environment, config):
        if len(played) == 5:
            raise KeyboardInterrupt
        return simulation(policy, environment, config)

    monkeypatch.setattr(cells, "evaluate_by_protocol", stops)
    with pytest.raises(KeyboardInterrupt):
        compute(tmp_path, (0, 1), "halved")
    monkeypatch.setattr(cells, "evaluate_by_protocol", simulation)
    assert [row.ours for row in table_rows(compute(tmp_path, (0, 1), "halved")[0])] == whole
    assert played == everything  # each once
    for path in (tmp_path / "whole").iterdir():
        assert path.read_bytes() == (tmp_path / "halved" / path.name).read_bytes()


def test_both_names_of_a_selector_show_its_cell(tmp_path, played, finished_run):
    for name in ("climb", "leap"):
        finished_run(tmp_path / "runs", name, start=1000)
    finished_run(tmp_path / "runs", "ps-rl-3-oracle", act_dim=3, steps=7)
    rows = {r.policy: r for r in table_rows(compute(tmp_path)[0]) if r.environment == "Gap"}
    assert rows["PS-RL-3"].ours == rows["PS-RL-3 (oracle)"].ours is not None
    assert rows["PS-RL-3 (env)"].ours is None
    assert sum(name == "ps-rl-3-oracle" for name, _ in played) == 4  # once a terrain
    assert rows["PS-RL-3"].ours.steps == 1007  # 1000 of walk, nothing beyond it for climb and leap, 7 of its own


# --- the published table ---------------------------------------------------------------


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="other processors round otherwise")
@pytest.mark.skipif((mujoco.__version__, np.__version__) != ("4.0.0", "2.4.6"), reason="the table was made by others")
def test_the_published_table_is_that_of_the_shipped_weights():
    """To the last printed digit, on any processor; a process of its own, for numpy reads its settings once."""
    with open(Path(__file__).parents[2] / "docs" / "full" / "table1.csv", newline="") as file:
        published = {(row["environment"], row["policy"]): row for row in csv.DictReader(file)}["Beam", "CU"]
    command = [sys.executable, "-m", "agility_ref", "evaluate", "climb-up", "--environment", "beam", "--seed", "1"]
    played = json.loads(subprocess.run([*command, "--json"], capture_output=True, text=True, check=True).stdout)
    for metric in METRICS:
        assert f"{played[metric]['mean']:.4f}" == published[f"{metric}_mean_ours"]
        assert f"{played[metric]['std']:.4f}" == published[f"{metric}_std_ours"]


def test_the_interval_of_the_iqm_is_that_of_the_iqm():
    ours = summarise([make_cell(reward=[0.0] * 15 + [1e6])])
    assert ours.iqm["reward"] == (0.0, 0.0, 0.0)

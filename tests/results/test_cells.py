import ast
import json
from dataclasses import replace
from pathlib import Path

from agility_ref.env import EnvConfig, Go1Env
from agility_ref.errors import UserError
from agility_ref.evaluate import METRICS, Evaluation, EvaluationConfig, evaluate
from agility_ref.files import read_npz, write_npz
from agility_ref.results import cells
from agility_ref.results.cells import (
    SOURCES,
    cell_path,
    choices,
    commonest_share,
    enter,
    find_cell,
    oracle_accuracy,
    origin,
    seeds_of,
    stack,
    steps_spent,
    switches_per_second,
)
from agility_ref.results.published import evaluate_by_protocol
from agility_ref.selector import Hierarchy, Single, oracle_hierarchy
from agility_ref.terrain import SKILLS
from agility_ref.training.runs import TrainConfig
from agility_ref.training.weights import sha256

import numpy as np
import pytest

FIVE = ("walk", "climb-up", "climb-down", "leap", "beam")
CONFIG = EvaluationConfig(episodes=3, seed=4)
SHORT = EnvConfig(episode_seconds=1.2)  # 30 steps
FEW = EvaluationConfig(episodes=3, seed=1)
PUBLISHED = replace(FEW, protocol="as-published")


@pytest.fixture
def bank(tmp_path, monkeypatch, finished_run):
    """The five specialists and PS-SL-5 as finished runs of seed 0; nothing is shipped."""
    monkeypatch.setattr("agility_ref.training.weights.shipped", lambda *key: None)
    for name, steps in zip(FIVE, (100, 250, 220, 300, 180), strict=True):
        finished_run(tmp_path / "runs", name, steps=steps, start=0 if name == "walk" else 100)
    finished_run(tmp_path / "runs", "ps-sl-5", steps=50, obs_dim=132, act_dim=5)
    finished_run(tmp_path / "runs", "distilled", steps=40)
    finished_run(tmp_path / "runs", "post-gen", steps=90, start=40)
    return TrainConfig(out=str(tmp_path / "runs"))


@pytest.fixture
def played(monkeypatch):
    """Replace the simulation by numbers; return the list of what was played."""
    log = []

    def evaluate(policy, environment, config):
        log.append((policy.name, environment))
        values = {m: np.arange(config.episodes) + 10.0 * k + 0.1 for k, m in enumerate(METRICS)}
        skill = np.array([[0, 1, 1], [0, 0, 1], [1, -1, 1], [1, -1, 1]]) if hasattr(policy, "skills") else None
        return Evaluation(policy.name, environment, config, **values, fell=np.array([True, False, True]),
                          difficulty=np.linspace(0, 1, 3), skill=skill, oracle=skill, dt=0.5)  # fmt: skip

    monkeypatch.setattr(cells, "evaluate_by_protocol", evaluate)
    return log


def find(bank, folder, policy="walk", environment="gap", config=CONFIG):
    return find_cell(enter(policy, bank), environment, config, folder)


# --- storing ---------------------------------------------------------------------------


def test_a_cell_is_stored_and_read_back(bank, played, tmp_path):
    first = find(bank, tmp_path / "cells")
    again = find(bank, tmp_path / "cells")
    assert played == [("walk", "gap")]
    assert first.meta == again.meta and first.arrays.keys() == again.arrays.keys()
    for name, values in first.arrays.items():
        assert np.array_equal(values, again.arrays[name]) and values.dtype == again.arrays[name].dtype
    assert set(first.arrays) == {*METRICS, "fell", "difficulty"}
    assert (again.policy, again.environment, again.seed, again.protocol) == ("walk", "gap", 0, "complete")


def test_the_file_says_what_it_was_made_from(bank, played, tmp_path):
    find(bank, tmp_path / "cells", "ps-sl-5")
    path = tmp_path / "cells" / "ps-sl-5-gap-seed0.npz"
    with np.load(path, allow_pickle=False) as file:
        meta = json.loads(str(file["__meta__"]))
    assert meta["evaluation"]["episodes"] == 3 and meta["evaluation"]["seed"] == 4
    own = tmp_path / "runs" / "leap" / "seed0" / "policy.npz"
    assert set(meta["weights"]) == {"ps-sl-5", *FIVE} and meta["weights"]["leap"] == sha256(own)
    assert [p.name for p in path.parent.iterdir()] == [path.name]  # no partial file is left


def test_hierarchies_keep_what_was_chosen(bank, played, tmp_path):
    arrays = find(bank, tmp_path / "cells", "oracle").arrays
    # steps of 0.5 s: 0 0 1 1 switches once in 2 s; 1 0 then ends, once in 1 s; 1 1 1 1 never
    np.testing.assert_allclose(arrays["switches_per_second"], [0.5, 1.0, 0.0])
    np.testing.assert_allclose(arrays["commonest_share"], [0.5, 0.5, 1.0])
    np.testing.assert_allclose(arrays["oracle_accuracy"], 1.0)


def test_an_alias_shares_the_cell(bank, played, tmp_path, finished_run):
    for name in ("climb", "ps-rl-3-oracle"):
        finished_run(tmp_path / "runs", name, act_dim=12 if name == "climb" else 3)
    a, b = (find(bank, tmp_path / "cells", name) for name in ("ps-rl-3", "ps-rl-3-oracle"))
    assert a.policy == b.policy == "ps-rl-3-oracle" and len(played) == 1


# --- playing again ---------------------------------------------------------------------


@pytest.mark.parametrize("changed", [
    EvaluationConfig(episodes=3, seed=5), EvaluationConfig(episodes=4, seed=4), EvaluationConfig(3, 4, clean=True),
    EvaluationConfig(3, 4, difficulty=0.5), EvaluationConfig(3, 4, protocol="as-published"),
])  # fmt: skip
def test_another_evaluation_is_played(bank, played, tmp_path, changed):
    find(bank, tmp_path)
    walk = enter("walk", bank)
    assert origin(walk, "gap", changed) != origin(walk, "gap", CONFIG)
    if changed.episodes == 3:
        find(bank, tmp_path, config=changed)
        assert len(played) == 2


@pytest.mark.parametrize("policy, retrained, times", [
    ("leap", "leap", 2), ("oracle", "leap", 2), ("ps-sl-5", "ps-sl-5", 2), ("walk", "leap", 1),
])  # fmt: skip
def test_other_weights_are_played(bank, played, tmp_path, finished_run, policy, retrained, times):
    find(bank, tmp_path, policy)
    shape = {"obs_dim": 132, "act_dim": 5} if retrained == "ps-sl-5" else {}
    finished_run(tmp_path / "runs", retrained, gain=50.0, **shape)
    find(bank, tmp_path, policy)
    assert len(played) == times


def test_other_code_is_played(bank, played, tmp_path, monkeypatch):
    find(bank, tmp_path)
    monkeypatch.setattr(cells, "code_digest", lambda: "another")
    find(bank, tmp_path)
    assert len(played) == 2


@pytest.mark.parametrize("damage", [
    lambda path: path.write_bytes(path.read_bytes()[:100]),
    lambda path: path.write_text("hello"),
    lambda path: np.savez(path, reward=np.zeros(3)),
    lambda path: write_npz(path, {"reward": np.zeros(3)}, read_npz(path)[1]),
])  # fmt: skip
def test_damaged_cells_are_played_again(bank, played, tmp_path, damage):
    find(bank, tmp_path)
    damage(cell_path(tmp_path, "walk", "gap", 0))
    assert set(METRICS) <= set(find(bank, tmp_path).arrays)
    assert len(played) == 2


def test_missing_weights_name_the_command(bank):
    with pytest.raises(UserError, match="agility-ref train gen-3"):
        enter("gen-3", bank)


# --- steps -----------------------------------------------------------------------------


@pytest.mark.parametrize("policy, expected", [
    ("walk", 100),
    ("leap", 300),  # its warm start is in there
    # walk 100; the others without it: 150 + 120 + 200 + 80
    ("oracle", 650),
    ("ps-sl-5", 700),  # 50 of its own
    ("distilled", 690),  # the bank, and 40 states
    ("post-gen", 740),  # those 40 among its 90
])  # fmt: skip
def test_steps_spent_by_hand(bank, policy, expected):
    assert steps_spent(policy, bank) == expected


def test_a_post_generalist_from_scratch_owes_nothing_to_teachers(bank, tmp_path, finished_run):
    finished_run(tmp_path / "runs", "post-gen", steps=123, start=0)
    assert steps_spent("post-gen", bank) == 123


def test_a_skill_from_scratch_has_no_warm_start_to_share(bank, tmp_path, finished_run):
    finished_run(tmp_path / "runs", "beam", steps=180, start=0)
    assert steps_spent("oracle", bank) == 750  # 100 + 150 + 120 + 200 + 180


def test_what_a_skill_started_from_counts_not_what_lies_there_now(bank, tmp_path, finished_run):
    finished_run(tmp_path / "runs", "walk", steps=400, start=0)  # trained longer after the others had begun
    assert steps_spent("oracle", bank) == 950  # 400 + 150 + 120 + 200 + 80


# --- stacking --------------------------------------------------------------------------


def test_stack_has_a_row_a_seed(bank, played, tmp_path):
    cell = find(bank, tmp_path)
    table = {("walk", "gap", seed): cell for seed in (2, 0)} | {("walk", "beam", 1): cell}
    assert seeds_of(table, "walk", "gap") == [0, 2] and seeds_of(table, "leap", "gap") == []
    assert stack(table, "walk", "gap", "fell", [0, 2]).tolist() == [[1, 0, 1], [1, 0, 1]]


# --- the code behind a cell --------------------------------------------------------------


def imported(name):
    """Modules of the package that a module imports at its top, itself included, as SOURCES names them."""
    package = Path(cells.__file__).parent.parent
    tree = ast.parse((package / f"{name}.py").read_text())
    found = {name}
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("agility_ref"):
            below = node.module.split(".")[1:]
            names = ["/".join(below)] if below else [alias.name for alias in node.names]
            if below and not (package / f"{names[0]}.py").exists():  # from a room
                names = [f"{names[0]}/{alias.name}" for alias in node.names]
            found |= set().union(*(imported(n) for n in names if n != name))
    return found


def test_every_file_behind_an_episode_is_in_the_digest():
    # errors.py holds messages alone
    assert (imported("evaluate") | imported("results/published")) - {"errors"} <= set(SOURCES)


def test_the_digest_is_that_of_the_text(monkeypatch, tmp_path):
    for name in cells.SOURCES:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / f"{name}.py").write_text(name)
    monkeypatch.setattr(cells, "__file__", str(tmp_path / "results" / "cells.py"))
    before = cells.code_digest.__wrapped__()
    (tmp_path / "env.py").write_text("another")
    assert cells.code_digest.__wrapped__() != before


@pytest.mark.parametrize("what", ["mujoco.__version__", "numpy.__version__"])
def test_another_simulator_is_played(bank, played, tmp_path, monkeypatch, what):
    find(bank, tmp_path)
    monkeypatch.setattr(what, "0")
    find(bank, tmp_path)
    assert len(played) == 2


# --- what a selector did, by hand --------------------------------------------------------
# The first episode lasts six steps, the second ends with step 4 of 6.

SKILL = np.array([[0, 2], [0, 2], [1, 2], [0, 2], [0, -1], [2, -1]])
WANTED = np.array([[0, 0], [1, 0], [1, 2], [1, 2], [1, -1], [2, -1]])


def test_switches_per_second_by_hand():
    # 0 0 1 0 0 2: three changes in 6 x 0.5 s; 2 2 2 2: none, and its end is no change
    np.testing.assert_allclose(switches_per_second(SKILL, 0.5), [1.0, 0.0])
    # 0 1 1 1 1 2: two in 3 s; 0 0 2 2: one in 2 s
    np.testing.assert_allclose(switches_per_second(WANTED, 0.5), [2 / 3, 0.5])


def test_commonest_share_by_hand():
    # skill 0 took 4 of 6 steps; skill 2 all of them
    np.testing.assert_allclose(commonest_share(SKILL), [4 / 6, 1.0])
    np.testing.assert_allclose(commonest_share(WANTED), [4 / 6, 0.5])


def test_oracle_accuracy_by_hand():
    # right in steps 0, 2, 5 of 6; in steps 2, 3 of 4
    np.testing.assert_allclose(oracle_accuracy(SKILL, WANTED), [0.5, 0.5])


def test_one_step_has_no_switch():
    np.testing.assert_array_equal(switches_per_second(np.array([[3, 1]]), 0.02), [0.0, 0.0])


def test_choices_are_measured_in_complete_episodes_only(five_skills):
    oracle = oracle_hierarchy("oracle", five_skills)
    published = evaluate_by_protocol(oracle, "gap", PUBLISHED, SHORT)
    assert published.skill is None and choices(published) == {}


def test_choices_of_a_constant_selector(five_skills):
    hierarchy = Hierarchy("always leap", tuple(five_skills.values()), lambda o, env: np.full(len(o), 3), np.arange(5))
    evaluation = evaluate(hierarchy, "gap", FEW, SHORT)
    chosen = choices(evaluation)
    np.testing.assert_array_equal(chosen["commonest_share"], 1.0)
    np.testing.assert_array_equal(chosen["switches_per_second"], 0.0)
    np.testing.assert_array_equal(
        chosen["oracle_accuracy"], (evaluation.oracle == 3).sum(0) / (evaluation.oracle >= 0).sum(0)
    )


def test_the_oracle_is_what_it_wants(five_skills):
    chosen = choices(evaluate(oracle_hierarchy("oracle", five_skills), "gap", FEW, SHORT))
    for name in ("switches_per_second", "commonest_share"):
        np.testing.assert_array_equal(chosen[name], chosen[f"wanted_{name}"])


def test_policies_without_skills_make_no_choices(make_policy):
    assert choices(evaluate(Single("random", make_policy()), "gap", FEW, SHORT)) == {}


def test_a_skill_for_both_ways_is_right_on_a_step_down(make_policy, monkeypatch):
    three = {name: make_policy(k, name) for k, name in enumerate(("walk", "climb", "leap"))}
    monkeypatch.setattr(Go1Env, "oracle_skill", lambda self: np.full(self.num_envs, SKILLS.index("climb-down")))
    chosen = choices(evaluate(oracle_hierarchy("oracle", three), "climb", FEW, SHORT))
    assert chosen["oracle_accuracy"].tolist() == [1.0] * 3

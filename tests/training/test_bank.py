from dataclasses import replace

from agility_ref.env import ACTION_DIM
from agility_ref.errors import UserError
from agility_ref.observation import OBS_DIM
from agility_ref.selector import Single
from agility_ref.training.bank import find_weights, load_policy, run_folder, weights_path
from agility_ref.training.runs import TrainConfig

import numpy as np
import pytest


@pytest.fixture(autouse=True)
def alone(monkeypatch):
    """Tests find their own runs only."""
    monkeypatch.setattr("agility_ref.training.weights.shipped", lambda *key: None)


@pytest.fixture
def config(tmp_path):
    return TrainConfig(preset="quick", out=str(tmp_path))


def test_own_runs_come_before_shipped_weights(config, tmp_path, finished_run, monkeypatch):
    shipped = tmp_path / "shipped.npz"
    shipped.touch()
    monkeypatch.setattr("agility_ref.training.weights.shipped", lambda *key: shipped)
    assert weights_path("walk", config) == shipped
    folder = finished_run(tmp_path, "walk")
    assert weights_path("walk", config) == folder / "policy.npz"


def test_unfinished_runs_are_not_used(config, tmp_path, finished_run):
    (finished_run(tmp_path, "walk") / "DONE").unlink()
    with pytest.raises(UserError, match="agility-ref train walk --preset quick --seed 0"):
        weights_path("walk", config)


def test_load_policy_single(config, tmp_path, finished_run):
    finished_run(tmp_path, "walk")
    policy = load_policy("walk", config)
    assert isinstance(policy, Single)
    assert policy.act(np.zeros((2, OBS_DIM), np.float32), None)[0].shape == (2, ACTION_DIM)


def test_aliases_share_a_folder(tmp_path):
    assert run_folder(tmp_path, "ps-rl-3", 2).name == "seed2"
    assert run_folder(tmp_path, "ps-rl-3", 2).parent.name.startswith("ps-rl-3-")


def test_a_policy_of_another_shape_is_refused(config, tmp_path, finished_run):
    finished_run(tmp_path, "walk", obs_dim=48)
    with pytest.raises(UserError, match="48 -> 12"):
        load_policy("walk", config)


@pytest.mark.parametrize("env", [[], "fast", {"action_scale": "x"}])
def test_a_record_whose_task_is_no_task_is_refused(config, tmp_path, finished_run, env):
    finished_run(tmp_path, "walk", config={"env": env})
    with pytest.raises(UserError, match=r"policy\.npz is damaged: its record has env") as error:
        load_policy("walk", config)
    assert "\n" not in str(error.value)


def test_a_skill_of_another_shape_is_refused(config, tmp_path, finished_run):
    for skill in ("walk", "climb-up", "climb-down", "leap"):
        finished_run(tmp_path, skill)
    finished_run(tmp_path, "beam", obs_dim=48)
    with pytest.raises(UserError, match="48 -> 12"):
        load_policy("oracle", config)


def test_a_selector_over_other_skills_is_refused(config, tmp_path, finished_run):
    for skill in ("walk", "climb", "leap"):
        finished_run(tmp_path, skill)
    finished_run(tmp_path, "ps-rl-3-oracle", act_dim=5)
    with pytest.raises(UserError, match=r"-> 5.*-> 3"):
        load_policy("ps-rl-3", config)


def test_default_root_follows_the_preset():
    assert TrainConfig(preset="quick").root.as_posix() == "runs/quick"
    assert TrainConfig(out="elsewhere").root.as_posix() == "elsewhere"


def test_a_run_of_another_preset_is_refused(config, tmp_path, finished_run):
    folder = finished_run(tmp_path, "walk", preset="quick")
    (folder / "config.json").write_text('{"preset": "quick"}')
    with pytest.raises(UserError, match="was trained under the preset quick, not full"):
        load_policy("walk", replace(config, preset="full"))


@pytest.mark.parametrize("text", ["{", "[1, 2]", ""])
def test_damaged_settings_are_named(tmp_path, finished_run, text):
    finished_run(tmp_path, "walk")
    (run_folder(tmp_path, "walk", 0) / "config.json").write_text(text)
    with pytest.raises(UserError, match=r"walk.seed0.config\.json is damaged"):
        find_weights("walk", TrainConfig(out=str(tmp_path)))


def test_the_command_that_trains_what_is_missing_trains_it_there(tmp_path):
    with pytest.raises(UserError, match=rf"agility-ref train leap --preset full --seed 7 --out {tmp_path}$"):
        weights_path("leap", TrainConfig(seed=7, out=str(tmp_path)))

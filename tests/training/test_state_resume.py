from dataclasses import replace

from agility_ref.curriculum import CurriculumConfig
from agility_ref.env import TRAINING
from agility_ref.errors import UserError
from agility_ref.files import read_npz, write_npz
from agility_ref.ppo import PPOConfig
from agility_ref.training import runs
from agility_ref.training.bank import run_folder
from agility_ref.training.runs import TrainConfig, train_policy

import numpy as np
import pytest

PPO = PPOConfig(num_envs=6, num_steps=5, hidden=(8,), update_epochs=2, num_minibatches=2)
BATCH = 30


@pytest.fixture
def config(tmp_path, monkeypatch):
    """Episodes of at most 12 steps, so that many end, pushes every 3, and two levels."""
    monkeypatch.setattr("agility_ref.training.weights.shipped", lambda *key: None)
    env = replace(TRAINING, episode_seconds=0.48, push_interval=0.12)
    return TrainConfig(
        preset="quick", out=str(tmp_path), steps=8 * BATCH, ppo=PPO, env=env, warm_start=False,
        curriculum=CurriculumConfig(num_levels=2, variants=2),
    )  # fmt: skip


def stop_after(iterations, monkeypatch):
    asked = []
    monkeypatch.setattr(runs.StopRequest, "requested", lambda self: asked.append(1) or len(asked) > iterations)


@pytest.mark.parametrize("policy", ["walk", "gen-3", "ps-rl-3-env"])
def test_a_run_that_was_stopped_is_the_run_that_was_not(config, tmp_path, policy, monkeypatch, finished_run):
    for part in ("whole", "parts"):
        for skill in ("walk", "climb", "leap") if policy.startswith("ps") else ():
            finished_run(tmp_path / part, skill)
    whole = train_policy(policy, replace(config, out=f"{tmp_path}/whole"), quiet=True)
    config = replace(config, out=f"{tmp_path}/parts")
    for iterations in (1, 2, 0, 3):
        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            stop_after(iterations, patch)
            train_policy(policy, config, quiet=True)
    parts = train_policy(policy, config, quiet=True)
    first, second = (read_npz(folder / "policy.npz")[0] for folder in (whole, parts))
    assert first.keys() == second.keys()
    for name in first:
        np.testing.assert_array_equal(first[name], second[name], err_msg=name)
    clock = {"wall_seconds", "steps_per_second"}
    rows = [
        [
            {k: v for k, v in row.items() if k not in clock}
            for row in runs.rows_until(
                folder / "progress.csv",
                0,
                8 * BATCH,
                BATCH,
                tuple(f"level_{kind}" for kind in ("climb", "gap", "walk")) if policy == "gen-3" else (),
            )
        ]
        for folder in (whole, parts)
    ]
    assert len(rows[0]) == 8 and rows[0] == rows[1]


def test_the_state_of_a_run_is_small(config):
    """At most 5 MB beside weights and moments, at the 256 robots of the table."""
    env, curriculum = runs.make_env(runs.find_policy("walk"), replace(config, ppo=replace(PPO, num_envs=256)))
    assert sum(a.nbytes for a in runs.robots_state(env, curriculum).values()) < 5e6


@pytest.mark.parametrize("change, message", [
    ({"env.course": None}, r"lacks the state of a training run \(env\.course\)"),
    ({"env.physics": np.zeros(3)}, r"env\.physics is float64 of shape \(3,\), this run needs"),
    ({"env.course": np.zeros(6)}, r"env\.course is float64 of shape \(6,\), this run needs int64 of \(6,\)"),
    ({"env.course": np.full(6, 99)}, r"env\.course of the checkpoint must be from 0 to 3"),
    ({"env.waypoint_index": np.full(6, -1)}, r"env\.waypoint_index of the checkpoint must be from 0 to 7"),
    ({"curriculum.frontier": np.full(1, 2)}, r"curriculum\.frontier of the checkpoint must be from 0 to 1"),
    ({"optimizer.critic.own.0.bias.exp_avg": None}, r"\(optimizer\.critic\.own\.0\.bias\.exp_avg\)"),
    ({"normalizer.mean": np.zeros(1)}, r"normalizer\.mean is"),
    ({"progress.episodes": np.zeros((2, 3))}, "lacks the state of its averages"),
])  # fmt: skip
def test_a_checkpoint_that_no_run_can_go_on_from_is_refused(config, change, message, monkeypatch):
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        stop_after(1, patch)
        train_policy("walk", config, quiet=True)
    path = run_folder(config.root, "walk", 0) / "policy.npz"
    arrays, meta = read_npz(path)
    arrays = {name: array for name, array in (arrays | change).items() if array is not None}
    write_npz(path, arrays, {key: value for key, value in meta.items() if key != "schema"})
    with pytest.raises(UserError, match=message):
        train_policy("walk", config, quiet=True)

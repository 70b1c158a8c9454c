import csv
import json
import re
from dataclasses import replace
from itertools import count

from agility_ref.curriculum import CurriculumConfig
from agility_ref.env import ACTION_DIM, EnvConfig
from agility_ref.errors import UserError
from agility_ref.files import read_csv, read_npz, write_npz
from agility_ref.observation import NUM_SCANDOTS, OBS_DIM, SCANDOTS
from agility_ref.pictures.plots import learning_curve
from agility_ref.policy import Policy
from agility_ref.ppo import PPOConfig
from agility_ref.rewards import RewardConfig
from agility_ref.selector import Hierarchy, Single
from agility_ref.terrain import COURSE_KINDS
from agility_ref.training import policies, runs, weights
from agility_ref.training.bank import find_weights, load_policy, run_folder
from agility_ref.training.imitation import DistillConfig, FineTuneConfig, SupervisedConfig
from agility_ref.training.lock import locked
from agility_ref.training.policies import find_policy
from agility_ref.training.progress import PROGRESS
from agility_ref.training.runs import TrainConfig, ppo_config, train_policy
from agility_ref.training.state import learner_state, policy_arrays

import numpy as np
import pytest

BATCH = 8 * 4
TINY = PPOConfig(num_envs=8, num_steps=4, hidden=(8,), update_epochs=1, num_minibatches=1)


@pytest.fixture(autouse=True)
def alone(monkeypatch):
    """Tests find their own runs only."""
    monkeypatch.setattr("agility_ref.training.weights.shipped", lambda *key: None)


@pytest.fixture
def config(tmp_path):
    return TrainConfig(
        preset="quick", out=str(tmp_path), steps=3 * BATCH, ppo=TINY,
        curriculum=CurriculumConfig(num_levels=2, variants=1), supervised=SupervisedConfig(epochs=2, hidden=(8,)),
    )  # fmt: skip


def progress(folder):
    with open(folder / "progress.csv", newline="") as file:
        return list(csv.DictReader(file))


def steps_of(folder):
    return [int(row["steps"]) for row in progress(folder)]


# --- a run -----------------------------------------------------------------------------


def test_a_run_writes_its_files(config, tmp_path):
    folder = train_policy("walk", config, quiet=True, draw=learning_curve)
    assert folder == tmp_path / "walk" / "seed0"
    written = {p.name for p in folder.iterdir()}
    assert {"DONE", "config.json", "learning_curve.png", "policy.npz", "progress.csv"} <= written
    assert (folder / "learning_curve.png").read_bytes().startswith(b"\x89PNG")
    assert not list(tmp_path.rglob("*.partial*"))


def test_progress_has_a_row_an_iteration(config):
    folder = train_policy("walk", config, quiet=True)
    assert steps_of(folder) == [BATCH, 2 * BATCH, 3 * BATCH]
    assert list(progress(folder)[0]) == list(PROGRESS)


def test_config_is_recorded(config):
    record = json.loads((train_policy("walk", config, quiet=True) / "config.json").read_text())
    assert record["policy"] == "walk"
    assert record["ppo"]["num_envs"] == 8 and record["preset"] == "quick" and record["steps"] == 3 * BATCH


def test_a_trained_policy_sees_what_its_own_courses_show(config):
    """Rough ground of d <= 0.4 has tiles within +-0.018 m: nothing of it lies 0.2 m above or below a robot."""
    arrays, _ = read_npz(train_policy("walk", config, quiet=True) / "policy.npz")
    assert (np.abs([arrays["seen.low"][SCANDOTS], arrays["seen.high"][SCANDOTS]]) < 0.2).all()
    free = replace(config, sight=False, out=config.out + "/free")
    assert "seen.low" not in read_npz(train_policy("walk", free, quiet=True) / "policy.npz")[0]


def test_a_selector_sees_all_there_is(config, tmp_path, finished_run):
    for skill in find_policy("ps-rl-3").skills:
        finished_run(tmp_path, skill)
    arrays, _ = read_npz(train_policy("ps-rl-3", config, quiet=True) / "policy.npz")
    assert "seen.low" not in arrays


def test_checkpoint_holds_what_training_needs(config):
    arrays, meta = read_npz(train_policy("walk", config, quiet=True) / "policy.npz")
    assert meta["policy"] == "walk" and meta["steps"] == 3 * BATCH and meta["seed"] == 0
    assert {"python", "numpy", "mujoco"} <= set(meta["versions"])
    assert arrays["normalizer.count"] == 3 * BATCH
    assert "optimizer.actor.own.0.weight.exp_avg" in arrays
    assert "curriculum.frontier" in arrays and "curriculum.score" in arrays


def test_same_seed_same_run(config, tmp_path):
    a, b = (train_policy("walk", replace(config, out=str(tmp_path / x)), quiet=True) for x in "ab")
    first, second = (read_npz(folder / "policy.npz")[0] for folder in (a, b))
    for name in first:
        np.testing.assert_array_equal(first[name], second[name], err_msg=name)


def test_threads_a_bar_and_the_folder_do_not_change_a_bit(config, tmp_path, monkeypatch):
    runs_ = {}
    for threads, quiet, here in (("1", True, "a"), ("2", False, "b")):
        (tmp_path / here).mkdir()
        monkeypatch.chdir(tmp_path / here)
        monkeypatch.setenv("AGILITY_REF_THREADS", threads)
        folder = train_policy("walk", replace(config, out=str(tmp_path / here / "runs")), quiet=quiet)
        runs_[here] = read_npz(folder / "policy.npz")[0]
    for name in runs_["a"]:
        np.testing.assert_array_equal(runs_["a"][name], runs_["b"][name], err_msg=name)


def test_a_long_run_of_short_iterations(config):
    tiny = PPOConfig(num_envs=1, num_steps=2, hidden=(4,), update_epochs=1, num_minibatches=1)
    folder = train_policy("walk", replace(config, ppo=tiny, steps=2 * 120), quiet=True, draw=learning_curve)
    assert len(steps_of(folder)) == 120


def test_the_learning_curve_is_redrawn_along_the_way(config, monkeypatch):
    # A clock on which every reading is 10 s later than the last, three and a half readings per iteration; one curve per minute.
    clock, drawn = count(0.0, 10.0), []
    monkeypatch.setattr(runs.time, "monotonic", lambda: next(clock))
    config = replace(config, steps=6 * BATCH)
    train_policy("walk", config, quiet=True, draw=lambda csv, png, name: drawn.append(len(read_csv(csv))))
    assert 1 < len(drawn) < 7 and drawn == sorted(drawn) and drawn[0] < drawn[-1] == 6


# --- stopping and going on -------------------------------------------------------------


def test_a_finished_run_is_not_overwritten(config):
    folder = train_policy("walk", config, quiet=True)
    before = (folder / "policy.npz").read_bytes()
    with pytest.raises(UserError, match=r"finished run.*--overwrite"):
        train_policy("walk", config, quiet=True)
    assert (folder / "policy.npz").read_bytes() == before


def test_overwrite_starts_over(config):
    train_policy("walk", config, quiet=True)
    folder = train_policy("walk", replace(config, steps=BATCH, overwrite=True), quiet=True)
    assert steps_of(folder) == [BATCH]


def test_a_stopped_run_goes_on(config):
    folder = train_policy("walk", config, quiet=True)
    first = progress(folder)
    (folder / "DONE").unlink()
    train_policy("walk", replace(config, steps=5 * BATCH), quiet=True)
    assert progress(folder)[:3] == first
    assert steps_of(folder) == [k * BATCH for k in (1, 2, 3, 4, 5)]
    wall = [float(row["wall_seconds"]) for row in progress(folder)]
    assert wall == sorted(wall)
    arrays, meta = read_npz(folder / "policy.npz")
    assert meta["steps"] == 5 * BATCH and arrays["normalizer.count"] == 5 * BATCH
    assert (folder / "DONE").exists()


def test_rows_beyond_the_checkpoint_are_dropped(config):
    # Killed between progress.csv and policy.npz: the next run repeats what the weights lack.
    folder = train_policy("walk", config, quiet=True)
    (folder / "DONE").unlink()
    rows = progress(folder)
    with open(folder / "progress.csv", "a", newline="") as file:
        csv.DictWriter(file, list(rows[0])).writerow(rows[-1] | {"steps": 4 * BATCH})
    train_policy("walk", replace(config, steps=5 * BATCH), quiet=True)
    assert steps_of(folder) == [k * BATCH for k in (1, 2, 3, 4, 5)]


def test_interrupt_saves_and_leaves_no_done(config, monkeypatch):
    monkeypatch.setattr(
        runs.StopRequest, "requested", lambda self: True if self.asked else setattr(self, "asked", True)
    )
    folder = run_folder(config.root, "walk", 0)
    with pytest.raises(KeyboardInterrupt, match="goes on"):
        train_policy("walk", config, quiet=True)
    assert steps_of(folder) == [BATCH]
    assert not (folder / "DONE").exists()
    monkeypatch.undo()
    monkeypatch.setattr("agility_ref.training.weights.shipped", lambda *key: None)
    train_policy("walk", config, quiet=True)
    assert steps_of(folder) == [BATCH, 2 * BATCH, 3 * BATCH]


def test_a_killed_run_loses_no_more_than_one_iteration(config, monkeypatch):
    # No signal handler has a say when a process is killed or the power fails, so what counts is what lies on disk.
    with monkeypatch.context() as patch, pytest.raises(SystemExit):
        killed_in_iteration(3, patch)
        train_policy("walk", replace(config, steps=4 * BATCH), quiet=True)
    folder = run_folder(config.root, "walk", 0)
    assert read_npz(folder / "policy.npz")[1]["steps"] == 2 * BATCH
    first = progress(folder)
    train_policy("walk", replace(config, steps=4 * BATCH), quiet=True)
    assert steps_of(folder) == [k * BATCH for k in (1, 2, 3, 4)] and progress(folder)[:2] == first


def test_resuming_with_another_network_is_refused(config):
    folder = train_policy("walk", config, quiet=True)
    (folder / "DONE").unlink()
    with pytest.raises(UserError, match=r"started with ppo\.hidden \[8\], not \[6\]"):
        train_policy("walk", replace(config, steps=5 * BATCH, ppo=replace(TINY, hidden=(6,))), quiet=True)


def test_a_fault_before_the_first_iteration_leaves_the_finished_run(config, monkeypatch):
    folder = train_policy("walk", config, quiet=True)
    before = (folder / "policy.npz").read_bytes()
    monkeypatch.setattr(runs, "make_env", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        train_policy("walk", replace(config, overwrite=True), quiet=True)
    assert (folder / "policy.npz").read_bytes() == before and (folder / "DONE").exists()
    assert not folder.with_name("seed0.old").exists()


@pytest.mark.parametrize("flag, change", [
    ("ppo.gamma 0.99, not 0.9", {"ppo": replace(TINY, gamma=0.9)}),
    ("curriculum.num-levels 2, not 3", {"curriculum": CurriculumConfig(num_levels=3, variants=1)}),
    ("env.rewards.alive 0.5, not 0", {"env": EnvConfig(turned_start_share=0.1, stall_seconds=5, rewards=RewardConfig(alive=0))}),
    ("preset quick, not full", {"preset": "full"}),
])  # fmt: skip
def test_resuming_with_other_settings_is_refused_and_changes_nothing(config, flag, change):
    folder = train_policy("walk", config, quiet=True)
    (folder / "DONE").unlink()
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(UserError, match=re.escape(f"started with {flag}")):
        train_policy("walk", replace(config, steps=5 * BATCH, **change), quiet=True)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_a_refused_overwrite_keeps_the_finished_run(config):
    train_policy("walk", config, quiet=True)
    folder = train_policy("leap", replace(config, steps=5 * BATCH), quiet=True)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    for wrong in (
        {"steps": BATCH},
        {"env": replace(config.env, action_scale=0.5)},
        {"ppo": replace(TINY, hidden=(6,))},
    ):
        with pytest.raises(UserError):
            train_policy("leap", replace(config, overwrite=True, **wrong), quiet=True)
        assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    train_policy("leap", replace(config, overwrite=True, steps=6 * BATCH), quiet=True)
    assert steps_of(folder)[-1] == 6 * BATCH and [path.name for path in folder.parent.iterdir()] == ["seed0"]


def test_only_the_run_that_was_named_is_replaced(config):
    folder = train_policy("walk", config, quiet=True)
    kept = folder.rename(folder.with_name("seed0.old"))
    train_policy("walk", config, quiet=True)
    train_policy("walk", replace(config, overwrite=True), quiet=True)
    assert sorted(path.name for path in folder.parent.iterdir()) == ["seed0", "seed0.old"] and (kept / "DONE").exists()


def killed_in_iteration(number, monkeypatch):
    """Have training die, as if killed, within an iteration."""
    step, steps = runs.Go1Env.step, []

    def killed(self, action):
        steps.append(1)
        if len(steps) == (number - 1) * TINY.num_steps + 3:
            raise SystemExit
        return step(self, action)

    monkeypatch.setattr(runs.Go1Env, "step", killed)


def test_the_finished_run_stays_until_the_one_that_replaces_it_is_finished(config, monkeypatch):
    folder = train_policy("walk", config, quiet=True)
    before = (folder / "policy.npz").read_bytes()
    longer = replace(config, overwrite=True, steps=4 * BATCH)
    with monkeypatch.context() as patch, pytest.raises(SystemExit):
        killed_in_iteration(3, patch)
        train_policy("walk", longer, quiet=True)
    assert find_weights("walk", config).read_bytes() == before
    begun = read_npz(folder.with_name(".seed0.new") / "policy.npz")[1]
    assert begun["steps"] == 2 * BATCH
    train_policy("walk", longer, quiet=True)  # goes on
    assert steps_of(folder) == [k * BATCH for k in (1, 2, 3, 4)]
    assert [path.name for path in folder.parent.iterdir()] == ["seed0"]


@pytest.mark.parametrize("renamed", [0, 1])
def test_a_replacement_that_was_cut_off_is_finished(config, renamed):
    """Killed after the finished run was set aside, and after the new one was put in its place."""
    folder = train_policy("walk", config, quiet=True)
    longer = train_policy("walk", replace(config, steps=4 * BATCH, out=f"{config.out}/other"), quiet=True)
    folder.rename(folder.with_name(".seed0.old"))
    longer.rename(folder if renamed else folder.with_name(".seed0.new"))
    if not renamed:
        with pytest.raises(UserError, match="not finished"):
            find_weights("walk", config)
    with pytest.raises(UserError, match="finished run"):
        train_policy("walk", config, quiet=True)
    assert steps_of(folder)[-1] == 4 * BATCH and [path.name for path in folder.parent.iterdir()] == ["seed0"]


# --- several at once -------------------------------------------------------------------


def test_a_run_that_somebody_else_writes_is_refused(config):
    folder = run_folder(config.root, "walk", 0)
    with locked(folder), pytest.raises(UserError, match="is being written by another process"):
        train_policy("walk", config, quiet=True)
    assert not folder.exists()
    train_policy("walk", config, quiet=True)


def test_a_warm_start_that_somebody_else_trains_is_waited_for(config, finished_run, tmp_path, monkeypatch):
    folder, waits = run_folder(config.root, "walk", 0), []
    holder = locked(folder)
    holder.__enter__()

    def wait(seconds):
        waits.append(seconds)
        if len(waits) == 3:
            finished_run(tmp_path, "walk", preset="quick", steps=BATCH, config={"ppo": {"hidden": [16]}})
            holder.__exit__(None, None, None)

    monkeypatch.setattr("agility_ref.training.lock.time.sleep", wait)
    wider = replace(config, ppo=replace(TINY, hidden=(16,)))
    assert steps_of(train_policy("climb", wider, quiet=True)) == [2 * BATCH, 3 * BATCH]
    assert len(waits) == 3


def test_what_was_half_written_is_swept_away(config):
    folder = run_folder(config.root, "walk", 0)
    folder.mkdir(parents=True)
    (folder / "policy.123-abcd.partial.npz").write_bytes(b"half")
    train_policy("walk", config, quiet=True)
    assert not list(folder.glob("*.partial*"))


# --- unfinished runs -------------------------------------------------------------------


def test_an_unfinished_run_is_not_passed_over(config):
    folder = train_policy("walk", config, quiet=True)
    (folder / "DONE").unlink()
    with pytest.raises(
        UserError, match=r"not finished; finish it with: agility-ref train walk --preset quick --seed 0"
    ):
        load_policy("walk", config)


def test_an_unfinished_warm_start_is_finished_first(config, monkeypatch):
    walk = train_policy("walk", replace(config, steps=BATCH), quiet=True)
    (walk / "DONE").unlink()
    two = {name: replace(spec, budget=(2 * BATCH, 2 * BATCH)) for name, spec in policies.POLICIES.items()}
    monkeypatch.setattr(policies, "POLICIES", two)
    folder = train_policy("climb", config, quiet=True)
    assert steps_of(walk) == [BATCH, 2 * BATCH] and (walk / "DONE").exists() and steps_of(folder) == [3 * BATCH]


def test_it_is_said_that_shipped_weights_are_used(config, finished_run, tmp_path, monkeypatch, capsys):
    shipped = finished_run(tmp_path / "package", "walk", preset="quick", steps=BATCH) / "policy.npz"
    monkeypatch.setattr("agility_ref.training.weights.shipped", lambda *key: shipped)
    train_policy("climb", replace(config, ppo=replace(TINY, hidden=(16,))))
    assert "so from the shipped weights: walk" in capsys.readouterr().out


def test_a_start_is_trained_where_the_shipped_one_can_only_act(config, finished_run, tmp_path, monkeypatch):
    shipped = finished_run(tmp_path / "package", "walk", preset="quick", steps=BATCH) / "policy.npz"
    arrays, meta = read_npz(shipped)
    acting = {name: a for name, a in arrays.items() if not name.startswith(("net.", "optimizer."))}
    write_npz(shipped, acting, {key: meta[key] for key in meta if key != "schema"})
    monkeypatch.setattr("agility_ref.training.weights.shipped", lambda preset, policy, seed: shipped)
    monkeypatch.setattr(runs, "_train_ppo", lambda spec, config, folder, quiet, draw: trained.append(spec.name))
    trained = []
    train_policy("climb", config, quiet=True)
    assert trained == ["walk", "climb"]


# --- numbers that go wrong -------------------------------------------------------------


def test_a_run_that_diverges_keeps_its_last_good_policy(config, monkeypatch):
    good = train_policy("walk", replace(config, steps=2 * BATCH), quiet=True)
    (good / "DONE").unlink()
    arrays, _ = read_npz(good / "policy.npz")
    load = runs.go_on
    # The same settings, as the folder asks for, but a network that has become infinite since.
    monkeypatch.setattr(
        runs,
        "go_on",
        lambda given, *run: load(
            given | {"net.critic.own.0.bias": given["net.critic.own.0.bias"] + np.float32(3e38)}, *run
        ),
    )
    for _ in range(2):  # the same command ends alike when it is given again
        with pytest.raises(
            UserError, match=r"diverged: \w+ is not finite, or huge, in iteration 3, at 96 steps; .* keeps the policy"
        ):
            train_policy("walk", replace(config, steps=4 * BATCH), quiet=True)
        for name, kept in read_npz(good / "policy.npz")[0].items():
            np.testing.assert_array_equal(kept, arrays[name], err_msg=name)


@pytest.mark.parametrize("change", [
    {"ppo": replace(TINY, critic_learning_rate=1e30)},
    {"env": EnvConfig(rewards=RewardConfig(alive=1e30))},
    {"ppo": replace(TINY, learning_rate=1e30, learning_rate_max=1e30)},
])  # fmt: skip
def test_absurd_settings_end_in_one_line(config, change):
    with pytest.raises(UserError, match=r"diverged: [\w.]+ is not finite, or huge, in iteration \d+, at \d+ steps"):
        train_policy("walk", replace(config, **change), quiet=True)
    saved = run_folder(config.root, "walk", 0) / "policy.npz"
    assert not saved.exists() or Policy.load(saved)


# --- pictures --------------------------------------------------------------------------


def test_a_picture_that_fails_is_a_warning(config, capsys):
    folder = train_policy("walk", config, quiet=True, draw=lambda *paths: 1 / 0)
    assert (folder / "DONE").exists()
    assert "warning: no " in (said := capsys.readouterr().err) and "ZeroDivisionError" in said and said.count("\n") == 1


# --- averages and rows of before -------------------------------------------------------


def test_averages_are_of_what_was_played(config, monkeypatch):
    """Stopped and resumed, the averages are those of the run that was not stopped."""
    short = replace(config, env=replace(config.env, episode_seconds=0.12), steps=6 * BATCH)
    whole = train_policy("walk", replace(short, out=f"{config.out}/whole"), quiet=True)
    with monkeypatch.context() as patch, pytest.raises(SystemExit):
        killed_in_iteration(3, patch)
        train_policy("walk", short, quiet=True)
    parts = train_policy("walk", short, quiet=True)
    assert [row["episode_length"] for row in progress(parts)] == [row["episode_length"] for row in progress(whole)]
    assert float(progress(parts)[-1]["episode_length"]) == 6  # control steps


def test_nothing_is_invented_where_no_episode_has_ended(config, monkeypatch):
    with monkeypatch.context() as patch, pytest.raises(SystemExit):
        killed_in_iteration(2, patch)
        train_policy("walk", config, quiet=True)
    folder = train_policy("walk", config, quiet=True)
    assert read_npz(folder / "policy.npz")[0]["progress.episodes"].shape == (0, 4)


@pytest.mark.parametrize("damage", [
    lambda text: text.replace("\r\n", "\r\n\0", 2),
    lambda text: text.replace(",", ";"),
    lambda text: text[: text.rfind("\n", 0, -1) - 20],
    lambda text: text[:-30],
    lambda text: "",
    lambda text: None,
    lambda text: text + text.splitlines()[-1] + "\r\n",
    lambda text: text.replace("reward", "rewards"),
    lambda text: "\r\n".join(text.splitlines()[::2]) + "\r\n",
    lambda text: text.replace("0.8", "nan", 1),
    lambda text: "\udcff" + text,
])  # fmt: skip
def test_a_damaged_progress_is_named_and_nothing_is_changed(config, damage):
    folder = train_policy("walk", config, quiet=True)
    (folder / "DONE").unlink()
    path = folder / "progress.csv"
    damaged = damage(path.read_bytes().decode())
    path.unlink() if damaged is None else path.write_bytes(damaged.encode(errors="surrogateescape"))
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(UserError, match=r"progress\.csv is (damaged|missing).*put it back as it was, or delete"):
        train_policy("walk", replace(config, steps=5 * BATCH), quiet=True)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_a_selector_acts_over_the_skills_it_was_trained_with(config, tmp_path, finished_run):
    for name in ("walk", "climb", "leap"):
        finished_run(tmp_path, name, preset="quick")
    train_policy("ps-rl-3-env", config, quiet=True)
    assert isinstance(load_policy("ps-rl-3-env", config), Hierarchy)
    finished_run(tmp_path, "leap", preset="quick", gain=50.0)
    with pytest.raises(UserError, match="was trained over another leap"):
        load_policy("ps-rl-3-env", config)


def test_weights_that_can_only_act_are_not_trained_further(config):
    folder = train_policy("walk", config, quiet=True)
    (folder / "DONE").unlink()
    arrays, meta = read_npz(folder / "policy.npz")
    acting = {name: array for name, array in arrays.items() if not name.startswith(("optimizer.", "curriculum."))}
    write_npz(folder / "policy.npz", acting, {key: meta[key] for key in meta if key != "schema"})
    with pytest.raises(UserError, match="lacks the state"):
        train_policy("walk", replace(config, steps=5 * BATCH), quiet=True)


def test_resuming_with_another_number_of_robots(config):
    folder = train_policy("walk", config, quiet=True)
    (folder / "DONE").unlink()
    with pytest.raises(UserError, match=r"started with ppo\.num-envs 8, not 6"):
        train_policy("walk", replace(config, steps=5 * BATCH, ppo=replace(TINY, num_envs=6)), quiet=True)


def test_a_generalist_records_the_level_of_each_kind(config):
    train_policy("walk", config, quiet=True)
    rows = progress(train_policy("gen-3", replace(config, steps=5 * BATCH), quiet=True))
    levels = [[float(row[f"level_{kind}"]) for kind in ("climb", "gap", "walk")] for row in rows]
    assert np.shape(levels) == (2, 3)


# --- warm starts and needs -------------------------------------------------------------


def test_warm_start_is_counted_and_copied(config, tmp_path):
    walk = train_policy("walk", config, quiet=True)
    folder = train_policy("climb", replace(config, steps=5 * BATCH), quiet=True)
    assert steps_of(folder) == [4 * BATCH, 5 * BATCH]
    count = read_npz(folder / "policy.npz")[0]["normalizer.count"]
    assert count == 5 * BATCH == read_npz(walk / "policy.npz")[0]["normalizer.count"] + 2 * BATCH


def test_a_run_starts_with_the_network_it_starts_from(config, monkeypatch):
    walk = read_npz(train_policy("walk", config, quiet=True) / "policy.npz")[0]
    started = {}

    def nothing(env, learner, *rest):
        started.update(policy_arrays(learner) | learner_state(learner))
        return iter(())

    monkeypatch.setattr(runs, "train", nothing)
    with pytest.raises(KeyboardInterrupt):
        train_policy("climb", replace(config, steps=5 * BATCH, warm_std=0.4), quiet=True)
    for name, array in started.items():
        if name.startswith(("actor.", "net.actor.", "net.critic.", "normalizer.")):
            np.testing.assert_array_equal(array, walk[name], err_msg=name)
    np.testing.assert_allclose(np.exp(started["net.log_std"]), 0.4, rtol=1e-6)
    assert not any(name.endswith("exp_avg") for name in started)


def plain(tmp_path):
    """Make a finished run of the walk that ships, as it was before networks knew left from right: dense layers alone."""
    arrays, meta = read_npz(weights.FOLDER / "walk-full-seed0.npz")
    dense = {name: array for name, array in arrays.items() if not name.startswith("net.")}
    folder = run_folder(tmp_path, "walk", 0)
    write_npz(folder / "policy.npz", dense, {key: meta[key] for key in meta if key != "schema"})
    (folder / "DONE").touch()
    return folder / "policy.npz"


def test_nothing_starts_from_a_network_without_symmetry(config, tmp_path):
    path = plain(tmp_path)
    with pytest.raises(UserError) as refusal:
        train_policy("climb", config, quiet=True)
    assert str(refusal.value) == f"{path} holds a network of an older form; train walk anew, with --out"
    assert isinstance(load_policy("walk", config), Single)  # which acts as ever


def test_what_is_needed_is_trained_first(config, tmp_path, monkeypatch):
    budgets = {name: replace(spec, budget=(4 * BATCH, 4 * BATCH)) for name, spec in policies.POLICIES.items()}
    budgets["walk"] = replace(budgets["walk"], budget=(2 * BATCH, 2 * BATCH))
    monkeypatch.setattr(policies, "POLICIES", budgets)
    train_policy("climb", replace(config, steps=0), quiet=True)
    assert (tmp_path / "walk" / "seed0" / "DONE").exists()
    assert steps_of(tmp_path / "climb" / "seed0") == [3 * BATCH, 4 * BATCH]


def test_from_scratch_needs_nothing(config, tmp_path):
    folder = train_policy("climb", replace(config, warm_start=False), quiet=True)
    assert steps_of(folder)[0] == BATCH
    assert not (tmp_path / "walk").exists()


@pytest.mark.parametrize("field, value, message", [
    ("action_scale", 0.25, r"trained with env\.action-scale 0\.25, this task has 0\.3"),
    ("action_repeat", 1, r"trained with env\.action-repeat 1, this task has 2"),
    ("physics", {"timestep": 0.01, "substeps": 4}, r"trained to act every 0\.08 s, this task asks every 0\.04 s"),
])  # fmt: skip
def test_policies_of_another_action_are_refused(config, tmp_path, finished_run, field, value, message):
    finished_run(tmp_path, "walk", steps=BATCH, config={"env": {field: value}})
    with pytest.raises(UserError, match=message):
        train_policy("climb", config, quiet=True)
    with pytest.raises(UserError, match=message):
        load_policy("walk", config)


def test_a_warm_start_of_another_network_is_refused(config, tmp_path, finished_run):
    finished_run(tmp_path, "walk", steps=BATCH, config={"ppo": {"hidden": [128, 128]}})
    with pytest.raises(
        UserError, match=r"hidden layers of \(128, 128\) units, not \(8,\); train walk with the same flags"
    ):
        train_policy("climb", config, quiet=True)


def test_damaged_shipped_weights_are_not_trained_anew(config, monkeypatch):
    def shipped(*key):
        raise UserError("shipped weights differ from their manifest")

    monkeypatch.setattr("agility_ref.training.weights.shipped", shipped)
    with pytest.raises(UserError, match="differ from their manifest"):
        train_policy("climb", config, quiet=True)


def test_fewer_steps_than_the_warm_start_is_refused(config):
    train_policy("walk", config, quiet=True)
    with pytest.raises(UserError):
        train_policy("climb", replace(config, steps=2 * BATCH), quiet=True)


def test_oracle_needs_no_training(config):
    with pytest.raises(UserError, match="oracle needs no training"):
        train_policy("oracle", config, quiet=True)


@pytest.mark.parametrize("name", ["ps-rl-3-env", "ps-rl-3-oracle"])
def test_ppo_selector_run(config, tmp_path, finished_run, name):
    for skill in ("walk", "climb", "leap"):
        finished_run(tmp_path, skill)
    folder = train_policy(name, config, quiet=True)
    policy = load_policy(name, config)
    assert (folder / "DONE").exists() and isinstance(policy, Hierarchy)
    assert read_npz(folder / "policy.npz")[0]["actor.1.bias"].shape == (3,)


def test_a_selector_does_not_go_on_over_another_skill(config, tmp_path, finished_run):
    for skill in ("walk", "climb", "leap"):
        finished_run(tmp_path, skill)
    folder = train_policy("ps-rl-3-env", config, quiet=True)
    (folder / "DONE").unlink()
    finished_run(tmp_path, "leap", gain=50.0)
    with pytest.raises(UserError, match="was started over another leap"):
        train_policy("ps-rl-3-env", replace(config, steps=1000), quiet=True)


def test_what_learns_to_walk_has_a_discount_of_its_own(config):
    names = ("walk", "climb", "gen-5", "ps-rl-3-env", "post-gen")
    config = replace(config, walk_gamma=0.9, ppo=replace(TINY, gamma=0.95))
    assert [ppo_config(find_policy(name), config).gamma for name in names] == [0.9, 0.95, 0.95, 0.95, 0.95]


def test_selectors_have_an_entropy_bonus_of_their_own_and_no_curriculum(config, tmp_path, finished_run, monkeypatch):
    for skill in ("walk", "climb", "leap"):
        finished_run(tmp_path, skill)
    seen, make_env = [], runs.make_env
    monkeypatch.setattr(runs, "make_env", lambda spec, config: seen.append(config.curriculum) or make_env(spec, config))
    monkeypatch.setattr(runs, "train", lambda env, learner, *rest: seen.append(learner.config) or iter(()))
    with pytest.raises(KeyboardInterrupt):
        train_policy("ps-rl-3-oracle", replace(config, selector_ent_coef=0.07), quiet=True)
    assert not seen[0].enabled and seen[1] == replace(TINY, ent_coef=0.07)


@pytest.mark.parametrize("rounds", [0, 1, 4])
def test_the_budget_is_the_same_with_and_without_dagger(config, tmp_path, finished_run, rounds):
    for skill in ("walk", "climb-up", "climb-down", "leap", "beam"):
        finished_run(tmp_path, skill)
    config = replace(config, steps=90, supervised=replace(config.supervised, dagger_rounds=rounds))
    folder = train_policy("ps-sl-5", config, quiet=True)
    states = int(float(progress(folder)[-1]["states"]))
    # 90 states: 96 from 8 robots; 2 x 48 = 96; 5 x 24 = 120.  Never fewer than asked for.
    assert states == {0: 96, 1: 96, 4: 120}[rounds]


def test_the_supervised_selector_sees_every_course_and_level(config, monkeypatch):
    spec = find_policy("ps-sl-5")
    assert sorted(spec.courses) == sorted(COURSE_KINDS) and min(spec.budget) >= 300_000
    seen = []
    monkeypatch.setattr(runs, "load_bank", lambda *args: {})
    monkeypatch.setattr(runs, "oracle_hierarchy", lambda *args: None)

    def collect(env, *rest):
        for _ in range(40):  # every robot draws another course
            env.reset()
            seen.append(env.course.copy())
        raise KeyboardInterrupt

    monkeypatch.setattr(runs, "collect_labels", collect)
    config = replace(config, ppo=replace(TINY, num_envs=2 * len(spec.courses)), warm_start=False)
    monkeypatch.setattr(runs, "requirements", lambda name: ())
    monkeypatch.setattr(runs, "find_weights", lambda *args: "found")
    with pytest.raises(KeyboardInterrupt):
        train_policy("ps-sl-5", config, quiet=True)
    assert set(np.concatenate(seen)) == set(range(len(spec.courses) * config.curriculum.num_levels))


def test_an_imitation_that_diverges_is_one_line(config, tmp_path, finished_run):
    for name in ("walk", "climb-up", "climb-down", "leap", "beam"):
        finished_run(tmp_path, name)
    config = replace(config, steps=90, supervised=replace(config.supervised, learning_rate=1e30))
    with pytest.raises(UserError, match=r"^training has diverged: [\w.]+ is not finite, or huge; try a smaller"):
        train_policy("ps-sl-5", config, quiet=True)
    assert not run_folder(config.root, "ps-sl-5", 0).exists()


def test_supervised_selector_run(config, tmp_path, finished_run):
    for skill in ("walk", "climb-up", "climb-down", "leap", "beam"):
        finished_run(tmp_path, skill)
    folder = train_policy("ps-sl-5", config, quiet=True)
    assert (folder / "DONE").exists()
    rounds = config.supervised.dagger_rounds + 1
    assert len(progress(folder)) == rounds * config.supervised.epochs
    arrays, meta = read_npz(folder / "policy.npz")
    assert arrays["actor.0.weight"].shape[1] == NUM_SCANDOTS and meta["act_dim"] == 5
    hierarchy = load_policy("ps-sl-5", config)
    assert isinstance(hierarchy, Hierarchy)
    assert hierarchy.act(np.zeros((2, OBS_DIM), np.float32), None)[0].shape == (2, ACTION_DIM)


# --- distillation ----------------------------------------------------------------------


def test_distilled_run(config, tmp_path, finished_run):
    for skill in ("walk", "climb-up", "climb-down", "leap", "beam"):
        finished_run(tmp_path, skill)
    config = replace(config, steps=90, distill=DistillConfig(dagger_rounds=1, epochs=2))
    folder = train_policy("distilled", config, quiet=True)
    # 90 states in two rounds of at least 45: 4 robots see 48 each time
    assert [(row["round"], row["states"]) for row in progress(folder)] == [("0", "48")] * 2 + [("1", "96")] * 2
    arrays, meta = read_npz(folder / "policy.npz")
    assert meta["steps"] == 96 and set(meta["teachers"]) == {"walk", "climb-up", "climb-down", "leap", "beam"}
    assert not any(name.startswith("net.critic.") for name in arrays)
    assert isinstance(load_policy("distilled", config), Single)


def test_a_post_generalist_goes_on_from_the_distilled_policy(config, tmp_path, finished_run, monkeypatch):
    budgets = {name: replace(spec, budget=(4 * BATCH, 4 * BATCH)) for name, spec in policies.POLICIES.items()}
    budgets["distilled"] = replace(budgets["distilled"], budget=(2 * BATCH, 2 * BATCH))
    monkeypatch.setattr(policies, "POLICIES", budgets)
    for skill in ("walk", "climb-up", "climb-down", "leap", "beam"):
        finished_run(tmp_path, skill)
    fine_tune = FineTuneConfig(num_steps=4, critic_steps=BATCH)
    config = replace(config, steps=0, distill=DistillConfig(dagger_rounds=1, epochs=1), fine_tune=fine_tune)
    folder = train_policy("post-gen", config, quiet=True)
    assert (tmp_path / "distilled" / "seed0" / "DONE").exists()
    assert steps_of(folder) == [3 * BATCH, 4 * BATCH]
    first, second = progress(folder)
    # the entropy is a mean over the actor's steps, and it takes none while the critic learns alone
    assert float(first["entropy"]) == 0.0 != float(second["entropy"])
    np.testing.assert_allclose(float(first["std"]), fine_tune.std, rtol=1e-5)
    arrays, meta = read_npz(folder / "policy.npz")
    assert meta["start"] == 2 * BATCH and int(arrays["optimizer.actor_start"]) == 3 * BATCH

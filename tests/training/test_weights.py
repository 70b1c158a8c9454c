import json

from agility_ref.curriculum import PRESETS
from agility_ref.errors import UserError
from agility_ref.files import read_npz, write_npz
from agility_ref.observation import ACTION_MIRROR, OBS_MIRROR, SCANDOTS
from agility_ref.policy import Policy
from agility_ref.ppo import Learner, PPOConfig
from agility_ref.training import weights
from agility_ref.training.state import policy_arrays, warm_start
from agility_ref.training.weights import sha256

import numpy as np
import pytest


@pytest.fixture
def run(finished_run, tmp_path):
    """A finished run with a progress.csv of 100 rows."""
    folder = finished_run(
        tmp_path / "runs",
        "walk",
        seed=3,
        wall_seconds=1.0,
        courses=["walk"],
        versions={"numpy": "2"},
        **{"preset": "quick"},
    )
    arrays, meta = read_npz(folder / "policy.npz")
    write_npz(folder / "policy.npz", arrays, meta | {"seed": 3})
    (folder / "progress.csv").write_text("steps,reward\n" + "".join(f"{k},{k / 2}\n" for k in range(100)))
    return folder


def test_shipping_keeps_the_policy_and_drops_what_going_on_takes(run, tmp_path):
    arrays, meta = read_npz(run / "policy.npz")
    assert any(name.startswith("optimizer.") for name in arrays)
    robots = {name: np.zeros(3) for name in ("env.course", "curriculum.level", "progress.episodes")}
    write_npz(run / "policy.npz", arrays | robots, {key: value for key, value in meta.items() if key != "schema"})
    path = weights.ship(run, tmp_path)
    assert path.name == "walk-quick-seed3.npz"
    arrays, _ = read_npz(path)
    assert {name.partition(".")[0] for name in arrays} == {"actor", "net", "normalizer"}
    before, after = Policy.load(run / "policy.npz"), Policy.load(path)
    assert all((a[0] == b[0]).all() for a, b in zip(before.layers, after.layers, strict=True))
    assert weights.shipped("quick", "walk", 3, tmp_path) == path
    assert weights.shipped("quick", "walk", 0, tmp_path) is None


def test_a_critic_is_shipped_with_what_others_start_from(run, finished_run, tmp_path):
    assert any(name.startswith("net.critic.") for name in read_npz(weights.ship(run, tmp_path))[0])
    leap = finished_run(
        tmp_path / "runs", "leap", preset="quick", seed=0, wall_seconds=1.0, courses=["gap"], versions={}
    )
    arrays, meta = read_npz(leap / "policy.npz")
    write_npz(leap / "policy.npz", arrays, meta | {"seed": 0})
    assert any(name.startswith("net.critic.") for name in arrays)
    (leap / "progress.csv").write_text("steps,reward\n1,1\n")
    path = weights.ship(leap, tmp_path)
    assert not any(name.startswith("net.") for name in read_npz(path)[0])
    Policy.load(path)


def test_others_can_start_from_what_is_shipped(run, tmp_path):
    arrays, meta = read_npz(weights.ship(run, tmp_path))
    learner = Learner.create(OBS_MIRROR, ACTION_MIRROR, PPOConfig(hidden=(16,)), 0, fixed=SCANDOTS)
    warm_start(learner, arrays, meta["steps"], 0.5)
    assert learner.steps == learner.start == meta["steps"] and not learner.actor_rests
    for name, array in policy_arrays(learner).items():
        np.testing.assert_array_equal(array, read_npz(run / "policy.npz")[0][name], err_msg=name)
    assert learner.net.std().detach().numpy() == pytest.approx(0.5)


def test_the_manifest_keeps_digest_record_and_a_short_curve(run, tmp_path):
    path = weights.ship(run, tmp_path)
    entry = json.loads((tmp_path / "manifest.json").read_text())[path.name]
    assert entry["sha256"] == sha256(path)
    assert (entry["policy"], entry["seed"], entry["steps"]) == ("walk", 3, 1000)
    assert 0 < len(entry["curve"]["steps"]) <= 2 * weights.CURVE_POINTS
    assert entry["curve"]["steps"][-1] == 99


def test_weights_that_differ_from_the_manifest_are_refused_by_name(run, tmp_path):
    path = weights.ship(run, tmp_path)
    path.write_bytes(path.read_bytes() + b"x")
    with pytest.raises(UserError, match=r"walk-quick-seed3\.npz"):
        weights.shipped("quick", "walk", 3, tmp_path)


def test_an_unfinished_run_is_not_shipped(run, tmp_path):
    (run / "DONE").unlink()
    with pytest.raises(UserError, match="finished"):
        weights.ship(run, tmp_path)


@pytest.mark.parametrize("preset", PRESETS)
def test_others_can_start_from_the_shipped_walk(preset):
    path = weights.shipped(preset, "walk", 0)
    if path is None:
        pytest.skip(f"no walk of preset {preset} ships")
    arrays, meta = read_npz(path)
    if "net.log_std" not in arrays:
        pytest.skip("the walk that ships is of an older version, from which nothing can start")
    learner = Learner.create(OBS_MIRROR, ACTION_MIRROR, PPOConfig(), 0, fixed=SCANDOTS)
    warm_start(learner, arrays, meta["steps"], 0.5)
    assert learner.steps == learner.start == meta["steps"]
    np.testing.assert_allclose(policy_arrays(learner)["actor.0.weight"], arrays["actor.0.weight"], atol=1e-6)
    assert learner.net.std().detach().numpy() == pytest.approx(0.5)


def test_what_the_package_ships_is_what_its_manifest_records():
    files = {path.name for path in weights.FOLDER.glob("*.npz")}
    entries = weights.manifest()
    assert files == set(entries)
    for name in files:
        assert sha256(weights.FOLDER / name) == entries[name]["sha256"]
    # 51 networks of up to 81,804 numbers are 0.33 MB each; those that training starts from have their critic as well.
    assert sum((weights.FOLDER / name).stat().st_size for name in files) <= 17e6

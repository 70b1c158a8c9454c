import json

from agility_ref.errors import UserError
from agility_ref.files import SCHEMA, read_npz, write_npz
from agility_ref.networks import EquivariantMLP
from agility_ref.observation import Mirror
from agility_ref.policy import Policy, elu, layers_of, mlp
from agility_ref.ppo import Learner, PPOConfig
from agility_ref.training.progress import processor, versions
from agility_ref.training.state import learner_state, load_learner, policy_arrays
from agility_ref.training.weights import sha256

import numpy as np
import pytest
import torch

META = {"policy": "walk", "act_dim": 3, "steps": 7}


# Nine observations and three actions of which a pair each swaps, one changes its sign and the rest stay.
SEEN = Mirror(np.array([1, 0, 2, 3, 4, 5, 6, 7, 8]), np.array([1, 1, -1, 1, 1, 1, 1, 1, 1], np.float32))
DONE = Mirror(np.array([1, 0, 2]), np.array([-1, -1, 1], np.float32))


def new_learner(seed):
    return Learner.create(SEEN, DONE, PPOConfig(hidden=(16, 8)), seed, fixed=slice(5, 9))


@pytest.fixture
def learner():
    """A learner whose normaliser has seen data."""
    learner = new_learner(4)
    learner.normalizer.update(np.random.default_rng(0).normal(2.0, 3.0, (100, 9)))
    with torch.no_grad():
        for layer in learner.net.actor.last:
            layer.weight *= 100.0  # so that actions differ visibly
    return learner


def arrays_of(learner):
    return policy_arrays(learner) | learner_state(learner)


@pytest.fixture
def observations():
    return np.random.default_rng(1).normal(2.0, 3.0, (20, 9)).astype(np.float32)


@pytest.fixture
def path(tmp_path, learner):
    write_npz(tmp_path / "policy.npz", arrays_of(learner), META)
    return tmp_path / "policy.npz"


def test_round_trip(path, learner):
    arrays, meta = read_npz(path)
    assert meta["policy"] == "walk" and meta["steps"] == 7 and meta["schema"] == SCHEMA
    assert arrays.keys() == arrays_of(learner).keys()
    for name, array in arrays_of(learner).items():
        np.testing.assert_array_equal(arrays[name], array, err_msg=name)


@pytest.mark.parametrize("compress", [True, False])
@pytest.mark.parametrize(
    "array",
    [
        np.array(0.1, np.float32),
        np.array([-0.0, 1e-45, -3.4e38, 3.4e38], np.float32),
        np.arange(24, dtype=np.float32).reshape(2, 3, 4).transpose(2, 0, 1),  # not contiguous
        np.zeros((0, 5), np.float32),
        np.array([0.1, 0.2]),
        np.array(7),
    ],
    ids=["scalar", "special", "transposed", "empty", "float64", "int"],
)
def test_every_kind_of_array_comes_back_bit_equal(tmp_path, array, compress):
    write_npz(tmp_path / "a.npz", {"a": array}, META, compress)
    again = read_npz(tmp_path / "a.npz")[0]["a"]
    assert (again.dtype, again.shape, again.tobytes()) == (array.dtype, array.shape, array.tobytes())


@pytest.mark.parametrize("compress", [True, False])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_are_refused(tmp_path, value, compress):
    write_npz(tmp_path / "a.npz", {"b": np.zeros(2), "a": np.array([1.0, value], np.float32)}, META, compress)
    with pytest.raises(UserError, match=r"a\.npz is damaged: a has numbers that are not finite"):
        read_npz(tmp_path / "a.npz")


def test_what_a_policy_has_seen_may_have_no_limit(tmp_path):
    seen = {"seen.low": np.array([-np.inf, 0.0], np.float32)}
    write_npz(tmp_path / "a.npz", seen, META)
    np.testing.assert_array_equal(read_npz(tmp_path / "a.npz")[0]["seen.low"], seen["seen.low"])
    write_npz(tmp_path / "a.npz", {"seen.high": np.array([np.nan])}, META)
    with pytest.raises(UserError, match=r"seen\.high has numbers"):
        read_npz(tmp_path / "a.npz")


def test_loaded_policy_acts_bit_equally(path, learner, observations):
    before = Policy.from_arrays(arrays_of(learner), META)(observations)
    np.testing.assert_array_equal(Policy.load(path)(observations), before)


def test_normaliser_is_loaded_and_frozen(path, learner, observations):
    policy = Policy.load(path)
    first = policy(observations)
    np.testing.assert_array_equal(policy.mean, learner.normalizer.mean)
    for _ in range(5):
        policy(100.0 + observations)
    np.testing.assert_array_equal(policy(observations), first)


def test_numpy_policy_agrees_with_torch(path, learner, observations):
    with torch.no_grad():
        expected = learner.net.actor(learner.observe(observations)).numpy()
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(Policy.load(path)(observations), expected, atol=1e-5)


def test_a_policy_sees_nothing_beyond_its_bounds(learner):
    """Entry 3 is bounded to 1 .. 2: what lies beyond looks like the bound, all else is as it was."""
    low, high = np.full(9, -np.inf, np.float32), np.full(9, np.inf, np.float32)
    low[3], high[3] = 1.0, 2.0
    free = Policy.from_arrays(arrays_of(learner), META)
    bounded = Policy.from_arrays(arrays_of(learner) | {"seen.low": low, "seen.high": high}, META)
    observations = np.tile(np.linspace(-1.0, 4.0, 9, dtype=np.float32), (4, 1))
    observations[:, 3] = 0.0, 1.5, 2.0, 7.0
    clipped = observations.copy()
    clipped[:, 3] = 1.0, 1.5, 2.0, 2.0
    np.testing.assert_allclose(bounded(observations), free(clipped), atol=1e-5)
    assert np.abs(bounded(observations) - free(observations)).max(axis=1).round(4).astype(bool).tolist() == [1, 0, 0, 1]
    assert bounded.digest() != free.digest()


def test_resumed_learner_acts_bit_equally(path, learner, observations):
    other = new_learner(5)
    load_learner(other, read_npz(path)[0])
    with torch.no_grad():
        a, b = (x.net.actor(x.observe(observations)) for x in (learner, other))
    assert torch.equal(a, b)


def test_elu_against_torch():
    x = np.linspace(-5, 5, 101)
    np.testing.assert_allclose(elu(x), torch.nn.functional.elu(torch.from_numpy(x)).numpy(), atol=1e-12)


def test_elu_of_large_numbers_does_not_overflow():
    with np.errstate(all="raise"):
        np.testing.assert_array_equal(elu(np.array([-1e9, 1e9])), [-1.0, 1e9])


def test_mlp_by_hand():
    # elu([1 * 2 + 1, 1 * -3 + 1]) = [3, e^-2 - 1];  3 * 10 + (e^-2 - 1) * 1 + 0.5
    layers = [(np.array([[2.0], [-3.0]]), np.array([1.0, 1.0])), (np.array([[10.0, 1.0]]), np.array([0.5]))]
    np.testing.assert_allclose(mlp(np.array([[1.0]]), layers), [[30.5 + np.exp(-2) - 1]])


def test_layers_come_in_numeric_order():
    net = EquivariantMLP(SEEN, tuple(range(10, 32, 2)), DONE, 1.0)  # 12 layers: "10" after "9"
    arrays = {f"actor.{name}": array for name, array in net.dense().items()}
    arrays = dict(sorted(arrays.items()))  # as text: "10" before "2"
    assert [len(bias) for _, bias in layers_of(arrays, "actor")] == [*range(10, 32, 2), 3]


def test_save_leaves_no_partial(path):
    assert [p.name for p in path.parent.iterdir()] == ["policy.npz"]


def test_interrupted_save_keeps_the_old_file(path, learner, monkeypatch):
    def fail(file, **arrays):
        file.write(b"half")
        raise OSError("disk full")

    before = path.read_bytes()
    monkeypatch.setattr(np, "savez_compressed", fail)
    with pytest.raises(OSError, match="disk full"):
        write_npz(path, arrays_of(learner), META)
    assert path.read_bytes() == before


def test_sha256_of_a_known_file(tmp_path):
    (tmp_path / "abc").write_bytes(b"abc")
    assert sha256(tmp_path / "abc") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


# --- what is refused, each in one line -------------------------------------------------


def refused(path, match):
    with pytest.raises(UserError, match=match) as error:
        Policy.load(path)
    assert "\n" not in str(error.value)


def test_missing_file(tmp_path):
    refused(tmp_path / "none.npz", "no checkpoint")


@pytest.mark.parametrize("keep", [0, 10, 0.5, 0.99])
def test_truncated_file(path, keep):
    content = path.read_bytes()
    path.write_bytes(content[: keep if isinstance(keep, int) else int(keep * len(content))])
    refused(path, "not a readable")


@pytest.mark.parametrize("where", [0.3, 0.5, 0.7])
def test_damaged_file(path, where):
    content = bytearray(path.read_bytes())
    start = int(where * len(content))
    content[start : start + 64] = bytes(b ^ 0xFF for b in content[start : start + 64])
    path.write_bytes(content)
    refused(path, "not a readable")


def test_encrypted_and_unknown_compression(path):
    # in the zip's local and central headers: the flag of encryption, and a method that does not exist
    for offset, value in ((8, b"\x01"), (10, b"\x63")):
        content = path.read_bytes()
        start = content.rindex(b"PK\x01\x02") + offset
        path.write_bytes(content[:start] + value + content[start + 1 :])
        refused(path, "not a readable agility_ref checkpoint")
        path.write_bytes(content)


def test_text_file(path):
    path.write_text("this is not a checkpoint\n")
    refused(path, "not a readable")


def test_single_array(path):
    with open(path, "wb") as file:
        np.save(file, np.zeros(3))
    refused(path, "not a readable")


def test_foreign_npz(path):
    np.savez(path, weights=np.zeros(3))
    refused(path, "not a readable")


def test_pickled_objects_are_not_loaded(path):
    np.savez(path, __meta__=np.array([{"schema": SCHEMA}], dtype=object))
    refused(path, "not a readable")


@pytest.mark.parametrize("record", ["[]", "null", "3", "{}", "{"])
def test_foreign_metadata(path, record):
    np.savez(path, __meta__=np.array(record))
    refused(path, "not a readable")


def test_other_schema(path, learner):
    np.savez(path, __meta__=np.array(json.dumps({"schema": "agility_ref/999"})), **arrays_of(learner))
    refused(path, "schema")


def test_missing_array(path, learner):
    arrays = arrays_of(learner)
    del arrays["normalizer.mean"]
    write_npz(path, arrays, META)
    refused(path, "normalizer.mean")


def test_missing_bias(path, learner):
    arrays = arrays_of(learner)
    del arrays["actor.0.bias"]
    write_npz(path, arrays, META)
    refused(path, "actor.0.bias")


def test_no_layers(path, learner):
    arrays = {name: a for name, a in arrays_of(learner).items() if not name.startswith("actor")}
    write_npz(path, arrays, META)
    refused(path, "0 actor layers")


def test_layers_that_do_not_fit(path, learner):
    arrays = arrays_of(learner)
    arrays["actor.1.weight"] = np.zeros((8, 15), np.float32)
    write_npz(path, arrays, META)
    refused(path, "expected")


def test_other_number_of_actions(path, learner):
    write_npz(path, arrays_of(learner), META | {"act_dim": 12})
    refused(path, "outputs")


def test_normaliser_that_does_not_fit(path, learner):
    write_npz(path, arrays_of(learner) | {"normalizer.var": np.ones(4, np.float32)}, META)
    refused(path, "normalizer|shape")


def test_bounds_that_do_not_fit(path, learner):
    write_npz(path, arrays_of(learner) | {"seen.low": np.zeros(8, np.float32)}, META)
    with pytest.raises(UserError, match=r"seen.low .*\(8,\)"):
        Policy.load(path)


def test_foreign_layer_names(path, learner):
    write_npz(path, arrays_of(learner) | {"actor.first.weight": np.zeros((2, 2), np.float32)}, META)
    refused(path, "actor")


def test_a_checkpoint_names_the_processor():
    assert processor() and versions()["machine"].startswith(processor())

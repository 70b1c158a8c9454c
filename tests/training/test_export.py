import importlib.util
import json
import sys
from dataclasses import replace

from agility_ref.errors import UserError
from agility_ref.go1 import JOINTS
from agility_ref.observation import NUM_SCANDOTS, OBS_DIM, SCANDOTS
from agility_ref.training import export
from agility_ref.training.export import SUFFIXES, TOLERANCE, compare, describe, export_policy

import numpy as np
import pytest

HAS_ONNX = importlib.util.find_spec("onnx") and importlib.util.find_spec("onnxruntime")
needs_onnx = pytest.mark.skipif(not HAS_ONNX, reason="needs onnx and onnxruntime")
FORMATS = [pytest.param("onnx", marks=needs_onnx), "npz", "torchscript"]


@pytest.fixture
def policy(make_policy):
    """A policy whose normaliser and bounds matter."""
    plain, rng = make_policy(3, "walk", gain=50.0), np.random.default_rng(0)
    low, high = plain.low.copy(), plain.high.copy()
    low[SCANDOTS], high[SCANDOTS] = -0.3, 0.2
    mean, std = (x.astype(np.float32) for x in (rng.normal(size=OBS_DIM), rng.uniform(0.5, 2.0, OBS_DIM)))
    return replace(plain, mean=mean, std=std, low=low, high=high)


@pytest.mark.parametrize("form", FORMATS)
def test_the_file_acts_as_the_policy_does(policy, tmp_path, form):
    out = tmp_path / f"walk{SUFFIXES[form]}"
    assert export_policy(policy, out, form) <= TOLERANCE
    act = export.FORMS[form][1](out)
    rng = np.random.default_rng(1)
    for n in (1, 7):
        observation = rng.normal(0.0, 4.0, (n, OBS_DIM)).astype(np.float32)
        np.testing.assert_allclose(act(observation), policy(observation), atol=1e-5, rtol=1e-5)
    assert [path.name for path in tmp_path.iterdir()] == [out.name]


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("field", ["mean", "std", "low", "high"])
def test_normaliser_and_bounds_are_inside(policy, tmp_path, form, field):
    export_policy(policy, tmp_path / "f", form)
    other = replace(policy, **{field: getattr(policy, field) * 0.5})
    with pytest.raises(RuntimeError, match="differs"):
        compare(other, export.FORMS[form][1](tmp_path / "f"))


def test_arrays_are_plain_floats(policy, tmp_path):
    export_policy(policy, tmp_path / "walk.npz", "npz")
    with np.load(tmp_path / "walk.npz", allow_pickle=False) as file:
        for i, (weight, bias) in enumerate(policy.layers):
            assert file[f"weight{i}"].dtype == file[f"bias{i}"].dtype == np.float32
            np.testing.assert_array_equal(file[f"weight{i}"], weight)
            np.testing.assert_array_equal(file[f"bias{i}"], bias)
        assert json.loads(str(file["metadata"])) == describe(policy)


def test_the_record_names_every_number(policy):
    record = describe(policy)
    parts = record["input"]["parts"]
    assert [part["start"] for part in parts] == [0, *(part["stop"] for part in parts[:-1])]
    assert parts[-1]["stop"] == OBS_DIM and all(part["unit"] for part in parts)
    assert record["output"]["labels"] == list(JOINTS) and record["output"]["unit"].startswith("0.3 rad")
    meta = {"config": {"env": {"action_scale": 0.2}}}
    assert describe(replace(policy, meta=meta))["output"]["scale_rad"] == 0.2
    # 2 steps of 10 ms, held twice; held for 3 of them; 4 steps of 5 ms, held for 2
    assert record["output"]["period_s"] == pytest.approx(0.04)
    for env, period in (
        ({"action_repeat": 3}, 0.06),
        ({"action_repeat": 2, "physics": {"timestep": 0.005, "substeps": 4}}, 0.04),
    ):
        assert describe(replace(policy, meta={"config": {"env": env}}))["output"]["period_s"] == pytest.approx(period)


def test_a_selector_says_which_skill_is_which(make_policy):
    record = describe(make_policy(0, "ps-sl-5", NUM_SCANDOTS, 5))
    assert record["input"]["parts"] == [
        {"name": "scandots", "start": 0, "stop": NUM_SCANDOTS, "unit": export.UNITS["scandots"]}
    ]
    assert record["output"]["labels"] == ["walk", "climb-up", "climb-down", "leap", "beam"]


@needs_onnx
def test_onnx_carries_the_record_and_any_number_of_robots(policy, tmp_path):
    import onnx

    export_policy(policy, tmp_path / "walk.onnx", "onnx")
    model = onnx.load(tmp_path / "walk.onnx")
    props = {entry.key: json.loads(entry.value) for entry in model.metadata_props}
    assert props == describe(policy)
    (x,), (y,) = model.graph.input, model.graph.output
    shapes = [[d.dim_param or d.dim_value for d in value.type.tensor_type.shape.dim] for value in (x, y)]
    assert (x.name, y.name) == ("observation", "action") and shapes == [["N", OBS_DIM], ["N", 12]]


def test_torchscript_carries_the_record(policy, tmp_path):
    import torch

    export_policy(policy, tmp_path / "walk.pt", "torchscript")
    extra = {"metadata.json": ""}
    torch.jit.load(str(tmp_path / "walk.pt"), _extra_files=extra)
    assert json.loads(extra["metadata.json"]) == describe(policy)


def test_a_file_that_acts_otherwise_is_not_kept(policy, tmp_path, monkeypatch):
    monkeypatch.setitem(export.FORMS, "npz", (export.write_arrays, lambda path: lambda obs: policy(obs) + 1.0))
    (tmp_path / "walk.npz").write_text("before")
    with pytest.raises(RuntimeError, match="differs by"):
        export_policy(policy, tmp_path / "walk.npz", "npz")
    assert [path.read_text() for path in tmp_path.iterdir()] == ["before"]


def test_bad_input(policy, make_policy, tmp_path):
    with pytest.raises(UserError, match="unknown format 'onx'"):
        export_policy(policy, tmp_path / "x", "onx")
    with pytest.raises(UserError, match="no folder"):
        export_policy(policy, tmp_path / "nowhere" / "x.npz", "npz")
    with pytest.raises(UserError, match="sees 9 numbers"):
        export_policy(make_policy(obs_dim=9), tmp_path / "x.npz", "npz")


@pytest.mark.parametrize("package", ["onnx", "onnxruntime"])
def test_a_missing_package_is_named_with_its_command(policy, tmp_path, monkeypatch, package):
    if package == "onnxruntime" and not HAS_ONNX:
        pytest.skip("needs onnx")
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(UserError, match=rf'{package}: pip install "agility-ref\[export\]"'):
        export_policy(policy, tmp_path / "walk.onnx", "onnx")
    assert not list(tmp_path.iterdir())

"""Export: a policy for programs that do not have this package, as ONNX, TorchScript or plain arrays.

The normaliser and the bounds of what a policy sees are part of what is written, so that the input is the
observation as :class:`~agility_ref.env.Go1Env` gives it.  A record beside it says what every number means.

In:  a :class:`~agility_ref.policy.Policy`.
Out: one file; ``.onnx`` is run before it is kept, and its actions compared with the numpy policy's.
"""

import json
from collections.abc import Callable
from pathlib import Path

from agility_ref import __version__
from agility_ref.env import EnvConfig
from agility_ref.errors import UserError, unknown_name
from agility_ref.files import replacing_path
from agility_ref.go1 import DEFAULT_DOF_POS, JOINTS
from agility_ref.observation import NUM_SCANDOTS, OBS_DIM, observation_slices
from agility_ref.policy import Policy
from agility_ref.training.bank import action_period, trained_task
from agility_ref.training.policies import POLICIES

import numpy as np

TOLERANCE = 1e-5  # largest difference between what a file says and what the numpy policy says, see compare
UNITS = {  # and frames of what a policy sees; see Go1Env
    "base_lin_vel": "m/s, trunk frame", "base_ang_vel": "rad/s, trunk frame",
    "projected_gravity": "unit vector, trunk frame", "heading_error": "rad, to this and to the next waypoint",
    "command": "m/s", "dof_pos": "rad from home", "dof_vel": "rad/s", "last_action": "as the action",
    "foot_contact": "0 or 1, feet FR FL RR RL", "scandots": "m, 12 x 11 points, x-major",
}  # fmt: skip


def describe(policy: Policy) -> dict:
    """Return what goes in and what comes out, with names and units, as a dict that JSON can hold."""
    task = trained_task(policy.name, policy.meta, EnvConfig())
    scale, limit = task["action-scale"], task["action-limit"]
    if policy.obs_dim == NUM_SCANDOTS:
        parts = {"scandots": slice(0, NUM_SCANDOTS)}
    else:
        parts = observation_slices()
    inputs = [{"name": name, "start": p.start, "stop": p.stop, "unit": UNITS[name]} for name, p in parts.items()]
    skills = POLICIES[policy.name].skills if policy.name in POLICIES else ()
    if skills:
        output = {"name": "logits", "labels": list(skills), "unit": "the largest names the skill that acts"}
    else:
        output = {
            "name": "action", "labels": list(JOINTS), "unit": f"{scale:g} rad of joint target from home",
            "home_rad": DEFAULT_DOF_POS.tolist(), "scale_rad": scale, "clip": limit, "period_s": action_period(task),
        }  # fmt: skip
    return {
        "policy": policy.name, "digest": policy.digest(), "made_with": f"agility_ref {__version__}",
        "input": {"name": "observation", "parts": inputs}, "output": output,
    }  # fmt: skip


def export_policy(policy: Policy, out: Path, form: str) -> float:
    """Write a policy; return the largest difference between its actions and the file's.

    Parameters
    ----------
    policy : normaliser, bounds and layers
    out : the file
    form : "onnx", "npz" or "torchscript"

    Raises
    ------
    UserError : another form, no folder to write into, a package that is missing, or a policy that sees
        something else than the observation or the scandots
    """
    if form not in FORMS:
        raise unknown_name("format", form, FORMS)
    out = Path(out)
    if not out.parent.is_dir():
        raise UserError(f"no folder {out.parent} to write {out.name} into")
    if policy.obs_dim not in (OBS_DIM, NUM_SCANDOTS):
        raise UserError(f"{policy.name} sees {policy.obs_dim} numbers, not {OBS_DIM} or {NUM_SCANDOTS}")
    write, load = FORMS[form]
    with replacing_path(out) as partial:
        write(policy, describe(policy), partial)
        return compare(policy, load(partial))


def compare(policy: Policy, act: Callable[[np.ndarray], np.ndarray]) -> float:
    """Return the largest difference between two policies on 256 observations, some beyond all bounds.

    It is absolute for actions, and relative to the largest output where that is above 1: logits are of any size.

    Raises
    ------
    RuntimeError : it is above TOLERANCE
    """
    spread = np.random.default_rng(0).normal(0.0, 3.0, (256, policy.obs_dim)).astype(np.float32)
    observation = (policy.mean + policy.std * spread).astype(np.float32)
    expected = policy(observation)
    difference = float(np.abs(act(observation) - expected).max() / max(1.0, np.abs(expected).max()))
    if difference > TOLERANCE:
        raise RuntimeError(f"the exported {policy.name} differs by {difference:.2g}, more than {TOLERANCE:g}")
    return difference


def _missing(error: ImportError) -> UserError:
    return UserError(f'this needs {error.name}: pip install "agility-ref[export]"')


# ---------------------------------------------------------------------------- ONNX


def write_onnx(policy: Policy, record: dict, path: Path) -> None:
    """Write ``observation`` (N, obs_dim) -> ``action`` or ``logits`` (N, act_dim), float32, opset 17."""
    try:
        import onnx
        from onnx import TensorProto, helper, numpy_helper
    except ImportError as error:
        raise _missing(error) from None
    constants = {"mean": policy.mean, "std": policy.std, "low": policy.low, "high": policy.high}
    nodes = [  # x = clip((observation - mean) / std, low, high)
        helper.make_node("Sub", ["observation", "mean"], ["centred"]),
        helper.make_node("Div", ["centred", "std"], ["normalized"]),
        helper.make_node("Max", ["normalized", "low"], ["at_least"]),
        helper.make_node("Min", ["at_least", "high"], ["x0"]),
    ]
    last, output = len(policy.layers) - 1, record["output"]["name"]
    for i, (weight, bias) in enumerate(policy.layers):  # x W^T + b, with ELU between the layers
        constants |= {f"weight{i}": weight, f"bias{i}": bias}
        result = output if i == last else f"y{i}"
        nodes.append(helper.make_node("Gemm", [f"x{i}", f"weight{i}", f"bias{i}"], [result], transB=1))
        if i < last:
            nodes.append(helper.make_node("Elu", [result], [f"x{i + 1}"]))
    widths = {"observation": policy.obs_dim, output: len(policy.layers[-1][1])}
    x, y = (helper.make_tensor_value_info(n, TensorProto.FLOAT, ["N", width]) for n, width in widths.items())
    arrays = [numpy_helper.from_array(np.asarray(a, np.float32), name) for name, a in constants.items()]
    graph = helper.make_graph(nodes, "policy", [x], [y], arrays)
    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", 17)], producer_name="agility_ref", ir_version=8
    )
    helper.set_model_props(model, {key: json.dumps(value) for key, value in record.items()})
    onnx.checker.check_model(model, full_check=True)
    onnx.save(model, path)


def load_onnx(path: Path) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function that onnxruntime makes of a file."""
    try:
        import onnxruntime
    except ImportError as error:
        raise _missing(error) from None
    session = onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])
    return lambda observation: session.run(None, {"observation": observation})[0]


# ---------------------------------------------------------------------------- TorchScript


def write_torchscript(policy: Policy, record: dict, path: Path) -> None:
    """Trace the same function; the record is the extra file ``metadata.json``."""
    import torch
    from torch import nn

    layers = []
    for weight, bias in policy.layers:
        linear = nn.Linear(weight.shape[1], weight.shape[0])
        linear.load_state_dict({"weight": torch.tensor(weight), "bias": torch.tensor(bias)})
        layers += [linear, nn.ELU()]
    constants = {name: torch.tensor(getattr(policy, name)) for name in ("mean", "std", "low", "high")}

    class Network(nn.Module):
        def __init__(self):
            super().__init__()
            self.net = nn.Sequential(*layers[:-1])
            for name, value in constants.items():
                self.register_buffer(name, value)

        def forward(self, observation):
            x = torch.minimum(torch.maximum((observation - self.mean) / self.std, self.low), self.high)
            return self.net(x)

    traced = torch.jit.trace(Network().eval(), torch.zeros(1, policy.obs_dim))
    torch.jit.save(traced, str(path), _extra_files={"metadata.json": json.dumps(record)})


def load_torchscript(path: Path) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function of a file."""
    import torch

    network = torch.jit.load(str(path))
    return lambda observation: network(torch.from_numpy(observation)).detach().numpy()


# ---------------------------------------------------------------------------- arrays


def write_arrays(policy: Policy, record: dict, path: Path) -> None:
    """Write ``mean std low high weight0 bias0 ...``, float32, and ``metadata``, a string of JSON."""
    arrays = {"mean": policy.mean, "std": policy.std, "low": policy.low, "high": policy.high}
    for i, (weight, bias) in enumerate(policy.layers):
        arrays |= {f"weight{i}": weight, f"bias{i}": bias}
    with open(path, "wb") as file:
        np.savez(file, metadata=json.dumps(record), **{k: np.asarray(a, np.float32) for k, a in arrays.items()})


def load_arrays(path: Path) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function of a file, written as a reader without this package would."""
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    depth = sum(name.startswith("weight") for name in arrays)

    def act(observation: np.ndarray) -> np.ndarray:
        x = np.clip((observation - arrays["mean"]) / arrays["std"], arrays["low"], arrays["high"])
        for i in range(depth):
            x = x @ arrays[f"weight{i}"].T + arrays[f"bias{i}"]
            if i < depth - 1:
                x = np.where(x > 0, x, np.expm1(np.minimum(x, 0)))
        return x

    return act


FORMS = {
    "onnx": (write_onnx, load_onnx),
    "npz": (write_arrays, load_arrays),
    "torchscript": (write_torchscript, load_torchscript),
}
SUFFIXES = {"onnx": ".onnx", "npz": ".npz", "torchscript": ".pt"}

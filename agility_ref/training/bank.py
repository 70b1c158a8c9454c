"""Bank: where the weights of a policy lie, and policies loaded from there.

In:  the name of a policy and a :class:`WeightsConfig`, which says the preset, the seed and the folder.
Out: the policy, from the folder of its finished run or from the shipped weights, refused where it
does not fit the task or its skills.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from agility_ref.curriculum import hardest
from agility_ref.env import ACTION_DIM, TRAINING, EnvConfig
from agility_ref.errors import UserError
from agility_ref.files import read_json, read_npz
from agility_ref.observation import NUM_SCANDOTS, OBS_DIM
from agility_ref.policy import Policy
from agility_ref.selector import Hierarchy, Single, oracle_hierarchy, selector_hierarchy
from agility_ref.training import weights
from agility_ref.training.policies import find_policy

import numpy as np


@dataclass(frozen=True)
class WeightsConfig:
    """Which weights: all that loading a policy has to know."""

    preset: str = "full"  # quick (d up to 0.4, small budgets) or full (d up to 1)
    seed: int = 0  # seed of courses, networks and exploration
    out: str = ""  # folder of runs; runs/<preset> by default
    env: EnvConfig = TRAINING  # the task

    @property
    def root(self) -> Path:
        """Folder that holds the runs."""
        return Path(self.out or f"runs/{self.preset}")


def existing(folder: str) -> str:
    """Return a folder of runs that must be there; "" stands for the default, which need not be.

    Raises
    ------
    UserError : there is no such folder, or it holds no runs
    """
    if folder and not Path(folder).is_dir():
        raise UserError(f"no folder of runs at {folder}")
    if folder and not any(Path(folder).glob("*/seed*/")):
        raise UserError(f"no runs in {folder}: it is to hold POLICY/seed0")
    return folder


def run_folder(root: Path, policy: str, seed: int) -> Path:
    """Return the folder of one run."""
    return Path(root) / find_policy(policy).name / f"seed{seed}"


def unfinished(folder: Path) -> bool:
    """Whether a run was begun, or a finished one was being replaced, without coming to its end."""
    return (folder.exists() and not (folder / "DONE").exists()) or (not folder.exists() and replaced(folder).exists())


def replaced(folder: Path) -> Path:
    """Return where the finished run of a folder lies while a new one takes its place."""
    return folder.with_name(f".{folder.name}.old")


def find_weights(policy: str, config: WeightsConfig) -> Path | None:
    """Find the weights of a policy: own runs first, then those shipped; None where neither exists.

    Raises
    ------
    UserError : unknown policy or preset, an unfinished run, one of another preset, or settings or shipped weights
        that are damaged
    """
    hardest(config.preset)  # refuses an unknown one
    own = run_folder(config.root, policy, config.seed)
    if unfinished(own):
        raise UserError(f"{own} holds a run that is not finished; finish it with: {_training_command(policy, config)}")
    if not own.exists():
        return weights.shipped(config.preset, policy, config.seed)
    settings = own / "config.json"
    trained = read_json(settings).get("preset") if settings.exists() else config.preset
    if trained != config.preset:
        raise UserError(f"{own} was trained under the preset {trained}, not {config.preset}")
    return own / "policy.npz"


def _training_command(policy: str, config: WeightsConfig) -> str:
    out = f" --out {config.out}" if config.out else ""
    return f"agility-ref train {policy} --preset {config.preset} --seed {config.seed}{out}"


def weights_path(policy: str, config: WeightsConfig) -> Path:
    """Find the weights of a policy as :func:`find_weights` does.

    Raises
    ------
    UserError : as there, or there are none; names the command that trains them
    """
    found = find_weights(policy, config)
    if found:
        return found
    raise UserError(
        f"no weights for {policy}, preset {config.preset}, seed {config.seed}; "
        f"train them with: {_training_command(policy, config)}"
    )


def load_policy(policy: str, config: WeightsConfig) -> Single | Hierarchy:
    """Load a policy of Table 1, its skills included, ready to act."""
    spec = find_policy(policy)
    skills = load_bank(spec.skills, config)
    if spec.method == "oracle":
        return oracle_hierarchy(policy, skills)
    if not skills:
        return Single(policy, load_skill(weights_path(policy, config), config.env))
    path = weights_path(policy, config)
    own = Policy.load(path)
    _check_shape(own, own.obs_dim if own.obs_dim in (OBS_DIM, NUM_SCANDOTS) else OBS_DIM, len(skills))
    for name in other_skills(own.meta, digests(skills)):
        raise UserError(
            f"{path} was trained over another {name} than {weights_path(name, config)}; train it again, "
            "or give another --runs"
        )
    return selector_hierarchy(policy, skills, own)


def check_interface(source: Path, meta: dict, env: EnvConfig) -> None:
    """Refuse a policy whose actions mean something else in ``env``.

    Raises
    ------
    UserError : names the file and the field that differs
    """
    trained, here = trained_task(source, meta, env), as_flags(asdict(env))
    for field in ("action-scale", "action-limit", "action-repeat", "physics.kp", "physics.kd"):
        if trained[field] != here[field]:
            raise UserError(f"{source} was trained with env.{field} {trained[field]}, this task has {here[field]}")
    periods = [action_period(task) for task in (trained, here)]
    if not np.isclose(*periods):
        raise UserError(f"{source} was trained to act every {periods[0]:g} s, this task asks every {periods[1]:g} s")


def trained_task(source: Path | str, meta: dict, env: EnvConfig) -> dict[str, float]:
    """Return the flags of the task that a checkpoint's record names; those of ``env`` where it names none.

    Raises
    ------
    UserError : names ``source``, whose record holds something else than numbers
    """
    recorded, ours = meta.get("config", {}).get("env", {}), as_flags(asdict(env))
    task = ours | (as_flags(recorded) if isinstance(recorded, dict) else {})
    if not isinstance(recorded, dict) or not all(isinstance(task[flag], int | float) for flag in ours):
        raise UserError(f"{source} is damaged: its record has env {str(recorded)[:40]!r}")
    return task


def action_period(task: dict[str, float]) -> float:
    """Return the time between two actions [s] of a task's flags; of a configuration it is :attr:`EnvConfig.dt`."""
    return task["physics.timestep"] * task["physics.substeps"] * task["action-repeat"]


def as_flags(settings: dict, prefix: str = "") -> dict[str, object]:
    """Name nested settings as the command line does: {"ppo": {"num_envs": 4}} is {"ppo.num-envs": 4}."""
    flat = {}
    for key, value in settings.items():
        name = prefix + key.replace("_", "-")
        flat |= as_flags(value, f"{name}.") if isinstance(value, dict) else {name: value}
    return flat


def changed_flags(recorded: dict, config: WeightsConfig) -> list[tuple[str, object, object]]:
    """Return (flag, recorded, now) where the settings that a run recorded are not those of ``config``.

    A flag that is newer than the record counts as unchanged.
    """
    began, now = as_flags(recorded), as_flags(json.loads(json.dumps(asdict(config))))
    return [(flag, began[flag], ours) for flag, ours in now.items() if began.get(flag, ours) != ours]


def load_bank(names: tuple[str, ...], config: WeightsConfig) -> dict[str, Policy]:
    """Load frozen specialists, in the order given."""
    return {name: load_skill(weights_path(name, config), config.env) for name in names}


def bank_steps(names: tuple[str, ...], config: WeightsConfig) -> int:
    """Environment steps spent on a bank of policies, a common warm start counted once.

    Checkpoints count their warm start.  With s_k the steps of policy k and w_k those it started
    from if its warm start is in the bank too (0 otherwise)::

        steps = sum over k of (s_k - w_k)

    Raises
    ------
    UserError : weights are missing or unreadable
    """
    records = {name: read_npz(weights_path(name, config))[1] for name in names}
    shared = [records[name].get("start", 0) for name in names if find_policy(name).warm_start in names]
    return sum(record["steps"] for record in records.values()) - sum(shared)


def digests(skills: dict[str, Policy]) -> dict[str, str]:
    """Name the very skills of a bank, as a selector records those it was trained over."""
    return {name: skill.digest() for name, skill in skills.items()}


def other_skills(meta: dict, bank: dict[str, str]) -> list[str]:
    """Return the skills of a selector's checkpoint that are not those of a bank's :func:`digests`."""
    return [name for name, digest in meta.get("skills", {}).items() if bank.get(name, digest) != digest]


def load_skill(path: Path, env: EnvConfig) -> Policy:
    """Load a policy that moves the joints, as ``env`` wants them moved.

    Raises
    ------
    UserError : unreadable, a selector, or trained with another time between actions or with actions that mean something else
    """
    policy = Policy.load(path)
    _check_shape(policy, OBS_DIM, ACTION_DIM)
    check_interface(path, policy.meta, env)
    return policy


def _check_shape(policy: Policy, obs_dim: int, act_dim: int) -> None:
    outputs = len(policy.layers[-1][1])
    if (policy.obs_dim, outputs) != (obs_dim, act_dim):
        raise UserError(
            f"{policy.name}: network is {policy.obs_dim} -> {outputs}, this environment needs {obs_dim} -> {act_dim}"
        )

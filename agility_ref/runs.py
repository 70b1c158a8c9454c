"""Runs: train one named policy into one folder, resumably.

    <out>/<policy>/seed<k>/  config.json  progress.csv  policy.npz  learning_curve.png  DONE

Files are written under a temporary name and renamed (progress.csv grows a row at a time), DONE last.  A run that was
stopped goes on from its folder; a finished one is never overwritten unless told to.

In:  the name of a policy, a preset and a seed.
Out: the folder, and the policies found in such folders or among the shipped weights.
"""

import csv
import json
import shutil
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from agility_ref import checkpoint, weights
from agility_ref.checkpoint import Policy
from agility_ref.curriculum import Curriculum, CurriculumConfig, training_world
from agility_ref.env import ACTION_DIM, Go1Env
from agility_ref.errors import UserError
from agility_ref.observation import NUM_SCANDOTS, OBS_DIM, SCANDOTS
from agility_ref.policies import PolicySpec, PPOConfig, find_policy, find_preset, requirements
from agility_ref.progress import ProgressLog, StopRequest, write_csv, write_text
from agility_ref.selector import (
    Hierarchy,
    SelectorConfig,
    SelectorEnv,
    Single,
    SupervisedConfig,
    collect_labels,
    fit_selector,
    oracle_hierarchy,
    selector_hierarchy,
)
from agility_ref.task import TRAINING, EnvConfig

if TYPE_CHECKING:
    from agility_ref.learner import Learner


@dataclass(frozen=True)
class TrainConfig:
    """One training run."""

    preset: str = "full"
    """quick (d up to 0.4, small budgets) or full (d up to 1)."""
    seed: int = 0
    """Seed of courses, networks and exploration."""
    out: str = ""
    """Folder of runs; runs/<preset> by default."""
    steps: int = 0
    """Environment steps, warm start included; 0 for the policy's budget."""
    overwrite: bool = False
    """Replace a finished run."""
    warm_start: bool = True
    """Start from the policy that the table of policies names; False for from scratch."""
    warm_std: float = 0.5
    """Exploration noise after a warm start; usual 0.3 to 0.8."""
    ppo: PPOConfig = PPOConfig()
    """Hyper-parameters of PPO."""
    env: EnvConfig = TRAINING
    """The task."""
    curriculum: CurriculumConfig = CurriculumConfig()
    """The levels."""
    selector: SelectorConfig = SelectorConfig()
    """Decisions of the learned selectors."""
    supervised: SupervisedConfig = SupervisedConfig()
    """Training of the supervised selector."""

    @property
    def root(self) -> Path:
        """Folder that holds the runs."""
        return Path(self.out or f"runs/{self.preset}")


def existing(folder: str) -> str:
    """Return a folder of runs that must be there; "" stands for the default, which need not be.

    Raises
    ------
    UserError : there is no such folder
    """
    if folder and not Path(folder).is_dir():
        raise UserError(f"no folder of runs at {folder}")
    return folder


def run_folder(root: Path, policy: str, seed: int) -> Path:
    """Return the folder of one run."""
    return Path(root) / find_policy(policy).name / f"seed{seed}"


def find_weights(policy: str, config: TrainConfig) -> Path | None:
    """Find the weights of a policy: own runs first, then those shipped; None where neither exists.

    Raises
    ------
    UserError : unknown policy or preset, or shipped weights that are damaged
    """
    find_preset(config.preset)
    own = run_folder(config.root, policy, config.seed)
    return own / "policy.npz" if (own / "DONE").exists() else weights.shipped(config.preset, policy, config.seed)


def weights_path(policy: str, config: TrainConfig) -> Path:
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
        f"train them with: agility-ref train {policy} --preset {config.preset} --seed {config.seed}"
    )


def load_policy(policy: str, config: TrainConfig) -> Single | Hierarchy:
    """Load a policy of Table 1, its skills included, ready to act."""
    spec = find_policy(policy)
    skills = load_skills(spec, config)
    if spec.method == "oracle":
        return oracle_hierarchy(policy, skills)
    if spec.method == "ppo":
        return Single(policy, load_skill(weights_path(policy, config), config.env))
    path = weights_path(policy, config)
    own = Policy.load(path)
    _check_shape(own, own.obs_dim if own.obs_dim in (OBS_DIM, NUM_SCANDOTS) else OBS_DIM, len(skills))
    found = digests(skills)
    for name, digest in own.meta.get("skills", {}).items():
        if found.get(name, digest) != digest:
            raise UserError(f"{path} was trained over another {name} than {weights_path(name, config)}; train it again")
    return selector_hierarchy(policy, skills, own)


def check_interface(source: Path, meta: dict, env: EnvConfig) -> None:
    """Refuse a policy whose actions mean something else in ``env``.

    Raises
    ------
    UserError : names the file and the field that differs
    """
    trained = _flat(meta.get("config", {}).get("env", {}))
    here = _flat(asdict(env))
    for field in ("action-scale", "action-limit", "action-repeat", "physics.kp", "physics.kd"):
        theirs, ours = trained.get(field, here[field]), here[field]
        if theirs != ours:
            raise UserError(f"{source} was trained with env.{field} {theirs}, this task has {ours}")


def _flat(settings: dict, prefix: str = "") -> dict[str, object]:
    """Name nested settings as the command line does: {"ppo": {"num_envs": 4}} is {"ppo.num-envs": 4}."""
    flat = {}
    for key, value in settings.items():
        name = prefix + key.replace("_", "-")
        flat |= _flat(value, f"{name}.") if isinstance(value, dict) else {name: value}
    return flat


def load_skills(spec: PolicySpec, config: TrainConfig) -> dict[str, Policy]:
    """Load the frozen specialists of a hierarchy, in the order of its outputs."""
    return {name: load_skill(weights_path(name, config), config.env) for name in spec.skills}


def digests(skills: dict[str, Policy]) -> dict[str, str]:
    """Name the very skills of a bank, as a selector records those it was trained over."""
    return {name: skill.digest() for name, skill in skills.items()}


def load_skill(path: Path, env: EnvConfig) -> Policy:
    """Load a policy that moves the joints, as ``env`` wants them moved.

    Raises
    ------
    UserError : unreadable, a selector, trained with a clock or with actions that mean something else
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


def train_policy(name: str, config: TrainConfig, quiet: bool = False) -> Path:
    """Train one policy and everything it needs that is missing; return its folder.

    Raises
    ------
    UserError : unknown names, negative steps, a finished run in the way
    """
    spec = find_policy(name)
    find_preset(config.preset)
    for what, given, least in (
        ("seed", config.seed, 0),
        ("steps", config.steps, 0),
        ("ppo.num-envs", config.ppo.num_envs, 1),
        ("ppo.num-steps", config.ppo.num_steps, 1),
        ("ppo.update-epochs", config.ppo.update_epochs, 1),
        ("ppo.num-minibatches", config.ppo.num_minibatches, 1),
        ("env.action-repeat", config.env.action_repeat, 1),
        ("env.scandot-period", config.env.scandot_period, 1),
        ("curriculum.num-levels", config.curriculum.num_levels, 1),
        ("curriculum.variants", config.curriculum.variants, 1),
        ("selector.decision-steps", config.selector.decision_steps, 1),
        ("selector.switch-cost", config.selector.switch_cost, 0),
        ("supervised.dagger-rounds", config.supervised.dagger_rounds, 0),
        ("supervised.epochs", config.supervised.epochs, 1),
        ("supervised.batch-size", config.supervised.batch_size, 1),
    ):
        if not given >= least:
            raise UserError(f"{what} must be at least {least}, got {given}")
    if spec.method == "oracle":
        raise UserError(
            "the oracle needs no training: it reads the region map; train its skills: " + ", ".join(spec.skills)
        )
    if (config.env.gait_clock or config.ppo.mirror) and spec.method != "ppo":
        raise UserError("env.gait-clock and ppo.mirror are for skills and generalists")
    if config.env.gait_clock and config.ppo.mirror:
        raise UserError("env.gait-clock does not go with ppo.mirror")
    folder = run_folder(config.root, name, config.seed)
    aside, replaces = folder.with_name(f"{folder.name}.old"), (folder / "DONE").exists()
    if replaces:
        if not config.overwrite:
            raise UserError(f"{folder} holds a finished run; choose another --out, or --overwrite to replace it")
        shutil.rmtree(aside, ignore_errors=True)
        folder.rename(aside)  # until the new run is finished
    try:
        needs = requirements(name) if config.warm_start else spec.skills
        for other in needs:
            if find_weights(other, config) is None:
                train_policy(other, replace(config, steps=0, overwrite=False), quiet)
        folder.mkdir(parents=True, exist_ok=True)
        (_train_supervised if spec.method == "supervised" else _train_ppo)(spec, config, folder, quiet)
    except UserError:
        if replaces:
            shutil.rmtree(folder, ignore_errors=True)
            aside.rename(folder)
        raise
    shutil.rmtree(aside, ignore_errors=True)
    return folder


def _write_config(spec: PolicySpec, config: TrainConfig, folder: Path) -> None:
    write_text(folder / "config.json", json.dumps({"policy": spec.name, **asdict(config)}, indent=1))


def make_env(spec: PolicySpec, config: TrainConfig) -> tuple[Go1Env, Curriculum]:
    """Build the training courses and the robots on them; seeds never meet those of evaluation."""
    top = find_preset(config.preset).max_difficulty
    world = training_world(spec.courses, config.curriculum, top, config.seed)
    curriculum = Curriculum(len(spec.courses), config.ppo.num_envs, config.curriculum, config.seed)
    env = Go1Env(world, config.ppo.num_envs, config.env, curriculum.next_course, config.seed)
    return env, curriculum


def _train_ppo(spec: PolicySpec, config: TrainConfig, folder: Path, quiet: bool) -> None:
    # Here, so that only training waits for torch.
    from agility_ref.learner import Learner
    from agility_ref.networks import Categorical, Gaussian
    from agility_ref.plots import learning_curve
    from agility_ref.ppo import train

    total = config.steps or spec.steps(config.preset)
    ppo = config.ppo
    selector = spec.method == "ppo-selector"
    hold = config.selector.decision_steps if selector else 1
    if selector:
        ppo = replace(ppo, ent_coef=config.selector.ent_coef, gamma=ppo.gamma**hold)
        config = replace(config, curriculum=replace(config.curriculum, enabled=False))
    env, curriculum = make_env(spec, config)
    act_dim = len(spec.skills) if selector else ACTION_DIM
    distribution = Categorical if selector else Gaussian
    learner = Learner.create(config.env.obs_dim, act_dim, ppo, config.seed, distribution, fixed=SCANDOTS)
    skills = load_skills(spec, config)
    bank = digests(skills)
    if selector:
        env = SelectorEnv(env, oracle_hierarchy(spec.name, skills), spec.reward, config.selector, config.ppo.gamma)
    rows = _resume_or_warm_start(spec, config, folder, learner, curriculum)
    if learner.steps >= total and not rows:
        raise UserError(f"{total} steps leave nothing to train: {learner.steps} are spent, warm start included")
    _write_config(spec, config, folder)
    log = ProgressLog(spec.name, folder, rows, total, quiet)
    kinds = [f"level_{kind}" for kind in spec.courses] if len(spec.courses) > 1 and config.curriculum.enabled else []
    stop = StopRequest()
    last_drawn = time.monotonic()
    start = last_drawn - (float(rows[-1]["wall_seconds"]) if rows else 0.0)

    def save(compress: bool) -> None:
        arrays = learner.arrays() | learner.training_arrays()
        arrays |= {f"curriculum.{name}": value for name, value in curriculum.state().items()}
        meta = {
            "policy": spec.name, "preset": config.preset, "seed": config.seed, "steps": learner.steps,
            "start": learner.start, "courses": spec.courses, "act_dim": act_dim, "obs_dim": config.env.obs_dim,
            "versions": checkpoint.versions(), "wall_seconds": time.monotonic() - start, "decision_steps": hold, "config": asdict(config),
            "skills": bank,
        }  # fmt: skip
        log.write()
        checkpoint.save(folder / "policy.npz", arrays, meta, compress)

    with stop:
        for record in train(env, learner, total, stop.requested):
            # PPO has counted decisions; budgets are in control steps.
            learner.steps += (hold - 1) * ppo.batch_size
            record |= {"steps": learner.steps, "steps_per_second": hold * record["steps_per_second"]}
            levels = dict(zip(kinds, curriculum.mean_levels(), strict=False))
            log.add(record, time.monotonic() - start, curriculum.mean_level(), levels)
            save(compress=False)  # every time: even a killed run loses no more than one iteration
            if time.monotonic() - last_drawn > 60.0:
                last_drawn = time.monotonic()
                learning_curve(folder / "progress.csv", folder / "learning_curve.png", spec.name)
        log.close()
        save(compress=True)
    if learner.steps < total:
        raise KeyboardInterrupt(f"stopped at {learner.steps} of {total} steps; the same command goes on from {folder}")
    learning_curve(folder / "progress.csv", folder / "learning_curve.png", spec.name)
    write_text(folder / "DONE", f"{learner.steps} steps\n")


def _resume_or_warm_start(
    spec: PolicySpec, config: TrainConfig, folder: Path, learner: "Learner", curriculum: Curriculum
) -> list[dict]:
    """Load the folder's checkpoint, or the warm start; return the progress so far."""
    saved = folder / "policy.npz"
    if saved.exists():
        arrays, meta = checkpoint.load(saved)
        began = {"preset": meta.get("preset", config.preset)} | _flat(meta.get("config", {}))
        now = _flat(json.loads(json.dumps(asdict(config))))
        for key, ours in now.items():
            if key not in ("steps", "out", "overwrite") and began.get(key, ours) != ours:
                raise UserError(
                    f"{folder} was started with {key} {began[key]}, not {ours}; give that, or another --out"
                )
        if not {"curriculum.level", "normalizer.count"} <= arrays.keys():
            raise UserError(f"{saved} can act but not be trained further: it lacks the state of a training run")
        learner.load_arrays(arrays)
        learner.steps, learner.start = meta["steps"], meta.get("start", 0)
        learner.generator.manual_seed(config.seed + learner.steps)  # not the noise of the first part again
        curriculum.load_state({"level": arrays["curriculum.level"]})
        if not (folder / "progress.csv").exists():  # stopped before the first iteration
            return []
        with open(folder / "progress.csv", newline="") as file:
            rows = [row for row in csv.DictReader(file) if None not in row.values()]  # the last may be cut short
        return [row for row in rows if int(row["steps"]) <= learner.steps]
    if spec.warm_start and config.warm_start:
        source = weights_path(spec.warm_start, config)
        arrays, meta = checkpoint.load(source)
        check_interface(source, meta, config.env)
        hidden = tuple(meta.get("config", {}).get("ppo", {}).get("hidden", config.ppo.hidden))
        if hidden != tuple(config.ppo.hidden):
            raise UserError(
                f"{source} has hidden layers of {hidden} units, not {config.ppo.hidden}; "
                f"train {spec.warm_start} with the same flags and --out first"
            )
        learner.warm_start(arrays, meta["steps"], config.warm_std)
    return []


def _train_supervised(spec: PolicySpec, config: TrainConfig, folder: Path, quiet: bool) -> None:
    """Collect oracle labels and fit the selector (paper section 3.2.3)."""
    start = time.monotonic()
    config = replace(config, curriculum=replace(config.curriculum, enabled=False))
    env, _ = make_env(spec, config)
    skills = load_skills(spec, config)
    _write_config(spec, config, folder)
    oracle = oracle_hierarchy("oracle", skills)
    rounds = config.supervised.dagger_rounds + 1
    total = config.steps or spec.steps(config.preset)
    actor, data, rows = oracle, [], []
    for k in range(rounds):
        data.append(collect_labels(env, actor, oracle, -(-total // rounds)))
        scandots, labels = (np.concatenate(part) for part in zip(*data, strict=True))
        arrays, losses = fit_selector(scandots, labels, len(skills), config.supervised, config.seed)
        meta = {
            "policy": spec.name, "preset": config.preset, "seed": config.seed, "steps": len(labels),
            "courses": spec.courses, "act_dim": len(skills), "obs_dim": NUM_SCANDOTS,
            "versions": checkpoint.versions(), "wall_seconds": time.monotonic() - start,
            "decision_steps": config.selector.decision_steps, "config": asdict(config),
            "skills": digests(skills),
        }  # fmt: skip
        actor = selector_hierarchy(spec.name, skills, Policy.from_arrays(arrays, meta))
        rows += [{"round": k, "states": len(labels), "epoch": e, "cross_entropy": v} for e, v in enumerate(losses)]
        if not quiet:
            print(f"{spec.name}: round {k}, {len(labels)} states, cross-entropy {losses[-1]:.4f}")
    write_csv(folder / "progress.csv", rows)
    checkpoint.save(folder / "policy.npz", arrays, meta)
    write_text(folder / "DONE", f"{len(labels)} states\n")

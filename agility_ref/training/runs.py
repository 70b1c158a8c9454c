"""Runs: train one named policy into one folder, resumably.

    <out>/<policy>/seed<k>/  config.json  progress.csv  policy.npz  learning_curve.png (of PPO)  DONE

Files are written under a temporary name and renamed (progress.csv grows a row at a time), DONE last.  A run of PPO that
was stopped goes on from its folder, the short ones that imitate start anew; a finished one is never overwritten unless
told to, and then stays until the new one, in the folder ``.seed<k>.new`` beside it, is finished.  One process at a time
writes a run.

In:  the name of a policy, a preset and a seed.
Out: the folder, from which :mod:`agility_ref.training.bank` loads the policy.
"""

import json
import shutil
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

from agility_ref.curriculum import Curriculum, CurriculumConfig, hardest, training_world
from agility_ref.env import ACTION_DIM, Go1Env
from agility_ref.errors import MAX_SEED, UserError, require_at_least
from agility_ref.files import read_npz, remove_partials, write_csv, write_npz, write_text
from agility_ref.observation import ACTION_MIRROR, NUM_SCANDOTS, OBS_DIM, OBS_MIRROR, SCANDOTS, Mirror
from agility_ref.policy import Policy, beyond_use
from agility_ref.ppo import Learner, PPOConfig, train
from agility_ref.selector import SelectorEnv, Single, oracle_hierarchy, selector_hierarchy
from agility_ref.training.bank import (
    WeightsConfig,
    changed_flags,
    check_interface,
    digests,
    find_weights,
    load_bank,
    other_skills,
    replaced,
    run_folder,
    unfinished,
    weights_path,
)
from agility_ref.training.imitation import (
    DistillConfig,
    FineTuneConfig,
    SupervisedConfig,
    collect_actions,
    collect_labels,
    fit_selector,
    fit_student,
)
from agility_ref.training.lock import locked
from agility_ref.training.policies import PolicySpec, find_policy, requirements
from agility_ref.training.progress import EPISODE, ProgressLog, StopRequest, attempt, rows_until, versions
from agility_ref.training.sight import sight
from agility_ref.training.state import (
    check_arrays,
    go_on,
    has_blocks,
    learner_state,
    policy_arrays,
    robots_state,
    warm_start,
)

import numpy as np

Draw = Callable[[Path, Path, str], object]
"""(progress.csv, the picture to write, title) -> whatever."""


@dataclass(frozen=True)
class TrainConfig(WeightsConfig):
    """One training run."""

    steps: int = 0  # environment steps, warm start included; 0 for the policy's budget
    overwrite: bool = False  # replace a finished run
    warm_start: bool = True  # start from the policy that the table of policies names; False for from scratch
    warm_std: float = 0.5  # exploration noise after a warm start; usual 0.3 to 0.8
    walk_gamma: float = 0.98  # discount of `walk`, in place of ppo.gamma; at 0.99 its trot is loose
    sight: bool = True
    """Let the trained policy see ground no higher or lower than its own courses show it; not for selectors and distilled policies."""
    ppo: PPOConfig = PPOConfig()  # hyper-parameters of PPO
    curriculum: CurriculumConfig = CurriculumConfig()  # the levels
    selector_ent_coef: float = 0.01  # entropy bonus of the PPO selectors, against mode collapse; usual 0.005 to 0.05
    supervised: SupervisedConfig = SupervisedConfig()  # training of the supervised selector
    distill: DistillConfig = DistillConfig()  # training of the distilled policy
    fine_tune: FineTuneConfig = FineTuneConfig()  # how PPO goes on from it

    def __post_init__(self):
        require_at_least(0, MAX_SEED, seed=self.seed, steps=self.steps)
        require_at_least(1e-9, warm_std=self.warm_std)


def train_policy(name: str, config: TrainConfig, quiet: bool = False, draw: Draw | None = None) -> Path:
    """Train one policy and everything it needs that is missing or unfinished; return its folder.

    Parameters
    ----------
    name : of the policy
    config : the run
    quiet : print nothing
    draw : draws learning_curve.png, now and then and at the end: :func:`agility_ref.pictures.plots.learning_curve`

    Raises
    ------
    UserError : unknown names, settings out of range, a finished run or another process in the way, damaged files,
        numbers that are no longer finite
    """
    spec = find_policy(name)
    hardest(config.preset)  # refuses an unknown one
    if spec.method == "oracle":
        raise UserError(
            "the oracle needs no training: it reads the region map; train its skills: " + ", ".join(spec.skills)
        )
    return _train_in_its_folder(spec, config, quiet, draw)


def _train_in_its_folder(
    spec: PolicySpec, config: TrainConfig, quiet: bool, draw: Draw | None, needed: bool = False
) -> Path:
    """Train a policy while nobody else does; one that another run ``needed`` may be there by the time it is ours."""
    folder = run_folder(config.root, spec.name, config.seed)
    with locked(folder, wait=needed, quiet=quiet):
        new, old = folder.with_name(f".{folder.name}.new"), replaced(folder)
        if old.exists():  # a process died while it put a new run in the place of a finished one
            _replace(folder, new, old)
        work = folder
        if (folder / "DONE").exists():
            if needed:
                return folder
            if not config.overwrite:
                raise UserError(f"{folder} holds a finished run; choose another --out, or --overwrite to replace it")
            work = new  # the finished run stays where it is until this one is
        begun = work.exists()
        try:
            _prepare(spec, config, quiet, draw)
            work.mkdir(parents=True, exist_ok=True)
            remove_partials(work)
            if spec.method in ("supervised", "distilled"):
                _imitate(spec, config, work, quiet)
            else:
                _train_ppo(spec, config, work, quiet, draw)
        except BaseException:
            if not begun and work.exists() and not (work / "policy.npz").exists():  # nothing to go on from
                shutil.rmtree(work)
            raise
        if work == new:
            folder.rename(old)
            _replace(folder, new, old)
    return folder


def _replace(folder: Path, new: Path, old: Path) -> None:
    """Put the finished run ``new`` at ``folder``, from which ``old`` has been set aside, and delete ``old``."""
    if not folder.exists():
        new.rename(folder)
    shutil.rmtree(old)


def _prepare(spec: PolicySpec, config: TrainConfig, quiet: bool, draw: Draw | None) -> None:
    """Train what a policy needs and what is not there; say which of the rest is shipped."""
    shipped = []
    for other in requirements(spec.name) if config.warm_start else spec.skills + spec.teachers:
        own = run_folder(config.root, other, config.seed)
        found = None if unfinished(own) else find_weights(other, config)
        # Weights whose network has an older form act, but nothing can start from them.
        starts = other != spec.warm_start or own.exists() or (found and has_blocks(read_npz(found)[0]))
        if found is None or not starts:
            theirs = replace(config, steps=0, overwrite=False)
            _train_in_its_folder(find_policy(other), theirs, quiet, draw, needed=True)
        elif not own.exists():
            shipped.append(other)
    if shipped and not quiet:
        print(f"{spec.name}: none of {config.root}, so from the shipped weights: {' '.join(shipped)}", flush=True)


def _write_config(spec: PolicySpec, config: TrainConfig, folder: Path) -> None:
    write_text(folder / "config.json", json.dumps({"policy": spec.name, **asdict(config)}, indent=1))


def make_env(spec: PolicySpec, config: TrainConfig) -> tuple[Go1Env, Curriculum]:
    """Build the training courses and the robots on them; the seeds of courses never meet those of evaluation."""
    top = hardest(config.preset)
    world = training_world(spec.courses, config.curriculum, top, config.seed)
    curriculum = Curriculum(len(spec.courses), config.ppo.num_envs, config.curriculum, config.seed)
    env = Go1Env(world, config.ppo.num_envs, config.env, curriculum.next_course, config.seed)
    return env, curriculum


def _goes_on_from_distilled(spec: PolicySpec) -> bool:
    return spec.warm_start is not None and find_policy(spec.warm_start).method == "distilled"


def ppo_config(spec: PolicySpec, config: TrainConfig) -> PPOConfig:
    """Return the hyper-parameters that a policy learns with."""
    if spec.method == "ppo-selector":
        return replace(config.ppo, ent_coef=config.selector_ent_coef)
    if spec.warm_start is None:
        return replace(config.ppo, gamma=config.walk_gamma)
    if _goes_on_from_distilled(spec) and config.warm_start:
        return config.fine_tune.apply(config.ppo)
    return config.ppo


def _train_ppo(spec: PolicySpec, config: TrainConfig, folder: Path, quiet: bool, draw: Draw | None) -> None:
    total = config.steps or spec.steps(config.preset)
    ppo = ppo_config(spec, config)
    selector = spec.method == "ppo-selector"
    if selector:
        config = replace(config, curriculum=replace(config.curriculum, enabled=False))
    robots, curriculum = make_env(spec, config)
    # What is seen mirrored asks for the same skill, and for the mirrored action.
    act_mirror = Mirror.identity(len(spec.skills)) if selector else ACTION_MIRROR
    seen = {}
    if config.sight and not selector:  # which chooses on all courses and is to see them as they are
        seen["seen.low"], seen["seen.high"] = sight(robots.world)
    learner = Learner.create(OBS_MIRROR, act_mirror, ppo, config.seed, selector, fixed=SCANDOTS)
    skills = load_bank(spec.skills, config)
    bank = digests(skills)
    env = robots
    if selector:
        env = SelectorEnv(robots, oracle_hierarchy(spec.name, skills), spec.reward)
    columns = [f"level_{kind}" for kind in spec.courses] if len(spec.courses) > 1 and config.curriculum.enabled else []
    rows, episodes = _resume_or_warm_start(spec, config, folder, learner, robots, curriculum, bank, columns)
    if learner.steps >= total and not rows:
        raise UserError(f"{total} steps leave nothing to train: {learner.steps} are spent, warm start included")
    _write_config(spec, config, folder)
    log = ProgressLog(spec.name, folder, rows, episodes, learner.steps, total, config.env.action_repeat, quiet)
    stop = StopRequest()
    last_drawn = time.monotonic()
    start = last_drawn - (float(rows[-1]["wall_seconds"]) if rows else 0.0)

    record = {
        "policy": spec.name, "preset": config.preset, "seed": config.seed, "start": learner.start,
        "courses": spec.courses, "act_dim": len(act_mirror.index), "obs_dim": OBS_DIM, "versions": versions(),
        "config": asdict(config), "skills": bank,
    }  # fmt: skip

    def save(compress: bool) -> None:
        arrays = policy_arrays(learner) | learner_state(learner) | robots_state(robots, curriculum) | seen
        arrays |= {"progress.episodes": log.last_episodes()}
        if bad := beyond_use(arrays):
            raise _diverged(folder, bad, learner)
        meta = record | {"steps": learner.steps, "wall_seconds": time.monotonic() - start}
        log.write()
        write_npz(folder / "policy.npz", arrays, meta, compress)

    with stop, log, np.errstate(over="ignore", invalid="ignore"):  # what is no longer finite is found below
        for iteration in train(env, learner, total, stop.requested, robots.observation if rows else None):
            if bad := next((key for key, x in iteration.items() if key != "episodes" and not np.isfinite(x)), ""):
                raise _diverged(folder, bad, learner)
            levels = curriculum.levels()
            by_kind = dict(zip(columns, levels, strict=False))
            log.add(iteration, time.monotonic() - start, float(levels.mean()), by_kind)
            save(compress=False)  # every time: even a killed run loses no more than one iteration
            if draw and time.monotonic() - last_drawn > 60.0:
                last_drawn = time.monotonic()
                attempt(draw, folder / "progress.csv", folder / "learning_curve.png", spec.name)
        save(compress=True)
    if learner.steps < total:
        raise KeyboardInterrupt(f"stopped at {learner.steps} of {total} steps; the same command goes on from {folder}")
    if draw:
        attempt(draw, folder / "progress.csv", folder / "learning_curve.png", spec.name)
    write_text(folder / "DONE", f"{learner.steps} steps\n")


def _diverged(folder: Path, quantity: str, learner: Learner) -> UserError:
    kept = (
        f"{folder} keeps the policy of the iteration before" if (folder / "policy.npz").exists() else "nothing was kept"
    )
    iteration = (learner.steps - learner.start) // learner.config.batch_size
    return UserError(
        f"training has diverged: {quantity} is not finite, or huge, in iteration {iteration}, at {learner.steps} steps; "
        f"{kept}; try smaller learning rates or reward weights, and another --out"
    )


def _resume_or_warm_start(
    spec: PolicySpec,
    config: TrainConfig,
    folder: Path,
    learner: Learner,
    robots: Go1Env,
    curriculum: Curriculum,
    bank: dict[str, str],
    level_columns: list[str],
) -> tuple[list[dict], np.ndarray]:
    """Load the folder's checkpoint, or the warm start; return the progress so far and the last episodes."""
    saved = folder / "policy.npz"
    if saved.exists():
        arrays, meta = read_npz(saved)
        recorded = {"preset": meta.get("preset", config.preset)} | meta.get("config", {})
        for flag, began, ours in changed_flags(recorded, config):
            if flag not in ("steps", "out", "overwrite"):
                raise UserError(f"{folder} was started with {flag} {began}, not {ours}; give that, or another --out")
        for other in other_skills(meta, bank):
            raise UserError(f"{folder} was started over another {other}; give its folder, or another --out")
        check_arrays(saved, arrays, learner, robots, curriculum)
        learner.steps, learner.start = meta["steps"], meta.get("start", 0)
        spent = (learner.start, learner.steps, learner.config.batch_size)
        rows = rows_until(folder / "progress.csv", *spent, tuple(level_columns))
        go_on(arrays, learner, robots, curriculum)
        return rows, arrays["progress.episodes"]
    if spec.warm_start and config.warm_start:
        source = weights_path(spec.warm_start, config)
        arrays, meta = read_npz(source)
        check_interface(source, meta, config.env)
        if not has_blocks(arrays):
            raise UserError(f"{source} holds a network of an older form; train {spec.warm_start} anew, with --out")
        hidden = tuple(meta.get("config", {}).get("ppo", {}).get("hidden", config.ppo.hidden))
        if hidden != tuple(config.ppo.hidden):
            raise UserError(
                f"{source} has hidden layers of {hidden} units, not {config.ppo.hidden}; "
                f"train {spec.warm_start} with the same flags and --out first"
            )
        # A distilled policy knows its way: noise as after a walk would only throw it off.
        std = config.fine_tune.std if _goes_on_from_distilled(spec) else config.warm_std
        warm_start(learner, arrays, meta["steps"], std, config.fine_tune.critic_steps)
    return [], np.zeros((0, len(EPISODE)))


def _imitate(spec: PolicySpec, config: TrainConfig, folder: Path, quiet: bool) -> None:
    """Collect what the oracle says, learn it, act, and collect again (paper sections 3.2.3 and 5)."""
    start = time.monotonic()
    config = replace(config, curriculum=replace(config.curriculum, enabled=False))
    env, _ = make_env(spec, config)
    bank = load_bank(spec.skills or spec.teachers, config)
    _write_config(spec, config, folder)
    oracle = oracle_hierarchy("oracle", bank)
    meta = {
        "policy": spec.name, "preset": config.preset, "seed": config.seed, "courses": spec.courses,
        "versions": versions(), "config": asdict(config),
    }  # fmt: skip
    if spec.method == "supervised":
        how, loss = config.supervised, "cross_entropy"
        meta |= {"obs_dim": NUM_SCANDOTS, "act_dim": len(bank), "skills": digests(bank)}
        collect = collect_labels
        fit = partial(fit_selector, num_skills=len(bank), config=how, seed=config.seed)
        student = partial(selector_hierarchy, spec.name, bank)
    else:
        how, loss = config.distill, "squared_error"
        meta |= {"obs_dim": OBS_DIM, "act_dim": ACTION_DIM, "teachers": digests(bank)}
        collect = partial(collect_actions, action_noise=how.action_noise)
        fit = partial(fit_student, hidden=config.ppo.hidden, config=how, seed=config.seed)
        student = partial(Single, spec.name)
    rounds = how.dagger_rounds + 1
    share = -(-(config.steps or spec.steps(config.preset)) // rounds)
    actor, data, rows = oracle, [], []
    for k in range(rounds):
        data.append(collect(env, actor, oracle, share))
        data = [tuple(np.concatenate(part) for part in zip(*data, strict=True))]  # what was seen, what was asked for
        arrays, losses = fit(*data[0])
        if bad := beyond_use(arrays):
            raise UserError(
                f"training has diverged: {bad} is not finite, or huge; try a smaller learning rate, and another --out"
            )
        states = len(data[0][0])
        meta |= {"steps": states, "wall_seconds": time.monotonic() - start}
        actor = student(Policy.from_arrays(arrays, meta))
        rows += [{"round": k, "states": states, "epoch": e, loss: v} for e, v in enumerate(losses)]
        if not quiet:
            print(f"{spec.name}: round {k}, {states} states, {loss.replace('_', ' ')} {losses[-1]:.4f}", flush=True)
    write_csv(folder / "progress.csv", rows)
    write_npz(folder / "policy.npz", arrays, meta)
    write_text(folder / "DONE", f"{states} states\n")

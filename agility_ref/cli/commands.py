"""The commands that compute: ``train``, ``evaluate``, ``table1``, ``diagnose``, ``list``.

In:  a command's options.  Out: text or one JSON object, and the files it names.
"""

import json
import shlex
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated

from agility_ref.errors import UserError

import tyro

Policy = Annotated[str, tyro.conf.arg(metavar="POLICY")]
Environment = Annotated[str, tyro.conf.arg(metavar="ENVIRONMENT")]
Preset = Annotated[str, tyro.conf.arg(metavar="PRESET")]
Folder = Annotated[str, tyro.conf.arg(metavar="FOLDER")]
File = Annotated[str, tyro.conf.arg(metavar="FILE")]
Words = tuple[str, ...]


def take(kind: type, options):
    """Return a configuration of this kind, its fields taken from the options that have their names."""
    return kind(**{f.name: getattr(options, f.name) for f in fields(kind) if hasattr(options, f.name)})


TYPED: list[str] = []  # the words of the command, set by main


def command_line() -> str:
    """Return the command that was typed, for the metadata of what it makes."""
    return shlex.join(["agility-ref", *TYPED])


@dataclass(frozen=True, kw_only=True)
class Evaluated:
    """What is played, and where the weights are: what most commands share."""

    preset: Preset = "full"  # quick draws d ~ U(0, 0.4), full U(0, 1); also names the weights.
    seed: int = 0  # Seed of courses, starts, commands, noise and pushes.
    train_seed: int = 0  # Training seed of the weights.
    runs: Folder = ""  # Folder of runs to look in before the shipped weights; runs/<preset> by default.

    def evaluation(self):
        """Return what is played as an EvaluationConfig."""
        from agility_ref.evaluate import EvaluationConfig

        return take(EvaluationConfig, self)

    def weights(self):
        """Return what names the weights as a WeightsConfig."""
        from agility_ref.training.bank import WeightsConfig, existing

        return WeightsConfig(preset=self.preset, seed=self.train_seed, out=existing(self.runs))


def evaluation_flags() -> type:
    """Return the other flags of an evaluation."""
    from agility_ref.evaluate import EvaluationConfig

    return EvaluationConfig


# ---------------------------------------------------------------------------- train


@dataclass(frozen=True, kw_only=True)
class Train:
    """Train a policy, and first whatever it needs: its warm start, its skills.

    For example:
        agility-ref train walk --preset quick --out runs/mine
        agility-ref train leap --seed 1 --ppo.learning-rate 3e-4
    """

    policy: tyro.conf.Positional[Policy]  # See `agility-ref list`.
    preset: Preset = "full"  # quick (d up to 0.4, small budgets) or full (d up to 1).
    seed: int = 0  # Seed of courses, networks and exploration.
    out: Folder = ""  # Folder of runs; runs/<preset> by default.
    steps: int = 0  # Environment steps, warm start included; 0 for the policy's budget.
    overwrite: bool = False  # Replace a finished run.
    warm_start: bool = True  # Start from the policy that the table of policies names; False for from scratch.


def train_flags() -> type:
    """Return the other flags of a training: every hyper-parameter."""
    from agility_ref.training.runs import TrainConfig

    return TrainConfig


def train(options: Train) -> None:
    """Train one policy."""
    from agility_ref.pictures.plots import learning_curve
    from agility_ref.training.runs import TrainConfig, train_policy

    print(f"done: {train_policy(options.policy, take(TrainConfig, options), draw=learning_curve)}")


# ---------------------------------------------------------------------------- evaluate


@dataclass(frozen=True, kw_only=True)
class Evaluate(Evaluated):
    """Play complete episodes with the deterministic policy, noise and pushes on, and print the four metrics.

    For example:
        agility-ref evaluate leap --environment gap
        agility-ref evaluate gen-5 --environment climb-gap --difficulty 0.5 --episodes 128 --json
    """

    policy: tyro.conf.Positional[Policy]  # See `agility-ref list`.
    environment: Environment  # climb-gap, gap, beam or climb; or a training course: walk, climb-up, climb-down.
    episodes: int = 64  # Complete episodes, one per course; usual 64 to 256.
    difficulty: float | None = None  # Fixes the difficulty of all courses, 0 to 1.
    json: bool = False  # Print one JSON object.


def evaluate(options: Evaluate) -> None:
    """Evaluate one policy on one environment."""
    from agility_ref.evaluate import METRICS, evaluation_world
    from agility_ref.results.cells import acting_policies
    from agility_ref.results.published import evaluate_by_protocol, summary
    from agility_ref.training.bank import load_policy, weights_path

    config = options.evaluation()
    evaluation_world(options.environment, config)  # named before the weights are looked for
    training = options.weights()
    policy = load_policy(options.policy, training)
    acting = {name: str(weights_path(name, training)) for name in acting_policies(options.policy)}
    figures = summary(evaluate_by_protocol(policy, options.environment, config)) | {"weights": acting}
    if options.json:
        print(json.dumps(figures, allow_nan=False))
        return
    played = f"{figures['episodes']} episodes, {figures['control_steps']} control steps"
    print(f"{options.policy} on {options.environment}: {played}")
    for metric in METRICS:
        mean, std = figures[metric].values()
        print(f"  {metric:18} {mean:8.3f} ± {'-' if std is None else f'{std:.3f}'}")
    print(f"  {'falls':18} {figures['falls']:8.3f}")
    for path in acting.values():
        print(f"  weights {path}")


# ---------------------------------------------------------------------------- table1


@dataclass(frozen=True, kw_only=True)
class Table1(Evaluated):
    """Evaluate every policy on every terrain and print the table beside the paper's.

    Cells are stored as they are played: an interrupted table goes on where it was.

    For example:
        agility-ref table1
        agility-ref table1 --seeds all --findings --compare distilled gen-5
    """

    seed: int = 1  # the recipe was chosen on the courses of seed 0
    """Seed of courses, starts, commands, noise and pushes."""
    train_seed: tyro.conf.Suppress[int] = 0
    episodes: int = 64  # Complete episodes of each cell; usual 64 to 256.
    seeds: Annotated[Words, tyro.conf.arg(metavar="SEED ...")] = ("0",)
    """Training seeds of the weights: 0, or 0 1 2, or all for every seed that has weights."""
    train: bool = False  # Train every policy first, from scratch; finished runs in --runs are kept.
    findings: bool = False  # Also check each finding of the paper; writes findings.md.
    compare: Annotated[Words, tyro.conf.arg(metavar="POLICY POLICY ...")] = ()
    """Two policies or more: waypoint fraction of the first minus that of each other one, on paired episodes."""
    ablations: File = ""
    """Ablations for the findings, where measured; benchmarks/results/ablations-<preset>.csv by default."""
    results: Folder = "results"  # Folder for table1.csv, .md, .tex and .png, and for the cells behind them.


def table1(options: Table1) -> None:
    """Compute Table 1, and what it says about the paper's findings."""
    from agility_ref.files import remove_partials
    from agility_ref.results import findings, table1
    from agility_ref.training.bank import WeightsConfig, existing
    from agility_ref.training.lock import locked
    from agility_ref.training.policies import find_policy

    seeds, config, results = table1.parse_seeds(options.seeds), options.evaluation(), Path(options.results)
    if options.train and seeds is None:
        raise UserError("--train needs the numbers of the seeds: all are those that have weights already")
    if (options.findings or options.compare) and config.protocol != "complete":
        raise UserError(f"findings compare episode by episode: --protocol complete, not {config.protocol}")
    if len(options.compare) == 1:
        raise UserError(f"--compare needs two policies or more, not {options.compare[0]} alone")
    for name in options.compare:
        find_policy(name)
    if options.ablations and not Path(options.ablations).is_file():
        raise UserError(f"no file of ablations at {options.ablations}")
    training = WeightsConfig(preset=config.preset, out=options.runs if options.train else existing(options.runs))
    for seed in seeds if options.train else ():
        table1.train_all(replace(training, seed=seed))
    try:
        with locked(results):
            remove_partials(results / "cells")
            cells, missing = table1.compute(config, training, results / "cells", seeds)
            if not cells:
                raise UserError(f"not one cell to fill, {results} is left as it is: {missing[0]}")
            rows = table1.table_rows(cells)
            title = table1.title(config, rows)
            paths = table1.write_all(rows, results, title)  # files first: a terminal may fail
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted; the same command goes on from {results / 'cells'}") from None
    print(table1.text(rows))
    for line in missing:
        print(f"missing: {line}")
    filled = [sum(row.ours is not None for row in rows if (row.paper is None) == extra) for extra in (False, True)]
    extra = sum(row.paper is None for row in rows)
    print(
        f"{filled[0]} of {len(rows) - extra} cells filled, and {filled[1]} of {extra} beyond the paper; "
        f"mean ± std over episodes; wrote {', '.join(map(str, paths))}"
    )
    for comparison in findings.compare(cells, options.compare):
        print(f"{comparison.text:40} {comparison!s:24} seeds: {comparison.seeds}")
    if options.findings:
        ablations = options.ablations or f"benchmarks/results/ablations-{config.preset}.csv"
        checked = findings.check(cells, training, Path(ablations))
        print(f"\n{findings.text(checked)}\n\nwrote {findings.write(checked, results, title)}")


# ---------------------------------------------------------------------------- diagnose


@dataclass(frozen=True, kw_only=True)
class Diagnose(Evaluated):
    """Compare a selector's choices with the oracle's: accuracy, flicker, collapse, regret, odd behaviours.

    For example:
        agility-ref diagnose ps-sl-5
        agility-ref diagnose ps-rl-3 --environment climb-gap gap --json
    """

    policy: tyro.conf.Positional[Policy]  # oracle, ps-sl-5, ps-rl-3-env or ps-rl-3-oracle.
    environment: Annotated[Words, tyro.conf.arg(metavar="ENVIRONMENT ...")] = ("climb-gap", "gap", "beam", "climb")
    """One or more of climb-gap, gap, beam, climb; or training courses: walk, climb-up, climb-down."""
    episodes: int = 64  # Complete episodes, one per course; usual 64 to 256.
    difficulty: float | None = None  # Fixes the difficulty of all courses, 0 to 1.
    results: Folder = "results"  # Folder for the figures, as PNG and SVG.
    json: bool = False  # Print one JSON object.


def diagnose(options: Diagnose) -> None:
    """Diagnose one selector."""
    from agility_ref.evaluate import evaluation_world
    from agility_ref.results.diagnosis import draw, play_and_diagnose, report_text
    from agility_ref.training.policies import ENVIRONMENTS, POLICIES, find_policy

    spec, config = find_policy(options.policy), options.evaluation()
    if not spec.skills:
        choices = ", ".join(name for name, other in POLICIES.items() if other.skills)
        raise UserError(f"{options.policy} chooses between no skills; diagnose one of {choices}")
    if not options.environment:
        raise UserError(f"--environment needs at least one of {', '.join(ENVIRONMENTS)}")
    if config.protocol != "complete":
        raise UserError(f"diagnose plays complete episodes; --protocol {config.protocol} has none to compare")
    for environment in options.environment:
        evaluation_world(environment, config)  # named before the weights are looked for
    training = options.weights()
    Path(options.results).mkdir(parents=True, exist_ok=True)  # before the simulation, in case it cannot be made
    played, reports = play_and_diagnose(spec.name, options.environment, config, training)
    paths = draw(played, Path(options.results), command_line())
    if options.json:
        settings = {"preset": config.preset, "seed": config.seed, "train_seed": options.train_seed}
        print(json.dumps({"policy": spec.name, **settings, "environments": reports, "figures": [*map(str, paths)]}))
        return
    for report in reports:
        print(report_text(report))
    print(f"wrote {', '.join(map(str, paths))}")


# ---------------------------------------------------------------------------- list


@dataclass(frozen=True)
class List:
    """Print the policies with their courses, budgets and shipped weights, the environments and the presets."""


def list_names(options: List) -> None:
    """Print what there is."""
    from agility_ref.curriculum import PRESETS
    from agility_ref.training.policies import ALIASES, ENVIRONMENTS, POLICIES
    from agility_ref.training.weights import shipped_seeds

    print(f"environments: {' '.join(ENVIRONMENTS)}\npresets: {' '.join(PRESETS)}\n")
    print(f"{'policy':16}{'trains on':58}{'quick':>8}{'full':>8}  weights shipped (preset: seeds)")
    for spec in POLICIES.values():
        found = {preset: shipped_seeds(preset, spec.name) for preset in PRESETS}
        shipped = [f"{preset}: {' '.join(map(str, seeds))}" for preset, seeds in found.items() if seeds]
        budgets = "".join(f"{b / 1e6:7.1f}M" if b else f"{'-':>8}" for b in spec.budget)
        print(f"{spec.name:16}{' '.join(spec.courses) or '-':58}{budgets}  {', '.join(shipped) or '-'}")
    print("\n" + ", ".join(f"{alias} is {name}" for alias, name in ALIASES.items()))

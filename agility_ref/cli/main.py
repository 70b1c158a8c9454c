"""The command line: ``agility-ref train | evaluate | table1 | diagnose | plot | video | watch | list``.

Every hyper-parameter is a flag, because every configuration is a frozen dataclass that
tyro reads; the help text is the docstring of the field.  A mistake of the user prints one
line and exits with status 2.
"""

import errno
import io
import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro

from agility_ref.cli.diagnose import diagnose
from agility_ref.cli.pictures import plot, video, watch
from agility_ref.errors import UserError, one_line, unknown_name

USAGE = """usage: agility-ref COMMAND [--help]

  train POLICY                       train a policy (and what it needs)
  evaluate POLICY --environment E    the four metrics of Table 1
  table1                             all 43 cells beside the paper's, and its findings
  diagnose SELECTOR                  its choices against the oracle's: accuracy, flicker, regret
  plot KIND                          curves, strobe, oracle-map, episode, courses, skills, framework
  video POLICY --environment E       an episode as WebP, GIF or MP4
  watch POLICY --environment E       a live view in the browser
  list                               policies, environments, presets, weights
"""


def train(argv: list[str]) -> None:
    """Train one policy."""
    from agility_ref.pictures.plots import learning_curve
    from agility_ref.training.runs import TrainConfig, train_policy

    @dataclass(frozen=True)
    class Train:
        """Train a policy, and first whatever it needs: its warm start, its skills."""

        policy: tyro.conf.Positional[str]
        """See `agility-ref list`."""
        config: Annotated[TrainConfig, tyro.conf.arg(name="")] = field(default_factory=TrainConfig)

    args = tyro.cli(Train, args=argv, prog="agility-ref train")
    print(f"done: {train_policy(args.policy, args.config, draw=learning_curve)}")


def evaluate(argv: list[str]) -> None:
    """Evaluate one policy on one environment."""
    from agility_ref.evaluate import METRICS, EvaluationConfig, evaluation_world
    from agility_ref.results.cells import acting_policies
    from agility_ref.results.published import evaluate_by_protocol
    from agility_ref.training.bank import WeightsConfig, existing, load_policy, weights_path

    @dataclass(frozen=True)
    class Evaluate:
        """Play complete episodes with the deterministic policy; noise and pushes on."""

        policy: tyro.conf.Positional[str]
        """See `agility-ref list`."""
        environment: str
        """climb-gap, gap, beam or climb; or a training course: walk, climb-up, climb-down."""
        config: Annotated[EvaluationConfig, tyro.conf.arg(name="")] = field(default_factory=EvaluationConfig)
        train_seed: int = 0
        """Training seed of the weights."""
        runs: str = ""
        """Folder of runs to look in before the shipped weights; runs/<preset> by default."""
        json: bool = False
        """Print one JSON object."""

    args = tyro.cli(Evaluate, args=argv, prog="agility-ref evaluate")
    evaluation_world(args.environment, args.config)  # named before the weights are looked for
    training = WeightsConfig(preset=args.config.preset, seed=args.train_seed, out=existing(args.runs))
    policy = load_policy(args.policy, training)
    acting = {name: str(weights_path(name, training)) for name in acting_policies(args.policy)}
    summary = evaluate_by_protocol(policy, args.environment, args.config).summary() | {"weights": acting}
    if args.json:
        print(json.dumps(summary, allow_nan=False))
        return
    print(f"{args.policy} on {args.environment}: {summary['episodes']} episodes, {summary['environment_steps']} steps")
    for metric in METRICS:
        mean, std = summary[metric].values()
        print(f"  {metric:18} {mean:8.3f} ± {'-' if std is None else f'{std:.3f}'}")
    print(f"  {'falls':18} {summary['falls']:8.3f}")
    for path in acting.values():
        print(f"  weights {path}")


def table1(argv: list[str]) -> None:
    """Compute Table 1, and what it says about the paper's findings."""
    from agility_ref.evaluate import EvaluationConfig, check_evaluation
    from agility_ref.files import remove_partials
    from agility_ref.results import findings, table1, table_output
    from agility_ref.training.bank import WeightsConfig, existing
    from agility_ref.training.lock import locked
    from agility_ref.training.policies import find_policy

    @dataclass(frozen=True)
    class Table1:
        """Evaluate every policy on every terrain and print the table beside the paper's.

        Cells are stored as they are played: an interrupted table goes on where it was.
        """

        # Seed 1: the recipe was chosen on the courses of seed 0.
        config: Annotated[EvaluationConfig, tyro.conf.arg(name="")] = field(
            default_factory=lambda: EvaluationConfig(seed=1)
        )
        seeds: tuple[str, ...] = ("0",)
        """Training seeds of the weights: 0, or 0 1 2, or all for every seed that has weights."""
        train: bool = False
        """Train every policy first, from scratch; finished runs in --runs are kept."""
        findings: bool = False
        """Also check each finding of the paper; writes findings.md."""
        compare: tuple[str, ...] = ()
        """Two policies or more: waypoint fraction of the first minus that of each other one, on paired episodes."""
        ablations: str = ""
        """Ablations for the findings, where measured; benchmarks/results/ablations-<preset>.csv by default."""
        runs: str = ""
        """Folder of runs to look in before the shipped weights, and to train into; runs/<preset> by default."""
        results: str = "results"
        """Folder for table1.csv, .md, .tex and .png, and for the cells behind them."""

    args = tyro.cli(Table1, args=argv, prog="agility-ref table1")
    seeds, config, results = table1.parse_seeds(args.seeds), args.config, Path(args.results)
    if args.train and seeds is None:
        raise UserError("--train needs the numbers of the seeds: all are those that have weights already")
    if (args.findings or args.compare) and config.protocol != "complete":
        raise UserError(f"findings compare episode by episode: --protocol complete, not {config.protocol}")
    if len(args.compare) == 1:
        raise UserError(f"--compare needs two policies or more, not {args.compare[0]} alone")
    for name in args.compare:
        find_policy(name)
    if args.ablations and not Path(args.ablations).is_file():
        raise UserError(f"no file of ablations at {args.ablations}")
    training = WeightsConfig(preset=config.preset, out=args.runs if args.train else existing(args.runs))
    check_evaluation(config)
    for seed in seeds if args.train else ():
        table1.train_all(replace(training, seed=seed))

    def on_play(policy: str, environment: str, seed: int) -> None:
        line = f"evaluating {policy} on {environment}, training seed {seed}"
        print(f"\r{line:70}", end="", file=sys.stderr, flush=True)

    clear = f"\r{'':70}\r"
    try:
        with locked(results):
            remove_partials(results / "cells")
            cells, missing = table1.compute(config, training, results / "cells", seeds, on_play)
            print(clear, end="", file=sys.stderr)
            if not cells:
                raise UserError(f"not one cell to fill, {results} is left as it is: {missing[0]}")
            rows = table1.table_rows(cells)
            # Files first: a terminal may fail.
            paths = table_output.write_all(rows, results, table_output.title(config, rows))
    except KeyboardInterrupt:
        print(clear, end="", file=sys.stderr)
        raise KeyboardInterrupt(f"interrupted; the same command goes on from {results / 'cells'}") from None
    print(table_output.text(rows))
    for line in missing:
        print(f"missing: {line}")
    filled = [sum(row.ours is not None for row in rows if (row.paper is None) == extra) for extra in (False, True)]
    extra = sum(row.paper is None for row in rows)
    print(
        f"{filled[0]} of {len(rows) - extra} cells filled, and {filled[1]} of {extra} beyond the paper; "
        f"mean ± std over episodes; wrote {', '.join(map(str, paths))}"
    )
    for comparison in findings.compare(cells, args.compare):
        print(f"{comparison.text:40} {comparison!s:24} {comparison.seeds} seeds")
    if args.findings:
        ablations = args.ablations or f"benchmarks/results/ablations-{config.preset}.csv"
        checked = findings.check(cells, training, Path(ablations))
        path = findings.write(checked, results, table_output.title(config, rows))
        print(f"\n{findings.text(checked)}\n\nwrote {path}")


def list_names(argv: list[str]) -> None:
    """Print what there is."""
    from agility_ref.curriculum import PRESETS
    from agility_ref.training.policies import ALIASES, ENVIRONMENTS, POLICIES
    from agility_ref.training.weights import shipped_seeds

    @dataclass(frozen=True)
    class List:
        """Print the policies with their courses, budgets and shipped weights, the environments and the presets."""

    tyro.cli(List, args=argv, prog="agility-ref list")

    print(f"environments: {' '.join(ENVIRONMENTS)}\npresets: {' '.join(PRESETS)}\n")
    print(f"{'policy':16}{'trains on':58}{'quick':>8}{'full':>8}  weights shipped (preset: seeds)")
    for spec in POLICIES.values():
        shipped = [
            f"{preset}: {' '.join(map(str, seeds))}"
            for preset in PRESETS
            if (seeds := shipped_seeds(preset, spec.name))
        ]
        budgets = "".join(f"{b / 1e6:7.1f}M" if b else f"{'-':>8}" for b in spec.budget)
        print(f"{spec.name:16}{' '.join(spec.courses) or '-':58}{budgets}  {', '.join(shipped) or '-'}")
    print("\n" + ", ".join(f"{alias} is {name}" for alias, name in ALIASES.items()))


COMMANDS = {
    "train": train, "evaluate": evaluate, "table1": table1, "diagnose": diagnose, "plot": plot,
    "video": video, "watch": watch, "list": list_names,
}  # fmt: skip


RENDERING = ("video",)  # the commands that draw with OpenGL


def prepare_streams() -> None:
    """Make sure that a line to print never ends a command: to a closed stream, or of characters it does not know."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by whoever started us; taking its number keeps it from the files that we open
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8", errors="replace"))
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace" if stream.encoding.lower().startswith("utf") else "replace")


@contextmanager
def no_graphics(needed: bool) -> Iterator[None]:
    """Keep MuJoCo, which reads MUJOCO_GL when it is imported, from loading a graphics library unless it is ``needed``.

    The backend of matplotlib is fixed likewise: our figures need no window, and a notebook's is not installed here.
    """
    ours = {"MPLBACKEND": "agg"} | ({} if needed else {"MUJOCO_GL": "disable"})
    before = {name: os.environ.get(name) for name in ours}
    os.environ.update(ours)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def main(argv: list[str] | None = None) -> int:
    """Run one command; return the exit status."""
    prepare_streams()
    argv = sys.argv[1:] if argv is None else argv
    if not argv or argv[0] in ("-h", "--help"):
        print(USAGE)
        return 0 if argv else 2
    try:
        if argv[0] not in COMMANDS:
            raise unknown_name("command", argv[0], COMMANDS)
        with no_graphics(needed=argv[0] in RENDERING):
            COMMANDS[argv[0]](argv[1:])
        sys.stdout.flush()
    except UserError as error:
        print(f"agility-ref: {one_line(error)}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # the reader of our output, `head` for one, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        if error.filename is None and error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO):
            raise
        where = f"{error.filename}: " if error.filename else ""
        print(f"agility-ref: {where}{error.strerror}", file=sys.stderr)  # cannot be read or written, or a full disk
        return 2
    except KeyboardInterrupt as stopped:
        print(f"agility-ref: {str(stopped) or 'interrupted'}", file=sys.stderr)
        return 130
    return 0

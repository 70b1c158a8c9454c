"""``agility-ref export`` and ``export-mjcf``: policies and courses for programs that do not have this package."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from agility_ref.cli.commands import Environment, File, Folder, Policy, Preset
from agility_ref.errors import UserError

import tyro


@dataclass(frozen=True)
class Export:
    """Write a policy as ONNX, TorchScript or plain arrays, its normaliser and its bounds included.

    For example:
        agility-ref export climb --out climb.onnx
        agility-ref export leap --format npz
    """

    policy: tyro.conf.Positional[Policy]
    """A name of `agility-ref list`, or the .npz file of a run.  Of a selector, the network that chooses."""
    format: Annotated[str, tyro.conf.arg(metavar="FORMAT")] = "onnx"  # onnx, npz or torchscript.
    out: File = ""  # The file; by default <policy>.onnx, <policy>.npz or <policy>.pt.
    preset: Preset = "full"  # quick (d up to 0.4, small budgets) or full (d up to 1).
    train_seed: int = 0  # Training seed of the weights.
    runs: Folder = ""  # Folder of runs to look in before the shipped weights; runs/<preset> by default.


def export(args: Export) -> None:
    """Export one policy."""
    from agility_ref.errors import one_line, unknown_name
    from agility_ref.policy import Policy as NumpyPolicy
    from agility_ref.training.bank import WeightsConfig, existing, weights_path
    from agility_ref.training.export import FORMS, SUFFIXES, export_policy
    from agility_ref.training.policies import find_policy

    if args.format not in FORMS:
        raise unknown_name("format", args.format, FORMS)
    path = Path(args.policy)
    if path.suffix != ".npz":
        spec = find_policy(args.policy)
        if spec.method == "oracle":
            raise UserError(f"oracle has no network of its own; export its skills: {' '.join(spec.skills)}")
        config = WeightsConfig(preset=args.preset, seed=args.train_seed, out=existing(args.runs))
        path = weights_path(args.policy, config)
    policy = NumpyPolicy.load(path)
    name = one_line(Path(policy.name).name)  # in this folder, whatever a file calls itself
    out = Path(args.out or f"{name}{SUFFIXES[args.format]}")
    if out.resolve() == path.resolve():
        raise UserError(f"{out} is the policy itself: give another --out")
    difference = export_policy(policy, out, args.format)
    print(f"wrote {out}: {name} from {path}, actions within {difference:.1g} of the numpy policy's")


@dataclass(frozen=True)
class ExportMJCF:
    """Write the robot on a course as one MJCF file, which MuJoCo's own viewer opens.

    For example:
        agility-ref export-mjcf --environment climb
        agility-ref export-mjcf --environment gap --difficulty 0.8 --out gap.xml
    """

    environment: Environment = "climb"  # climb-gap, gap, beam, climb, walk, climb-up or climb-down.
    difficulty: float = 0.5  # d; 0 to 1, down to -0.2 on steps and to -1 on beams.
    seed: int = 0  # Of the course.
    out: File = ""  # The file; <environment>.xml by default.


def export_mjcf(args: ExportMJCF) -> None:
    """Export one course with the robot on it."""
    from agility_ref.errors import MAX_SEED, require_at_least, unknown_name
    from agility_ref.pictures.mjcf import write_mjcf
    from agility_ref.terrain import COURSE_KINDS, EASIEST, make_course

    if args.environment not in COURSE_KINDS:
        raise unknown_name("environment", args.environment, COURSE_KINDS)
    require_at_least(0, MAX_SEED, seed=args.seed)
    low = EASIEST[args.environment]
    if not low <= args.difficulty <= 1.0:
        raise UserError(f"difficulty of {args.environment} is from {low:g} to 1, not {args.difficulty}")
    out = Path(args.out or f"{args.environment}.xml")
    write_mjcf(make_course(args.environment, args.difficulty, args.seed), out)
    print(f"wrote {out}; python -m mujoco.viewer --mjcf={out} opens it")

"""The command ``diagnose``: a selector's choices against the oracle's, as numbers and figures.

In:  the rest of the command line.  Out: a report, or one JSON object, and three figures.
"""

import json
import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from agility_ref.errors import UserError
from agility_ref.training.policies import ENVIRONMENTS, POLICIES, find_policy

import tyro


def diagnose(argv: list[str]) -> None:
    """Diagnose one selector."""
    from agility_ref.evaluate import EvaluationConfig, evaluation_world
    from agility_ref.training.bank import WeightsConfig, existing

    @dataclass(frozen=True)
    class Diagnose:
        """Compare a selector's choices with the oracle's: accuracy, flicker, collapse, regret, odd behaviours."""

        policy: tyro.conf.Positional[str]
        """oracle, ps-sl-5, ps-rl-3-env or ps-rl-3-oracle."""
        environment: tuple[str, ...] = ENVIRONMENTS
        """One or more of climb-gap, gap, beam, climb; or training courses: walk, climb-up, climb-down."""
        config: Annotated[EvaluationConfig, tyro.conf.arg(name="")] = field(default_factory=EvaluationConfig)
        train_seed: int = 0
        """Training seed of the weights."""
        runs: str = ""
        """Folder of runs to look in before the shipped weights; runs/<preset> by default."""
        results: str = "results"
        """Folder for the figures, as PNG and SVG."""
        json: bool = False
        """Print one JSON object."""

    args = tyro.cli(Diagnose, args=argv, prog="agility-ref diagnose")
    spec = find_policy(args.policy)
    if not spec.skills:
        choices = ", ".join(name for name, other in POLICIES.items() if other.skills)
        raise UserError(f"{args.policy} chooses between no skills; diagnose one of {choices}")
    if not args.environment:
        raise UserError(f"--environment needs at least one of {', '.join(ENVIRONMENTS)}")
    if args.config.protocol != "complete":
        raise UserError(f"diagnose plays complete episodes; --protocol {args.config.protocol} has none to compare")
    for environment in args.environment:
        evaluation_world(environment, args.config)  # named before the weights are looked for
    training = WeightsConfig(preset=args.config.preset, seed=args.train_seed, out=existing(args.runs))
    Path(args.results).mkdir(parents=True, exist_ok=True)  # before the simulation, in case it cannot be made
    traces, reports = _play(spec.name, args.environment, args.config, training)

    paths = _draw(traces, Path(args.results), shlex.join(["agility-ref", "diagnose", *argv]))
    if args.json:
        settings = {"preset": args.config.preset, "seed": args.config.seed, "train_seed": args.train_seed}
        print(json.dumps({"policy": spec.name, **settings, "environments": reports, "figures": [*map(str, paths)]}))
        return
    for report in reports:
        print(text(report))
    print(f"wrote {', '.join(map(str, paths))}")


def _play(name: str, environments: tuple[str, ...], config, training) -> tuple[list, list[dict]]:
    """Play the policy and the oracles on every environment; return traces and reports."""
    from agility_ref.evaluate import evaluation_env
    from agility_ref.pictures.record import Trace, play_trace
    from agility_ref.results.diagnosis import measure
    from agility_ref.selector import Hierarchy, oracle_hierarchy
    from agility_ref.training.bank import load_policy

    policy, oracle = load_policy(name, training), load_policy("oracle", training)
    same = oracle_hierarchy("oracle over the same skills", {skill.name: skill for skill in policy.skills})

    def trace_of(hierarchy: Hierarchy, environment: str) -> Trace:
        # Robots anew for each policy, as an evaluation has them: the same to the last bit.
        return play_trace(hierarchy, evaluation_env(environment, config), environment, config.seed)

    traces, reports = [], []
    for environment in environments:
        best = trace_of(oracle, environment)
        trace = best if name == "oracle" else trace_of(policy, environment)
        restricted = best if trace.skills == best.skills else trace_of(same, environment)
        traces.append(trace)
        reports.append(measure(trace, best, restricted))
    return traces, reports


def _draw(traces: list, folder: Path, command: str) -> list[Path]:
    """Write the three figures; return their paths."""
    from agility_ref.pictures.plots import save_figure
    from agility_ref.results.diagnosis import confusion_figure, mistakes_figure, timeline_figure

    figures = {"confusion": confusion_figure, "timeline": timeline_figure, "mistakes": mistakes_figure}
    names = {kind: folder / f"diagnose-{traces[0].policy}-{kind}.png" for kind in figures}
    return [path for kind, draw in figures.items() for path in save_figure(draw(traces), names[kind], command)]


def text(report: dict) -> str:
    """Return one environment's report for a terminal."""
    skills, most = report["skills"], report["commonest"]
    lines = [
        f"{report['policy']} on {report['environment']}: "
        f"{report['episodes']} episodes, {report['environment_steps']} steps"
    ]
    for key, label in (
        ("accuracy", "accuracy"),
        ("switches_per_second", "switches [1/s]"),
        ("wanted_switches_per_second", "  the oracle's"),
        ("waypoint_fraction", "waypoint fraction"),
        ("regret", "regret"),
        ("regret_same_skills", "  same skills"),
    ):
        lines.append("  {:20} {mean:7.3f}  [{low:.3f}, {high:.3f}]".format(label, **report[key]))
    lines.append(
        f"  {'commonest skill':20} {most['share']:7.3f}  {most['skill']}; the oracle's share {most['wanted_share']:.3f}"
    )
    width = max(map(len, skills)) + 1
    lines.append(f"  {'wanted: chosen [%]':20}" + "".join(f"{name:>{width}}" for name in skills))
    for name, row in zip(skills, report["confusion"], strict=True):
        shares = [f"{100 * count / sum(row):.1f}" if sum(row) else "-" for count in row]
        lines.append(f"  {name:20}" + "".join(f"{share:>{width}}" for share in shares))
    for name, found in report["odd_behaviours"].items():
        said = "{events} in {episodes} episodes; {chances} chances".format(**found) if found else "lacks the skill"
        lines.append(f"  {name.replace('_', ' '):20} {said}")
    return "\n".join(lines) + "\n"

"""How long a policy needs to learn its skill, from scratch, its warm start included.

    python benchmarks/time_to_skill.py leap [--preset quick] [--seeds 0 1 2] [--json]

Trains what ``agility-ref train leap`` trains, ``walk`` first and on the same clock.  Every
so many steps the clock stops and the deterministic policy plays its own courses, noise and
pushes on.  Printed are the steps and the wall time of the first evaluation at each
threshold; the curves go into ``time-to-<policy>-<preset>.csv``, ``.png`` and ``.svg``.
"""

from dataclasses import asdict, dataclass
from pathlib import Path

from agility_ref.curriculum import hardest
from agility_ref.errors import UserError
from agility_ref.files import write_csv
from agility_ref.pictures.plots import BLUE, GREY, save_figure, style
from agility_ref.training.policies import find_policy
from agility_ref.training.runs import TrainConfig

import numpy as np
import tyro
from common import machine, report, start
from learning import (
    CURVE_COLUMNS,
    Trained,
    check_skill,
    curve_grid,
    draw_curves,
    learn_from_scratch,
    own_courses,
    tell,
)


@dataclass(frozen=True)
class Config:
    """Steps and time until a skill."""

    policy: tyro.conf.Positional[str] = "walk"
    """A specialist or a generalist, see `agility-ref list`."""
    preset: str = "full"
    """quick (d up to 0.4, small budgets) or full (d up to 1)."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Training seeds, one after the other."""
    thresholds: tuple[float, ...] = (0.5, 0.8, 0.9, 0.95)
    """Waypoint fractions of the deterministic policy, 0 to 1; training ends at the highest."""
    every: int = 250_000
    """Environment steps between evaluations."""
    steps: int = 0
    """Environment steps after which a seed gives up, warm start included; 0 for the policy's budget."""
    episodes: int = 64
    """Complete episodes of an evaluation, on each of the policy's courses."""
    out: str = "benchmarks/results"
    """Folder for the curves; empty for none."""
    json: bool = False
    """Print one JSON object."""


def crossings(curve: list[dict], thresholds: tuple[float, ...]) -> list[dict | None]:
    """Return the first point at or above each threshold; None where there is none."""
    return [next((p for p in curve if p["waypoint_fraction"] >= goal), None) for goal in thresholds]


def describe(seed: int, trained: Trained, thresholds: tuple[float, ...]) -> dict:
    """Return what is printed of one seed, JSON-ready."""
    reached = crossings(trained.curve, thresholds)
    return {
        "seed": seed,
        "reached": {
            f"{goal:g}": point and {key: point[key] for key in ("steps", "seconds")}
            for goal, point in zip(thresholds, reached, strict=True)
        },
        "steps": trained.steps,
        "seconds": trained.seconds,
        "waypoint_fraction": trained.curve[-1]["waypoint_fraction"],
        "best": max(point["waypoint_fraction"] for point in trained.curve),
        "curve": trained.curve,
    }


def medians(runs: list[dict]) -> dict[str, dict | None]:
    """Return the median over seeds of steps and seconds to each threshold; None unless all reached it."""
    return {
        goal: {key: float(np.median([run["reached"][goal][key] for run in runs])) for key in ("steps", "seconds")}
        if all(run["reached"][goal] for run in runs)
        else None
        for goal in runs[0]["reached"]
    }


def cell(point: dict | None) -> str:
    """Return steps and time of a crossing as text."""
    return f"{point['steps'] / 1e6:.2f} M, {point['seconds']:.0f} s" if point else "-"


def draw(config: Config, runs: list[dict]):
    """Waypoint fraction over steps and over wall time; return the figure."""
    figure, axes = curve_grid(1, 2, (10.0, 4.2))
    with style():
        for axis, x, unit in ((axes[0, 0], "steps", 1e-6), (axes[0, 1], "seconds", 1 / 60)):
            draw_curves(axis, config.policy, [run["curve"] for run in runs], BLUE, x, unit)
            for goal in config.thresholds:
                axis.axhline(goal, color=GREY, linestyle="--", linewidth=1)
            axis.set_xlim(left=0)
        axes[0, 1].set_xlabel("wall time [min]")
        axes[0, 0].set_title(f"{config.policy}, preset {config.preset}, {len(runs)} seeds", loc="left")
        return figure


def write(config: Config, runs: list[dict], command: str) -> None:
    """Write the curves as CSV, PNG and SVG."""
    out = Path(config.out) / f"time-to-{config.policy}-{config.preset}"
    out.parent.mkdir(parents=True, exist_ok=True)
    keys = {"policy": config.policy, "preset": config.preset}
    rows = [
        {**keys, "seed": run["seed"], **{column: point[column] for column in CURVE_COLUMNS}}
        for run in runs
        for point in run["curve"]
    ]
    write_csv(out.with_suffix(".csv"), rows)
    save_figure(draw(config, runs), out.with_suffix(".png"), command)


def main(config: Config) -> None:
    check_skill(config.policy)
    hardest(config.preset)  # refuses an unknown one
    if not config.thresholds or not config.seeds or config.every < 1:
        raise UserError("give at least one seed, one threshold and one step between evaluations")
    started = machine()
    total = config.steps or find_policy(config.policy).steps(config.preset)
    judge = own_courses(config.policy, config.preset, config.episodes)
    runs = []
    for seed in config.seeds:
        training = TrainConfig(preset=config.preset, seed=seed)
        trained = learn_from_scratch(config.policy, training, total, judge, config.every, max(config.thresholds))
        runs.append(describe(seed, trained, config.thresholds))
        if config.out:  # after every seed: the next one may be interrupted
            write(config, runs, f"python benchmarks/time_to_skill.py {config.policy} --preset {config.preset}")
    tell()
    rows = [
        {
            "seed": run["seed"],
            **{goal: cell(point) for goal, point in run["reached"].items()},
            "best": f"{run['best']:.2f}",
            "steps": f"{run['steps'] / 1e6:.2f} M",
            "steps/s": f"{run['steps'] / run['seconds']:.0f}",
        }
        for run in runs
    ]
    middle = medians(runs)
    rows.append({"seed": "median", **{g: cell(p) for g, p in middle.items()}, "best": "", "steps": "", "steps/s": ""})
    report(config.json, started, {"config": asdict(config), "runs": runs, "median": middle}, rows)


if __name__ == "__main__":
    start(main, Config)

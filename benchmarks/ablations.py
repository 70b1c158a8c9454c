"""What each part of the training recipe is worth: one change at a time, the same budget.

    python benchmarks/ablations.py [--only baseline no-curriculum] [--policies leap] [--seeds 0 1 2]

Every ablation trains its own warm start under the same change, plays its own task (a policy
that learned with other commands is asked for those) and ends at the same number of
environment steps, warm start included.  An environment step is one action, whatever it is
held for.  Runs go into ``<runs>/<preset>-<steps>M/<ablation>/<policy>/seed<k>``; a finished
one is not trained again, an interrupted one starts anew.  Then everything that is finished
is collected into ``<out>/ablations-<preset>.csv``, ``.png`` and ``.svg`` and printed.
"""

from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path

from agility_ref.curriculum import hardest
from agility_ref.env import ACTION_DIM
from agility_ref.errors import UserError, unknown_name
from agility_ref.files import read_csv, read_npz, write_csv, write_npz, write_text
from agility_ref.observation import OBS_DIM
from agility_ref.pictures.plots import BLUE, new_figure, save_figure, style
from agility_ref.stats import t_interval
from agility_ref.training.bank import changed_flags, run_folder
from agility_ref.training.policies import find_policy, requirements
from agility_ref.training.progress import versions
from agility_ref.training.runs import TrainConfig

import numpy as np
from common import machine, report, start
from learning import (
    CURVE_COLUMNS,
    Trained,
    check_skill,
    evaluation_task,
    learn,
    own_courses,
    tell,
)

COLUMNS = ("ablation", "policy", "seed", "steps", "waypoint_fraction", "falls", "level")


@dataclass(frozen=True)
class Ablation:
    """One change of the recipe."""

    name: str
    group: str
    """Part of the figure that shows it."""
    train: dict = field(default_factory=dict)
    """Fields of TrainConfig that change, and those of the configs inside it:"""
    env: dict = field(default_factory=dict)
    ppo: dict = field(default_factory=dict)
    curriculum: dict = field(default_factory=dict)

    def apply(self, config: TrainConfig) -> TrainConfig:
        """Return the recipe with this change."""
        inside = {part: replace(getattr(config, part), **getattr(self, part)) for part in ("env", "ppo", "curriculum")}
        return replace(config, **inside, **self.train)


BASELINE = Ablation("baseline", "")
ABLATIONS = (
    BASELINE,
    Ablation("from-scratch", "training", train={"warm_start": False}),
    Ablation("no-curriculum", "training", curriculum={"enabled": False}),
    Ablation("command-0.3-0.8", "task and reward", env={"command_low": 0.3, "command_high": 0.8}),  # the original's
    Ablation("command-1.0-1.5", "task and reward", env={"command_low": 1.0, "command_high": 1.5}),
    # The joints' reach stays +-1.2 rad.
    Ablation("action-scale-0.2", "action", env={"action_scale": 0.2, "action_limit": 6.0}),
    Ablation("action-scale-0.5", "action", env={"action_scale": 0.5, "action_limit": 2.4}),
    # No "action stacking", as in the paper.  The discount is that of the same time, and the ground is seen 25 times per
    # second as in the baseline.
    Ablation(
        "action-repeat-1",
        "action",
        train={"walk_gamma": 0.98**0.5},
        env={"action_repeat": 1, "scandot_period": 2},
        ppo={"gamma": 0.99**0.5},
    ),
)


@dataclass(frozen=True)
class Config:
    """Ablations of the training recipe."""

    only: tuple[str, ...] = tuple(a.name for a in ABLATIONS)
    """Ablations to train."""
    policies: tuple[str, ...] = ("leap", "climb")
    """Policies to train."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Training seeds."""
    preset: str = "full"
    """quick (d up to 0.4) or full (d up to 1)."""
    steps: int = 6_000_000
    """Environment steps of every run, warm start included."""
    warm_steps: int = 0
    """... of which its warm start has these; 0 for its own budget."""
    every: int = 500_000
    """Environment steps between evaluations."""
    episodes: int = 64
    """Complete episodes of an evaluation."""
    runs: str = "runs/ablations"
    """Folder of the runs."""
    out: str = "benchmarks/results"
    """Folder for ablations-<preset>.csv and its figure; give a trial another one."""
    collect: bool = False
    """Train nothing: only collect what is finished."""
    json: bool = False
    """Print one JSON object."""

    @property
    def root(self) -> Path:
        """Folder of the runs of this preset and budget."""
        warm = f"-warm{self.warm_steps / 1e6:g}M" if self.warm_steps else ""
        return Path(self.runs) / f"{self.preset}-{self.steps / 1e6:g}M{warm}"


# ---------------------------------------------------------------------------- one run


def save(folder: Path, name: str, recipe: TrainConfig, trained: Trained) -> None:
    """Write a finished run, DONE last; `agility-ref watch --runs` plays it."""
    meta = {
        "policy": name, "preset": recipe.preset, "seed": recipe.seed, "steps": trained.steps,
        "courses": find_policy(name).courses, "act_dim": ACTION_DIM, "obs_dim": OBS_DIM,
        "versions": versions(), "wall_seconds": trained.seconds, "config": asdict(recipe),
    }  # fmt: skip
    write_npz(folder / "policy.npz", trained.arrays, meta)
    if trained.curve:
        write_csv(folder / "curve.csv", trained.curve)
    write_text(folder / "DONE", f"{trained.steps} steps\n")


def load(folder: Path, recipe: TrainConfig) -> Trained | None:
    """Read a run; None if it is not finished.

    Raises
    ------
    UserError : it was trained by another recipe, for the package has changed since
    """
    if not (folder / "DONE").exists():
        return None
    arrays, meta = read_npz(folder / "policy.npz")
    if changed_flags(meta["config"], recipe):
        raise UserError(f"{folder} was trained by another recipe: move it away, or choose another --runs")
    curve = []
    if (folder / "curve.csv").exists():  # a warm start is not evaluated
        rows = read_csv(folder / "curve.csv", CURVE_COLUMNS)
        curve = [{key: float(row[key]) if row[key] else None for key in CURVE_COLUMNS} for row in rows]
        curve = [{**point, "steps": int(point["steps"])} for point in curve]
    return Trained(arrays, meta["steps"], meta["wall_seconds"], curve)


def recipe_of(ablation: Ablation, seed: int, config: Config) -> TrainConfig:
    """Return how an ablation trains."""
    return ablation.apply(TrainConfig(preset=config.preset, seed=seed))


def warm_start(ablation: Ablation, name: str, seed: int, config: Config) -> Trained | None:
    """Return what a policy starts from under an ablation, training it if it is not there."""
    recipe, start = recipe_of(ablation, seed, config), None
    for other in requirements(name) if recipe.warm_start else ():
        folder = run_folder(config.root / ablation.name / "warm-start", other, seed)
        done = load(folder, recipe)
        if done is None:
            tell(f"{ablation.name}: {other}, seed {seed}, warm start")
            done = learn(other, recipe, config.warm_steps or find_policy(other).steps(config.preset), start=start)
            save(folder, other, recipe, done)
        start = done
    return start


def run(ablation: Ablation, name: str, seed: int, config: Config) -> None:
    """Train and evaluate one policy under one ablation, unless that is done."""
    recipe, folder = recipe_of(ablation, seed, config), run_folder(config.root / ablation.name, name, seed)
    if load(folder, recipe) is None:
        judge = own_courses(name, config.preset, config.episodes, evaluation_task(recipe.env))
        before = warm_start(ablation, name, seed, config)
        tell(f"{ablation.name}: {name}, seed {seed}")
        save(folder, name, recipe, learn(name, recipe, config.steps, judge, config.every, start=before))


# ---------------------------------------------------------------------------- all of them


def collect(config: Config) -> dict[str, dict[str, dict[int, list[dict]]]]:
    """Return policy -> ablation -> seed -> curve of every finished run."""
    found: dict[str, dict[str, dict[int, list[dict]]]] = {}
    for name in config.policies:
        for ablation in ABLATIONS:
            finished = (config.root / ablation.name / name).glob("seed*/DONE")
            for seed in sorted(int(mark.parent.name.removeprefix("seed")) for mark in finished):
                done = load(run_folder(config.root / ablation.name, name, seed), recipe_of(ablation, seed, config))
                found.setdefault(name, {}).setdefault(ablation.name, {})[seed] = done.curve
    return found


def csv_rows(found: dict) -> list[dict]:
    """Return one row per evaluation, with COLUMNS."""
    return [
        {"ablation": ablation, "policy": policy, "seed": seed, **{column: point[column] for column in COLUMNS[3:]}}
        for policy, ablations in found.items()
        for ablation, seeds in ablations.items()
        for seed, curve in seeds.items()
        for point in curve
    ]


def summary_rows(found: dict) -> list[dict]:
    """Return one row per policy and ablation: the last evaluation, and what the change made of it."""
    rows = []
    for policy, ablations in found.items():
        last = {name: {s: c[-1] for s, c in seeds.items()} for name, seeds in ablations.items()}
        for name, points in last.items():
            scores = [p["waypoint_fraction"] for p in points.values()]
            common = sorted(set(points) & set(last.get(BASELINE.name, {})))
            gains = [points[s]["waypoint_fraction"] - last[BASELINE.name][s]["waypoint_fraction"] for s in common]
            levels = [p["level"] for p in points.values() if p["level"] is not None]
            rows.append(
                {
                    "policy": policy,
                    "ablation": name,
                    "seeds": len(points),
                    "steps": f"{max(p['steps'] for p in points.values()) / 1e6:.2f} M",
                    "waypoints": spread(scores),
                    "minus baseline": spread(gains, "+.2f") if common and name != BASELINE.name else "",
                    "falls": f"{np.mean([p['falls'] for p in points.values()]):.2f}",
                    "level": f"{np.mean(levels):.2f}" if levels else "-",
                }
            )
    return rows


def spread(values: list[float], digits: str = ".2f") -> str:
    """Return the mean as text and, of several values, the lowest and the highest."""
    text = format(np.mean(values), digits)
    return text if len(values) == 1 else f"{text} ({min(values):{digits}} to {max(values):{digits}})"


def draw(found: dict):
    """One panel per policy, one line per ablation, at the end of training; return the figure.

    A small dot is a training seed, the large one their mean, the bar its 95 % interval (Student's, from three
    seeds on); groups of ablations stand apart, and the dashed line is the baseline's mean.
    """
    shown = [a for a in ABLATIONS if any(a.name in ablations for ablations in found.values())]
    gaps = np.cumsum([0, *(0.6 * (a.group != b.group) for a, b in pairwise(shown))])
    with style():
        figure, axes = new_figure(1, len(found), (5.4 * len(found), 1.6 + 0.36 * len(shown)))
        for axis, (policy, ablations) in zip(axes[0], found.items(), strict=True):
            for y, ablation in zip(-np.arange(len(shown)) - gaps, shown, strict=True):
                last = np.array([curve[-1]["waypoint_fraction"] for curve in ablations.get(ablation.name, {}).values()])
                if not len(last):
                    continue
                colour = "black" if ablation is BASELINE else BLUE
                if len(last) >= 3:
                    axis.hlines(y, *t_interval(last), color=colour, linewidth=1.5)
                axis.plot(last, np.full(len(last), y), ".", color=colour, markersize=6, alpha=0.6)
                axis.plot(last.mean(), y, "o", color=colour, markersize=8)
                if ablation is BASELINE:
                    axis.axvline(last.mean(), color=colour, linestyle="--", linewidth=1)
            axis.set(xlim=(0, 1.02), xlabel="waypoint fraction at the end of training")
            axis.set_yticks(-np.arange(len(shown)) - gaps, [a.name for a in shown] if axis is axes[0, 0] else [])
            axis.set_title(policy, loc="left")
        return figure


def main(config: Config) -> None:
    for name in config.policies:
        check_skill(name)
    hardest(config.preset)  # refuses an unknown one
    known = {a.name: a for a in ABLATIONS}
    for name in config.only:
        if name not in known:
            raise unknown_name("ablation", name, known)
    warm_starts = {find_policy(name).warm_start for name in config.policies} - {None}
    spent = max([config.warm_steps or find_policy(name).steps(config.preset) for name in warm_starts], default=0)
    if config.steps <= spent and not config.collect:
        raise UserError(f"{config.steps} steps leave nothing to train after {spent} of the warm start")
    started = machine()
    # Seeds outermost: stopped half-way, there are some of everything and not all of something.
    for seed in () if config.collect else config.seeds:
        for name in config.only:
            for policy in config.policies:
                run(known[name], policy, seed, config)
    tell()
    found = collect(config)
    if not found:
        raise UserError(f"no finished run in {config.root}")
    out = Path(config.out) / f"ablations-{config.preset}.csv"
    out.parent.mkdir(parents=True, exist_ok=True)
    write_csv(out, csv_rows(found))
    command = f"python benchmarks/ablations.py --preset {config.preset} --steps {config.steps}"
    save_figure(draw(found), out.with_suffix(".png"), command)
    rows = summary_rows(found)
    report(config.json, started, {"config": asdict(config), "summary": rows, "evaluations": csv_rows(found)}, rows)


if __name__ == "__main__":
    start(main, Config)

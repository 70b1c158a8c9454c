"""How well every trained policy does what it was trained for: the table of docs/training.md.

    python benchmarks/skills_table.py [--preset quick] [--policies leap gen-5] [--json]

Each specialist and generalist, with every training seed that has weights (own runs or
shipped), plays its own courses, noise and pushes on: once with d ~ U(0, max), then at fixed
difficulties.  A mean over seeds stands with its worst seed in brackets.  A generalist is
compared with the specialist of each of its courses, seed by seed and episode by episode.
"""

import sys
from dataclasses import asdict, dataclass
from pathlib import Path

from agility_ref.curriculum import hardest
from agility_ref.env import EnvConfig
from agility_ref.errors import UserError
from agility_ref.evaluate import Evaluation, EvaluationConfig, evaluate, evaluation_world
from agility_ref.files import write_csv
from agility_ref.policy import Policy
from agility_ref.results.table1 import seeds_with_weights
from agility_ref.selector import Single
from agility_ref.stats import paired_difference
from agility_ref.training.bank import load_skill, weights_path
from agility_ref.training.policies import POLICIES, find_policy
from agility_ref.training.runs import TrainConfig

import numpy as np
from common import machine, report, start
from learning import tell

SKILLS = tuple(name for name, spec in POLICIES.items() if spec.method == "ppo")
SPECIALISTS = {POLICIES[name].courses[0]: name for name in SKILLS if len(POLICIES[name].courses) == 1}
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the preset's hardest difficulty

Key = tuple[str, int, str, float | None]
"""Policy, training seed, course, difficulty; None for d ~ U(0, max)."""


@dataclass(frozen=True)
class Config:
    """Skills on their own courses."""

    policies: tuple[str, ...] = SKILLS
    """Specialists and generalists."""
    preset: str = "full"
    """quick (d up to 0.4) or full (d up to 1); also names the weights."""
    runs: str = ""
    """Folder of runs to look in before the shipped weights; runs/<preset> by default."""
    episodes: int = 256
    """Complete episodes of each policy, seed, course and difficulty; usual 64 to 256."""
    seed: int = 0
    """Seed of courses, starts, commands, noise and pushes."""
    csv: str = ""
    """File for one row per policy, seed, course and difficulty; empty for none."""
    json: bool = False
    """Print one JSON object."""


def load(config: Config) -> dict[tuple[str, int], Policy]:
    """Load every policy with every seed that it has weights for.

    Raises
    ------
    UserError : unknown preset, unreadable weights, or none at all
    """
    hardest(config.preset)  # refuses an unknown one
    found, missing = {}, None
    for name in config.policies:
        for seed in seeds_with_weights(name, TrainConfig(preset=config.preset, out=config.runs)):
            try:
                path = weights_path(name, TrainConfig(preset=config.preset, seed=seed, out=config.runs))
            except UserError as error:  # the table has the policies that are there
                missing = error
                print(f"missing: {error}", file=sys.stderr)
            else:
                found[name, seed] = load_skill(path, EnvConfig())
    if missing and not found:
        raise missing
    return found


def play(policies: dict[tuple[str, int], Policy], config: Config) -> dict[Key, Evaluation]:
    """Play everything; courses outermost, for their maps are built once and then shared."""
    top = hardest(config.preset)
    courses = dict.fromkeys(course for name, _ in policies for course in find_policy(name).courses)
    played = {}
    for course in courses:
        for difficulty in (None, *(share * top for share in SHARES)):
            evaluation = EvaluationConfig(config.episodes, config.seed, config.preset, difficulty)
            for (name, seed), policy in policies.items():
                if course in find_policy(name).courses:
                    tell(f"{name}, seed {seed}, on {course}, d = {'any' if difficulty is None else difficulty}")
                    played[name, seed, course, difficulty] = evaluate(Single(name, policy), course, evaluation)
            evaluation_world.cache_clear()  # 256 courses are 0.4 GB of maps
    tell()
    return {key: played[key] for key in sorted(played, key=lambda key: config.policies.index(key[0]))}


def csv_rows(played: dict[Key, Evaluation], policies: dict[tuple[str, int], Policy]) -> list[dict]:
    """Return one row per policy, seed, course and difficulty, JSON-ready."""
    return [
        {
            "policy": name,
            "seed": seed,
            "course": course,
            "difficulty": "uniform" if difficulty is None else difficulty,
            "episodes": len(e.fell),
            "waypoint_fraction": float(e.waypoint_fraction.mean()),
            "falls": float(e.fell.mean()),
            "edge_violation": float(e.edge_violation.mean()),
            "steps": policies[name, seed].meta["steps"],
            "wall_seconds": policies[name, seed].meta.get("wall_seconds"),
        }
        for (name, seed, course, difficulty), e in played.items()
    ]


# ---------------------------------------------------------------------------- tables


def seeds_of(name: str, rows: list[dict]) -> list[int]:
    """Training seeds of a policy."""
    return sorted({row["seed"] for row in rows if row["policy"] == name})


def over_courses(rows: list[dict], metric: str) -> list[float]:
    """Mean over courses of a metric, one number a seed."""
    return [
        float(np.mean([row[metric] for row in rows if row["seed"] == s])) for s in sorted({r["seed"] for r in rows})
    ]


def mean_worst(values: list[float], worst) -> str:
    """Return a mean over seeds as text and, of several, the worst."""
    return f"{np.mean(values):.2f}" + (f" ({worst(values):.2f})" if len(values) > 1 else "")


def budget_text(policy_rows: list[dict]) -> dict[str, str]:
    """Return steps and minutes of training, median over seeds, as text."""
    seeds = {row["seed"]: row for row in policy_rows}.values()
    minutes = [row["wall_seconds"] / 60 for row in seeds if row["wall_seconds"] is not None]
    return {
        "steps": f"{np.median([row['steps'] for row in seeds]) / 1e6:.1f} M",
        "own training": f"{np.median(minutes):.1f} min" if minutes else "-",
    }


def skills_rows(rows: list[dict]) -> list[dict]:
    """One row per policy: d ~ U(0, max), the mean over its courses."""
    table = []
    for name in dict.fromkeys(row["policy"] for row in rows):
        own = [row for row in rows if row["policy"] == name and row["difficulty"] == "uniform"]
        table.append(
            {
                "policy": name,
                "courses": ", ".join(dict.fromkeys(row["course"] for row in own)),
                "seeds": len(seeds_of(name, own)),
                **budget_text(own),
                "waypoints": mean_worst(over_courses(own, "waypoint_fraction"), min),
                "falls": mean_worst(over_courses(own, "falls"), max),
                "feet on edges": mean_worst(over_courses(own, "edge_violation"), max),
            }
        )
    return table


def difficulty_rows(rows: list[dict]) -> list[dict]:
    """One row per policy and course: the waypoint fraction at fixed difficulties."""
    table = []
    for name, course in dict.fromkeys((row["policy"], row["course"]) for row in rows):
        own = [row for row in rows if (row["policy"], row["course"]) == (name, course)]
        fixed = sorted({row["difficulty"] for row in own} - {"uniform"})
        cells = {
            f"d = {d:g}": mean_worst([row["waypoint_fraction"] for row in own if row["difficulty"] == d], min)
            for d in fixed
        }
        table.append({"waypoints of": f"{name} on {course}", **cells})
    return table


def generalist_figures(played: dict[Key, Evaluation]) -> list[dict]:
    """Compare every generalist with the specialist of each of its courses, JSON-ready."""
    names = {(name, seed) for name, seed, _, _ in played}
    figures = []
    courses = dict.fromkeys((n, c) for n, _, c, _ in played if len(find_policy(n).courses) > 1 and c in SPECIALISTS)
    for name, course in courses:
        specialist = SPECIALISTS[course]
        seeds = sorted(seed for n, seed in names if n == name and (specialist, seed) in names)
        if seeds:
            ours, theirs = (
                np.stack([played[who, seed, course, None].waypoint_fraction for seed in seeds])
                for who in (name, specialist)
            )
            figures.append(
                {
                    "generalist": name,
                    "course": course,
                    "specialist": specialist,
                    "seeds": seeds,
                    "generalist_waypoints": float(ours.mean()),
                    "specialist_waypoints": float(theirs.mean()),
                    "difference": paired_difference(ours, theirs),
                }
            )
    return figures


def generalist_rows(figures: list[dict]) -> list[dict]:
    """Return :func:`generalist_figures` as rows of text, with the mean over the courses of each generalist."""
    rows = []
    for name in dict.fromkeys(f["generalist"] for f in figures):
        own = [f for f in figures if f["generalist"] == name]
        rows += [
            {
                "generalist": name,
                "course": f["course"],
                "waypoints": f"{f['generalist_waypoints']:.2f}",
                "specialist": f"{f['specialist']} {f['specialist_waypoints']:.2f}",
                "difference": "{:+.2f} [{:+.2f}, {:+.2f}]".format(*f["difference"]),
                "seeds": len(f["seeds"]),
            }
            for f in own
        ]
        mean = {key: np.mean([f[f"{key}_waypoints"] for f in own]) for key in ("generalist", "specialist")}
        rows.append(
            {
                "generalist": name,
                "course": "mean",
                "waypoints": f"{mean['generalist']:.2f}",
                "specialist": f"{mean['specialist']:.2f}",
                "difference": f"{mean['generalist'] - mean['specialist']:+.2f}",
                "seeds": min(len(f["seeds"]) for f in own),
            }
        )
    return rows


def main(config: Config) -> None:
    for name in config.policies:
        if find_policy(name).method != "ppo":
            raise UserError(f"{name} is no specialist or generalist; give one of {', '.join(SKILLS)}")
    started = machine()
    policies = load(config)
    played = play(policies, config)
    rows, generalists = csv_rows(played, policies), generalist_figures(played)
    if config.csv:
        Path(config.csv).parent.mkdir(parents=True, exist_ok=True)
        write_csv(Path(config.csv), rows)
    tables = [skills_rows(rows), difficulty_rows(rows), generalist_rows(generalists)]
    figures = {"config": asdict(config), "rows": rows, "generalists": generalists}
    report(config.json, started, figures, *(table for table in tables if table))


if __name__ == "__main__":
    start(main, Config)

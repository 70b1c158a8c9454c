"""What a table costs: measured training times laid out on a number of cores.   python workflow/costs.py

With ``--steps-per-second 2500`` a training takes its own steps, without those of its warm start, at that speed.
Otherwise every training takes one core for the median of the wall times that the manifest of the shipped weights records
for its policy (each had one core at most).  Every cell takes CELL minutes.  A job starts as
soon as a core is free and everything it needs is there; the longest remaining chain goes first.
"""

import argparse
import heapq
import statistics
from collections.abc import Sequence

from agility_ref.curriculum import PRESETS
from agility_ref.results.table1 import table_lines
from agility_ref.training.policies import POLICIES, find_policy, requirements
from agility_ref.training.weights import manifest

CELL = 0.1  # [min] of one core, 64 episodes
LEFT_OUT = ("oracle", "post-gen")  # nothing to train; not in workflow/config.yaml


def training_minutes(preset: str, speed: float = 0.0) -> dict[str, float]:
    """Time [min] of every policy's own training: at ``speed`` steps per second, or the median of the seeds that ship."""
    if speed:
        start = {name: find_policy(s.warm_start).steps(preset) if s.warm_start else 0 for name, s in POLICIES.items()}
        # minutes = (budget - budget of the warm start) / (60 s * steps per second)
        own = {name: (s.steps(preset) - start[name]) / (60 * speed) for name, s in POLICIES.items()}
        return {name: minutes for name, minutes in own.items() if name not in LEFT_OUT}
    minutes: dict[str, list[float]] = {}
    for entry in manifest().values():
        if entry["preset"] == preset and entry["policy"] not in LEFT_OUT:
            minutes.setdefault(entry["policy"], []).append(entry["wall_seconds"] / 60)
    return {policy: statistics.median(values) for policy, values in minutes.items()}


def jobs_of(preset: str, seeds: int, speed: float = 0.0) -> dict[tuple, tuple[float, tuple]]:
    """Return every job of a table: its name -> its minutes and the names of the jobs it waits for."""
    minutes = training_minutes(preset, speed)
    played = {(find_policy(name).name, environment) for environment, name in table_lines()}
    jobs = {}
    for seed in range(seeds):
        for policy, duration in minutes.items():
            jobs[policy, seed] = duration, tuple((need, seed) for need in requirements(policy))
        for policy, environment in played:
            needs = tuple((p, seed) for p in (*requirements(policy), policy) if p in minutes)
            if policy in minutes or policy == "oracle":
                jobs[policy, environment, seed] = CELL, needs
    return jobs


def schedule(jobs: dict[tuple, tuple[float, tuple]], cores: int) -> float:
    """Return the minutes until the last job ends, on this many cores."""
    chain: dict[tuple, float] = {}  # of a job: the longest way from its start to the end
    followers: dict[tuple, list[tuple]] = {name: [] for name in jobs}
    for name, (_, needs) in jobs.items():
        for need in needs:
            followers[need].append(name)

    def longest(name: tuple) -> float:
        if name not in chain:
            chain[name] = jobs[name][0] + max(map(longest, followers[name]), default=0.0)
        return chain[name]

    waiting = {name: len(needs) for name, (_, needs) in jobs.items()}
    ready = [(-longest(name), str(name), name) for name, count in waiting.items() if count == 0]
    heapq.heapify(ready)
    running: list[tuple[float, str, tuple]] = []
    now = 0.0
    while ready or running:
        while ready and len(running) < cores:
            _, _, name = heapq.heappop(ready)
            heapq.heappush(running, (now + jobs[name][0], str(name), name))
        now, _, name = heapq.heappop(running)
        for follower in followers[name]:
            waiting[follower] -= 1
            if waiting[follower] == 0:
                heapq.heappush(ready, (-longest(follower), str(follower), follower))
    return now


def duration(minutes: float) -> str:
    """Return minutes as hours and minutes.

    >>> duration(95.2)
    '1 h 35 min'
    """
    hours, rest = divmod(round(minutes), 60)
    return f"{hours} h {rest:02d} min" if hours else f"{rest} min"


def cost_table(
    preset: str = "full", seeds: Sequence[int] = (3, 10), cores: Sequence[int] = (2, 32, 512), speed: float = 0.0
) -> str:
    """Return what a table costs, as Markdown: one line per number of seeds, one column per number of cores."""
    lines = ["| seeds | jobs | core hours | " + " | ".join(f"{n} cores" for n in cores) + " |"]
    lines.append("|---" * (3 + len(cores)) + "|")
    for count in seeds:
        jobs = jobs_of(preset, count, speed)
        hours = sum(minutes for minutes, _ in jobs.values()) / 60
        spans = " | ".join(duration(schedule(jobs, n)) for n in cores)
        lines.append(f"| {count} | {len(jobs)} | {hours:.1f} | {spans} |")
    return "\n".join(lines) + "\n"


def minutes_table(preset: str = "full", speed: float = 0.0) -> str:
    """Return the training times behind it, as Markdown."""
    minutes = sorted(training_minutes(preset, speed).items(), key=lambda item: item[1])
    cells = [[policy, "---", f"{value:.1f}"] for policy, value in minutes]
    return "".join("| " + " | ".join(line) + " |\n" for line in zip(*cells, strict=True))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", default="full", choices=tuple(PRESETS))
    parser.add_argument("--seeds", type=int, nargs="+", default=(3, 10), help="how many training seeds")
    parser.add_argument("--cores", type=int, nargs="+", default=(2, 32, 512))
    parser.add_argument("--steps-per-second", type=float, default=0.0, help="of one training on one core")
    args = parser.parse_args()
    print(cost_table(args.preset, args.seeds, args.cores, args.steps_per_second))
    print(minutes_table(args.preset, args.steps_per_second), end="")

"""Progress: what a run shows and writes while it trains, and how it is stopped.

In:  the record of each iteration of :func:`agility_ref.ppo.train`.
Out: a progress bar, ``progress.csv`` and its reader, and a polite end on Ctrl-C.  Files are
written under a temporary name and renamed, so that a reader never meets half of one;
progress.csv alone grows in place, a row an iteration.
"""

import csv
import os
import platform
import signal
import sys
from collections import deque
from importlib import metadata
from pathlib import Path

import numpy as np

from agility_ref.errors import UserError
from agility_ref.terrain import NUM_WAYPOINTS

PROGRESS = (
    "steps", "wall_seconds", "steps_per_second", "reward", "episode_length", "waypoint_fraction",
    "edge_violation", "level", "std", "learning_rate", "kl", "clip_fraction", "policy_loss", "value_loss", "entropy",
)  # fmt: skip


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    partial = path.with_suffix(".partial")
    partial.write_text(text, encoding="utf-8")
    os.replace(partial, path)


def write_csv(path: Path, rows: list[dict]) -> None:
    """Write rows that share their keys, whole or not at all."""
    partial = path.with_suffix(".partial")
    with open(partial, "w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    os.replace(partial, path)


def read_rows(path: Path) -> list[dict[str, str]]:
    """Read a progress.csv; a last row that was cut short, and so has no end of line, is left out.

    Raises
    ------
    UserError : a row has more or fewer cells than the header
    """
    text = path.read_text()
    rows = list(csv.DictReader(text[: text.rfind("\n") + 1].splitlines()))
    if any(None in row or None in row.values() for row in rows):
        raise UserError(f"{path} is damaged: rows of different lengths")
    return rows


def read_progress(path: Path) -> dict[str, np.ndarray]:
    """Read a progress.csv into one array a column.

    Raises
    ------
    UserError : not a table of numbers
    """
    rows = read_rows(path)
    try:
        return {key: np.array([float(row[key]) for row in rows]) for key in rows[0]} if rows else {}
    except ValueError as error:
        raise UserError(f"{path} is damaged: {error}") from None


def processor() -> str:
    """Name the processor: its model where the system tells it, else its architecture."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or platform.machine()


def versions() -> dict[str, str]:
    """Return the versions and the machine that a policy file records."""
    import mujoco

    return {
        "python": platform.python_version(),
        "numpy": np.__version__,
        "torch": metadata.version("torch"),
        "mujoco": mujoco.__version__,
        "machine": f"{processor()}, {os.cpu_count()} cores",
    }


class ProgressLog:
    """The progress bar and progress.csv of one run; averages over the last 200 episodes.

    ``done`` of its ``total`` steps are spent when it begins; ``rows`` are those of before.
    """

    def __init__(self, name: str, folder: Path, rows: list[dict], done: int, total: int, quiet: bool):
        from tqdm import tqdm

        self.path, self.rows, self.episodes = folder / "progress.csv", rows, deque(maxlen=200)
        if rows:  # a run that goes on has the averages of before until 200 more episodes have ended
            self.episodes.extend([self._average_episode(rows[-1])] * 200)
        self.written = 0
        self.bar = tqdm(
            total=total,
            initial=done,
            desc=name,
            unit="step",
            unit_scale=True,
            disable=quiet,
            mininterval=0.5 if sys.stderr.isatty() else 30.0,
        )

    def add(self, record: dict, wall_seconds: float, level: float, levels: dict[str, float]) -> None:
        """Take in one iteration; ``levels`` are further columns, in the same order every time."""
        self.episodes.extend(record["episodes"])
        episodes = list(self.episodes)

        def mean(key: str) -> float:
            return float(np.mean([e[key] for e in episodes])) if episodes else 0.0

        length = max(mean("length"), 1.0)
        figures = record | {
            "wall_seconds": wall_seconds, "reward": mean("reward"), "episode_length": mean("length"),
            "waypoint_fraction": mean("waypoints") / NUM_WAYPOINTS, "edge_violation": mean("edge") / length, "level": level,
        }  # fmt: skip
        row = {key: f"{figures[key]:.6g}" if key != "steps" else figures[key] for key in PROGRESS}
        self.rows.append(row | {key: f"{value:.6g}" for key, value in levels.items()})
        self.bar.set_postfix_str(
            f"return {figures['reward']:.1f}, waypoints {figures['waypoint_fraction']:.2f}, level {level:.2f}",
            refresh=False,
        )
        self.bar.update(record["steps"] - self.bar.n)

    @staticmethod
    def _average_episode(row: dict) -> dict[str, float]:
        """Return an episode that is as the averages of a row."""
        length = float(row["episode_length"])
        return {
            "reward": float(row["reward"]),
            "length": length,
            "waypoints": float(row["waypoint_fraction"]) * NUM_WAYPOINTS,
            "edge": float(row["edge_violation"]) * length,
        }

    def write(self) -> None:
        """Bring progress.csv up to date: the first call writes it anew, later ones add their rows."""
        if not self.written and self.rows:
            write_csv(self.path, self.rows)
        elif self.written < len(self.rows):
            lines = [",".join(map(str, row.values())) + "\r\n" for row in self.rows[self.written :]]
            with open(self.path, "a", newline="") as file:
                file.write("".join(lines))
        self.written = len(self.rows)

    def close(self) -> None:
        """Finish the progress bar."""
        self.bar.close()


class StopRequest:
    """Turns Ctrl-C and termination into a stop after the current iteration."""

    def __init__(self):
        self.asked = False

    def requested(self) -> bool:
        """Whether somebody asked for an end."""
        return self.asked

    def _ask(self, signum, frame) -> None:
        self.asked = True

    def __enter__(self):
        try:
            self._previous = {s: signal.signal(s, self._ask) for s in (signal.SIGINT, signal.SIGTERM)}
        except ValueError:  # not in the main thread: nobody can press Ctrl-C here
            self._previous = {}
        return self

    def __exit__(self, *exc) -> None:
        for signum, handler in self._previous.items():
            signal.signal(signum, handler)

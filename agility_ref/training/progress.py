"""Progress: what a run shows and writes while it trains, and how it is stopped.

In:  the record of each iteration of :func:`agility_ref.ppo.train`.
Out: a progress bar, ``progress.csv`` and its reader, and a polite end on Ctrl-C.  progress.csv
grows in place, one row per iteration; all other files are replaced as a whole.
"""

import os
import platform
import signal
import sys
from collections import deque
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

from agility_ref.errors import UserError
from agility_ref.files import not_finite, read_csv, write_csv
from agility_ref.terrain import NUM_WAYPOINTS

import numpy as np

PROGRESS = (
    "steps", "wall_seconds", "steps_per_second", "reward", "episode_length", "waypoint_fraction",
    "edge_violation", "level", "std", "learning_rate", "kl", "clip_fraction", "policy_loss", "value_loss", "entropy",
)  # fmt: skip
EPISODE = ("reward", "length", "waypoints", "edge")  # what is kept of an episode


def read_progress(path: Path) -> dict[str, np.ndarray]:
    """Read a progress.csv into one array per column; empty where it has no rows.

    Raises
    ------
    UserError : not a table of finite numbers
    """
    rows = read_csv(path)
    try:
        columns = {key: np.array([float(row[key]) for row in rows]) for key in rows[0]} if rows else {}
    except ValueError as error:
        raise UserError(f"{path} is damaged: {error}") from None
    if bad := not_finite(columns):
        raise UserError(f"{path} is damaged: {bad} has numbers that are not finite")
    return columns


def rows_until(path: Path, begin: int, end: int, batch: int, levels: tuple[str, ...]) -> list[dict[str, str]]:
    """Read the rows of a run's progress.csv that belong to its checkpoint.

    A run that was killed between the two has a row more, which is repeated.

    Parameters
    ----------
    path : of progress.csv
    begin, end : environment steps at which the run began and of its checkpoint
    batch : steps of an iteration
    levels : columns beyond PROGRESS

    Raises
    ------
    UserError : a row is damaged, missing or there twice
    """
    if end == begin:
        return []  # stopped before its first iteration
    advice = f"put it back as it was, or delete {path.parent} to start anew"
    if not path.is_file():
        raise UserError(f"{path} is missing: {advice}")
    try:
        progress = read_progress(path)
    except UserError as error:
        raise UserError(f"{error}; {advice}") from None
    if list(progress) != [*PROGRESS, *levels]:
        raise UserError(f"{path} is damaged: it has other columns, or no rows; {advice}")
    count = int(np.count_nonzero(progress["steps"] <= end))
    if not np.array_equal(progress["steps"][:count], np.arange(begin + batch, end + 1, batch)):
        raise UserError(f"{path} is damaged: its rows are not those of {end} steps; {advice}")
    return read_csv(path)[:count]


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

    ``done`` of its ``total`` steps are spent when it begins; ``rows`` are those of before, and
    ``episodes`` (n, 4) the last that were played, as :meth:`last_episodes` gives them.  A step is
    ``action_repeat`` control steps, which is what ``episode_length`` counts.
    """

    def __init__(
        self, name: str, folder: Path, rows: list[dict], episodes: np.ndarray, done: int, total: int,
        action_repeat: int, quiet: bool,
    ):  # fmt: skip
        from tqdm import tqdm

        self.path, self.rows, self.episodes = folder / "progress.csv", rows, deque(maxlen=200)
        self.episodes.extend(dict(zip(EPISODE, episode.tolist(), strict=True)) for episode in episodes)
        self.written, self.action_repeat = 0, action_repeat
        self.bar = tqdm(
            total=total,
            initial=done,
            desc=name,
            unit="step",
            unit_scale=True,
            disable=True if quiet or sys.stderr is None else None,  # None: where it is no terminal
            mininterval=0.5,
        )

    def add(self, record: dict, wall_seconds: float, level: float, levels: dict[str, float]) -> None:
        """Take in one iteration; ``levels`` are further columns, in the same order every time."""
        self.episodes.extend(record["episodes"])
        episodes = list(self.episodes)

        def mean(key: str) -> float:
            return float(np.mean([e[key] for e in episodes])) if episodes else 0.0

        length = max(mean("length"), 1.0)
        figures = record | {
            "wall_seconds": wall_seconds, "reward": mean("reward"), "episode_length": mean("length") * self.action_repeat,
            "waypoint_fraction": mean("waypoints") / NUM_WAYPOINTS, "edge_violation": mean("edge") / length, "level": level,
        }  # fmt: skip
        row = {key: f"{figures[key]:.6g}" if key != "steps" else figures[key] for key in PROGRESS}
        self.rows.append(row | {key: f"{value:.6g}" for key, value in levels.items()})
        self.bar.set_postfix_str(
            f"return {figures['reward']:.1f}, waypoints {figures['waypoint_fraction']:.2f}, level {level:.2f}",
            refresh=False,
        )
        self.bar.update(record["steps"] - self.bar.n)

    def last_episodes(self) -> np.ndarray:
        """Return the episodes behind the averages, (n, 4), n at most 200, columns as in EPISODE."""
        return np.array([[e[key] for key in EPISODE] for e in self.episodes], float).reshape(-1, len(EPISODE))

    def write(self) -> None:
        """Bring progress.csv up to date: the first call writes it anew, later ones add their rows."""
        if not self.written and self.rows:
            write_csv(self.path, self.rows)
        elif self.written < len(self.rows):
            lines = [",".join(map(str, row.values())) + "\r\n" for row in self.rows[self.written :]]
            with open(self.path, "a", newline="") as file:
                file.write("".join(lines))
        self.written = len(self.rows)

    def __enter__(self):
        return self

    def __exit__(self, *exc) -> None:
        self.bar.close()


def attempt(draw: Callable, *args) -> bool:
    """Draw a picture that decorates other results: one that fails is a warning, and never their end."""
    try:
        draw(*args)
    except Exception as error:  # whatever a drawing library may raise
        print(f"warning: no {args[1]}: {type(error).__name__}: {error}", file=sys.stderr)
        return False
    return True


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

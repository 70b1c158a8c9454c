"""Crash test: a training run, or a table, that is killed again and again, and goes on each time.

    python benchmarks/crash_test.py [--kills 50] [--what train|table1] [--signal KILL|INT|TERM]

After every kill the folder is looked at: at most one iteration is lost, the policy loads, and
progress.csv has no torn, doubled or missing row before the point from which a run goes on.  At
the end the run has its steps, as many rows as iterations, no leftover of a temporary file, and,
as it went on with the same bits each time, the very policy of a run that nobody touched.

In:  nothing but a folder for its runs.  Out: one line per kill, and one at the end.
"""

import argparse
import multiprocessing
import os
import random
import signal
import sys
import tempfile
import time
from pathlib import Path

from agility_ref.cli.main import main
from agility_ref.errors import UserError
from agility_ref.files import PARTIAL, read_npz
from agility_ref.policy import Policy
from agility_ref.training.progress import rows_until

ROBOTS, NUM_STEPS = 16, 4
BATCH = ROBOTS * NUM_STEPS
COURSES = "--preset quick --curriculum.num-levels 2 --curriculum.variants 1".split()
NETWORK = "--ppo.hidden 32 --ppo.update-epochs 1 --ppo.num-minibatches 1".split()  # so that writing takes its share
TRAIN = ["train", "walk", *COURSES, *NETWORK, "--ppo.num-envs", str(ROBOTS), "--ppo.num-steps", str(NUM_STEPS)]
TABLE = "table1 --preset quick --episodes 1 --difficulty 0".split()

# A server that has imported everything starts a command in milliseconds instead of seconds.
os.environ.pop("OMP_NUM_THREADS", None)  # as in most shells: what libraries do with two threads must not change a bit
SERVER = multiprocessing.get_context("forkserver")
SERVER.set_forkserver_preload(["agility_ref.cli.main", "agility_ref.training.runs", "agility_ref.results.table1"])


def run(arguments: list[str], said: str) -> None:
    """Run one command of the package in this process, what it says into the file ``said``; for a process of its own."""
    file = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(file, stream)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.exit(main(arguments))


def start(arguments: list[str], said: Path) -> multiprocessing.Process:
    """Start one command of the package."""
    process = SERVER.Process(target=run, args=(arguments, str(said)))
    process.start()
    return process


def finish(arguments: list[str], said: Path) -> None:
    """Run one command to its end.

    Raises
    ------
    RuntimeError : it failed
    """
    process = start(arguments, said)
    process.join()
    if process.exitcode:
        raise RuntimeError(f"exit status {process.exitcode}: {said.read_text()}")


def look(folder: Path) -> int:
    """Return the steps of the checkpoint in a run's folder, 0 where there is none; fail where it is damaged."""
    saved = folder / "policy.npz"
    if not saved.exists():
        return 0
    steps = read_npz(saved)[1]["steps"]
    Policy.load(saved)
    rows_until(folder / "progress.csv", 0, steps, BATCH, ())
    return steps


def kill_once(arguments: list[str], said: Path, ready, delay: float, how: signal.Signals) -> int:
    """Start a command, wait until ``ready()`` and ``delay`` seconds more, kill it; return its exit status.

    Raises
    ------
    RuntimeError : it said more than one line of its own
    """
    process = start(arguments, said)
    while process.is_alive() and not ready():
        time.sleep(0.001)
    process.join(delay)
    if process.is_alive():
        os.kill(process.pid, how)
    process.join()
    if process.exitcode not in (0, 130, -how) or "Traceback" in said.read_text():
        raise RuntimeError(f"exit status {process.exitcode}: {said.read_text()}")
    return process.exitcode


def crash_training(root: Path, kills: int, how: signal.Signals, iterations: int, seed: int) -> dict[str, int]:
    """Kill a run of training ``kills`` times; return counts.

    Raises
    ------
    RuntimeError : something was lost or damaged
    """
    rng, folder, said = random.Random(seed), root / "crashed" / "walk" / "seed0", root / "said"
    arguments = [*TRAIN, "--steps", str(iterations * BATCH), "--out", str(root / "crashed")]
    log, counts = folder / "progress.csv", {"kills": 0, "before the first iteration": 0, "lost iterations": 0}
    for kill in range(kills):
        before = look(folder)
        size = log.stat().st_size if log.exists() else 0
        # From the start of the process, or once it has written a row of its own: within an iteration or a write.
        early = rng.random() < 0.2
        delay = rng.uniform(0.0, 1.0) if early else rng.uniform(0.0, 0.1)
        status = kill_once(arguments, said, lambda: early or (log.exists() and log.stat().st_size > size), delay, how)  # noqa: B023
        if status == 0:
            break
        rows = log.read_bytes().count(b"\n") - 1 if log.exists() else 0
        after = look(folder)
        lost = max(rows, before // BATCH) * BATCH - after
        if after < before or lost > BATCH:
            raise RuntimeError(f"kill {kill}: the checkpoint has {after} steps, before it had {before}, rows {rows}")
        counts["kills"] += 1
        counts["lost iterations"] += lost // BATCH
        counts["before the first iteration"] += after == before
        print(f"kill {kill + 1}: status {status}, checkpoint {before} -> {after} steps, {rows} rows", flush=True)
    finish(arguments, said)
    whole = [*TRAIN, "--steps", str(iterations * BATCH), "--out", str(root / "whole")]
    finish(whole, said)
    if look(folder) != iterations * BATCH or not (folder / "DONE").exists():
        raise RuntimeError(f"the run ended with {look(folder)} steps")
    if left := [path.name for path in root.rglob("*") if path.name.endswith((PARTIAL, ".lock"))]:
        raise RuntimeError(f"left behind: {left}")
    crashed, untouched = (Policy.load(root / part / "walk" / "seed0" / "policy.npz") for part in ("crashed", "whole"))
    if crashed.digest() != untouched.digest():
        raise RuntimeError("not the policy of the run that nobody killed")
    return counts


def crash_table(root: Path, kills: int, how: signal.Signals, seed: int) -> dict[str, int]:
    """Kill a table ``kills`` times; return counts.

    Raises
    ------
    RuntimeError : a cell is damaged, or the table is another than that which nobody killed
    """
    rng, cells, said, counts = random.Random(seed), root / "crashed" / "cells", root / "said", {"kills": 0}
    arguments = [*TABLE, "--results", str(root / "crashed")]
    for _ in range(kills):
        known = len(list(cells.glob("*.npz")))
        delay = rng.uniform(0.0, 0.5)
        if kill_once(arguments, said, lambda: len(list(cells.glob("*.npz"))) > known, delay, how) == 0:  # noqa: B023
            break
        counts["kills"] += 1
        for cell in cells.glob("*.npz"):
            read_npz(cell)
        print(f"kill {counts['kills']}: {len(list(cells.glob('*.npz')))} cells", flush=True)
    finish(arguments, said)
    finish([*TABLE, "--results", str(root / "whole")], said)
    if left := [path.name for path in root.rglob("*") if path.name.endswith((PARTIAL, ".lock"))]:
        raise RuntimeError(f"left behind: {left}")
    crashed, untouched = ((root / part / "table1.csv").read_text() for part in ("crashed", "whole"))
    if crashed != untouched:
        raise RuntimeError("not the table that nobody killed")
    return counts


def crash() -> None:
    """Run the test that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--what", choices=("train", "table1"), default="train")
    parser.add_argument("--signal", choices=("KILL", "INT", "TERM"), default="KILL")
    parser.add_argument("--iterations", type=int, default=0, help="of the run; 10 a kill by default")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    how = signal.Signals[f"SIG{args.signal}"]
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        try:
            if args.what == "train":
                counts = crash_training(Path(folder), args.kills, how, args.iterations or 10 * args.kills, args.seed)
            else:
                counts = crash_table(Path(folder), args.kills, how, args.seed)
        except (RuntimeError, UserError) as error:
            sys.exit(f"crash_test: {error}")
    said = ", ".join(f"{count} {what}" for what, count in counts.items())
    print(f"{args.what}, SIG{args.signal}: {said}; nothing damaged; {time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    crash()

"""Fuzz the command line: whatever is typed ends with exit status 0, 2 or 130, and never with a traceback.

    python benchmarks/fuzz_commands.py [--lines 2000] [--first 0] [--seed 0]

Command lines are drawn from the dataclasses that ``--help-all`` is made of: any command, any of its
flags, values that are good, odd, absurd or of another type.  All run in this one process, through
the function behind ``agility-ref``, with little to do and little time: what takes more than
``--seconds`` of processor time, or five times as long by the clock, is interrupted as by Ctrl-C.  What counts: the exit status, no traceback, one line to
say what is wrong, nothing written outside the folder of the test, no program started.  Each line
has a random stream of its own: ``--first 517 --lines 1`` tries number 517 alone.

In:  nothing.  Out: how many of each command ended how, and the lines that ended otherwise.
"""

import argparse
import contextlib
import faulthandler
import importlib
import io
import os
import pkgutil
import random
import shlex
import shutil
import signal
import sys
import tempfile
import time
import types
import typing
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path

import agility_ref
from agility_ref.cli.main import COMMANDS, main, options_of
from agility_ref.curriculum import PRESETS
from agility_ref.terrain import COURSE_KINDS
from agility_ref.training.export import FORMS
from agility_ref.training.policies import POLICIES

from fuzz_files import peak_megabytes

WEIGHTS = Path(__file__).parent.parent / "agility_ref" / "weights"
INTS = (
    "0", "1", "2", "3", "5", "-1",
    "64", "2147483648", "9223372036854775807", "9223372036854775808", "-9223372036854775809", "1" + "0" * 30,
)  # fmt: skip
FLOATS = ("0", "1", "0.5", "0.1", "-1", "1e-9", "1e-300", "1e30", "1e308", "1e400", "nan", "inf", "-inf", "3")
TEXTS = (
    "", " ", "x", "-", "--", "-1", "None", "True", "a b", "é", "\x1b[2J",
    "a\nb", "*", "~", "x" * 300, "1_0", "0x10", "١", "{}", "%s", "\udcff",
)  # fmt: skip
FOLDERS = ("new", "made", "file", "none/such", "made/../new2", "loop", "/dev/null", "/proc/nowhere", "x" * 300)
NAMES = {
    "POLICY": (*POLICIES, "gen5", "climb_up", str(WEIGHTS / "walk-quick-seed0.npz")), "ENVIRONMENT": (*COURSE_KINDS, "clim"), "PRESET": (*PRESETS, "fast"),
    "FORMAT": (*FORMS, "keras"), "FOLDER": FOLDERS, "FILE": ("out.png", "out.svg", "out.webp", "out.gif", "out.mp4", "out.html", "out.xml", "out", *FOLDERS),
    "RUN ...": ("made/walk/seed0", str(WEIGHTS / "walk-quick-seed0.npz"), *FOLDERS), "SEED ...": ("0", "all", "7", "00", "-0"),
    "POLICY POLICY ...": (*POLICIES, "gen5"), "ENVIRONMENT ...": (*COURSE_KINDS, "clim"),
}  # fmt: skip
# So that a line that is right has little to do; a drawn flag of the same name takes its place.
SMALL = {
    "train": {
        "preset": "quick", "steps": "64", "ppo.num-envs": "4", "ppo.num-steps": "4", "ppo.hidden": "8", "curriculum.num-levels": "2",
        "curriculum.variants": "1",
    },
    "evaluate": {"episodes": "2"}, "table1": {"episodes": "2"}, "diagnose": {"episodes": "2"},
}  # fmt: skip


# ---------------------------------------------------------------------------- lines


def flags_of(options: type, prefix: str = "") -> Iterator[tuple[str, object, bool]]:
    """Yield the name, the type and whether it has no flag before it, of every value that a command takes."""
    hints = typing.get_type_hints(options, include_extras=True)
    for f in fields(options):
        kind = hints[f.name]
        if "Suppress" in repr(kind):
            continue
        if is_dataclass(kind):
            yield from flags_of(kind, f"{prefix}{f.name}.")
        else:
            yield f"{prefix}{f.name}".replace("_", "-"), kind, "Positional" in repr(kind)


def value(kind: object, rng: random.Random, wild: float) -> list[str]:
    """Draw the words that stand for a value: of its type, or with probability ``wild`` any others."""
    if rng.random() < wild:
        return [rng.choice((*TEXTS, *INTS, *FLOATS, *FOLDERS))]
    metavar = next((m.metavar for m in getattr(kind, "__metadata__", ()) if getattr(m, "metavar", None)), None)
    bare = typing.get_args(kind)[0] if hasattr(kind, "__metadata__") else kind
    if isinstance(bare, types.UnionType):
        bare = rng.choice(typing.get_args(bare))
    several = typing.get_origin(bare) is tuple
    inner = typing.get_args(bare)[0] if several else bare
    choices = NAMES.get(metavar) or {int: INTS, float: FLOATS, bool: ("True", "False"), types.NoneType: ("None",)}.get(
        inner, TEXTS
    )
    # The first choices of a list are the ordinary ones.
    ordinary = choices[: max(3, len(choices) // 2)] if rng.random() < 0.7 else choices
    return [rng.choice(ordinary) for _ in range(rng.randrange(4) if several else 1)]


def line(grammar: dict[tuple[str, ...], list], rng: random.Random) -> list[str]:
    """Draw a command line."""
    # A command with many flags is drawn more often.
    command = rng.choices(list(grammar), [5 + len(flags) for flags in grammar.values()])[0]
    known, chosen, words, wild = grammar[command], {}, [*command], rng.choice((0.0, 0.0, 0.02, 0.3))
    positional = [flag for flag in known if flag[2]]
    for flag in rng.sample(known, min(rng.choice((0, 1, 1, 2, 2, 3, 5)), len(known))):
        if not flag[2]:
            chosen[flag[0]] = flag[1]
    # What a command cannot do without, mostly.
    words += [word for _, kind, _ in positional if rng.random() > 0.1 * wild for word in value(kind, rng, wild)]
    if command == ("evaluate",) and rng.random() > wild:
        chosen["environment"] = dict((name, kind) for name, kind, _ in known)["environment"]
    words += [
        word for name, small in SMALL.get(command[0], {}).items() if name not in chosen for word in (f"--{name}", small)
    ]
    for name, kind in chosen.items():
        if kind is bool:
            where, dot, last = name.rpartition(".")
            words.append(f"--{where}{dot}{rng.choice(('', 'no-'))}{last}")
        else:
            words += [f"--{name}", *value(kind, rng, wild)]
    if rng.random() < wild:
        stray = (*TEXTS, "--help", "--help-all", "--version", "-h", "--no-such-flag", *COMMANDS)
        words.insert(rng.randrange(len(words) + 1), rng.choice(stray))
    return words


# ---------------------------------------------------------------------------- one process


class Watched:
    """What this process did that a command must not do, by Python's audit events."""

    def __init__(self, allowed: Path):
        self.allowed, self.seen = str(allowed.resolve()), []
        sys.addaudithook(self.hook)

    def hook(self, event: str, args: tuple) -> None:
        """Note programs that are started, and paths outside the folder that are written."""
        if event in ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn"):
            self.seen.append(f"{event} {args[:2]}")
        elif (
            event == "open"
            and isinstance(args[0], str | bytes)
            and isinstance(args[2], int)
            and args[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        ):
            self.written(event, args[0])
        elif event in ("os.mkdir", "os.remove", "os.rmdir", "os.truncate", "shutil.rmtree"):
            self.written(event, args[0])
        elif event in ("os.rename", "os.link", "os.symlink"):
            self.written(event, args[1])

    def written(self, event: str, path: str | bytes) -> None:
        """Note a path that lies outside."""
        if isinstance(path, int):  # a file that was opened before
            return
        path = os.fsdecode(path)
        if not os.path.realpath(path).startswith((self.allowed, "/dev/", "/proc")):
            self.seen.append(f"{event} {path}")


def scene(folder: Path) -> None:
    """Make what the values of the flags name, and nothing else: a run in ``made``, which is also the default folder."""
    for path in folder.iterdir():
        if path.is_symlink() or not path.is_dir():
            path.unlink()
        elif path.name != ".made":
            shutil.rmtree(path)
    (folder / "file").write_text("no folder")
    (folder / "loop").symlink_to("loop")
    if (folder / ".made").is_dir():
        for name in ("made", "runs/quick"):
            shutil.copytree(folder / ".made", folder / name)


def interrupt(*_) -> None:
    """Press Ctrl-C while a command runs; and where that helps nothing for long, fail."""
    if not interrupt.armed:
        return
    interrupt.pressed += 1
    if interrupt.pressed == 20:
        raise RuntimeError("it cannot be interrupted")
    signal.raise_signal(signal.SIGINT)


def run(words: list[str], seconds: float) -> tuple[int | str, str]:
    """Run one command line; return its exit status, or the exception that escaped, and what it said on standard error."""
    out, said = io.StringIO(), io.StringIO()
    interrupt.pressed, interrupt.armed = 0, True
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(said):
        try:
            signal.setitimer(signal.ITIMER_PROF, seconds, seconds)
            signal.setitimer(signal.ITIMER_REAL, 5 * seconds, seconds)
            status = main(words)
        except BaseException as error:  # what a shell would show as a traceback
            status = f"{type(error).__name__}: {error}"
        finally:
            interrupt.armed = False
    return status, said.getvalue()


def fuzz(
    lines: int,
    seed: int,
    folder: Path,
    first: int = 0,
    seconds: float = 1.0,
    log: Callable[[str], None] = lambda text: None,
) -> tuple[Counter, list[str]]:
    """Run ``lines`` command lines, from number ``first`` on.

    Returns how many of each command ended with which status, and the faults.
    """
    grammar, faults = {}, []
    for name, entry in COMMANDS.items():
        for kind, command in entry.items() if isinstance(entry, dict) else [("", entry)]:
            grammar[(name, kind) if kind else (name,)] = list(flags_of(options_of(command, every=True)))
    # An import that is interrupted stays half done.
    for module in pkgutil.walk_packages(agility_ref.__path__, "agility_ref."):
        if module.name not in ("agility_ref.__main__", "agility_ref.gym"):
            importlib.import_module(module.name)
    here, counts = Path.cwd(), Counter()
    ours = {signal.SIGALRM: interrupt, signal.SIGPROF: interrupt, signal.SIGINT: signal.default_int_handler}
    handlers = {number: signal.signal(number, handler) for number, handler in ours.items()}
    scene(folder)
    os.chdir(folder)
    try:
        interrupt.armed = False
        # What is imported late, here and in torch and matplotlib, is imported now; and a finished run is made.
        small = [word for name, small in SMALL["train"].items() for word in (f"--{name}", small)]
        for words in (
            ["train", "walk", "--out", ".made", *small],
            ["plot", "courses"],
            ["plot", "run", ".made/walk/seed0"],
        ):
            status, said = run(words, 600.0)
            if status != 0:
                raise RuntimeError(f"{words}: {status}; {said}")
        scene(folder)
        watched = Watched(folder)
        for number in range(first, first + lines):
            words = line(grammar, random.Random(f"{seed} {number}"))
            begun = time.monotonic()
            watched.seen.clear()
            for _ in range(3):  # a Ctrl-C that meets C code, or a destructor, is reported by it as it likes
                with contextlib.suppress(KeyboardInterrupt):  # it came as the command ended
                    status, said = run(words, seconds)
                    if not interrupt.pressed or (status in (0, 2, 130) and "Traceback" not in said):
                        break
                interrupt.armed = False
            scene(folder)
            typed = f"line {number}: agility-ref {shlex.join(words)}"
            if status not in (0, 2, 130) or "Traceback" in said or (status == 2 and not said.strip()) or watched.seen:
                faults.append(f"{typed!a}: {status}; {said[-1000:]}; {watched.seen}")
                log(faults[-1])
                continue
            counts[" ".join(words[:1]), status] += 1
            log(f"{status:3} {time.monotonic() - begun:5.1f} s  {ascii(typed)[:200]}")
    finally:
        os.chdir(here)
        for timer in (signal.ITIMER_PROF, signal.ITIMER_REAL):
            signal.setitimer(timer, 0)
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return counts, faults


def fuzz_all() -> None:
    """Run the test that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--lines", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=1.0, help="after which a command is interrupted")
    parser.add_argument("--verbose", action="store_true", help="print every line")
    args = parser.parse_args()
    faulthandler.enable()
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        log = (lambda text: print(text, flush=True)) if args.verbose else (lambda text: None)
        counts, faults = fuzz(args.lines, args.seed, Path(folder), args.first, args.seconds, log)
    for status in sorted({status for _, status in counts}):
        print(
            f"status {status}: "
            + ", ".join(f"{n} {command}" for (command, s), n in sorted(counts.items()) if s == status)
        )
    print(f"{counts.total()} of {args.lines}; peak memory {peak_megabytes():.0f} MB; {time.monotonic() - begun:.0f} s")
    if faults:
        sys.exit("\n".join(["faults:", *faults]))


if __name__ == "__main__":
    fuzz_all()

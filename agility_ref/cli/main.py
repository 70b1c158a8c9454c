"""The command line: ``agility-ref COMMAND``, one plain function and one frozen dataclass per command.

tyro reads the dataclass: a field is a flag, its docstring the help, the class docstring the
description with two examples.  ``--help`` shows the flags that people use first; a command whose
``more`` names a configuration has its other fields as flags too, which ``--help-all`` shows.
That one is imported only then, or to run, so that ``--help`` waits for neither torch nor mujoco.

In:  words typed in a shell.
Out: text, files, exit status 0, 1 (the reader left), 2 (a mistake, in one line) or 130 (Ctrl-C).
"""

import errno
import io
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from inspect import cleandoc
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Union

from agility_ref import __version__
from agility_ref.cli import commands, export, pictures
from agility_ref.errors import UserError, one_line, unknown_name

import tyro

PROGRAM = "agility-ref"
ABOUT = """One generalist policy or a bank of specialists for a simulated Unitree Go1.

`agility-ref COMMAND --help` shows the flags used first and two examples, `--help-all` every flag,
`--version` the version, `--tyro-print-completion bash` (or zsh, tcsh) a script for your shell."""


class Command(NamedTuple):
    """What runs, and what it is told."""

    run: Callable[[Any], None]
    options: type  # Frozen dataclass of the flags used first.
    more: Callable[[], type] | None = None  # Returns a dataclass whose further fields are flags too.


PLOTS = {
    "curves": Command(pictures.plot_curves, pictures.Curves),
    "strobe": Command(pictures.plot_strobe, pictures.Strobe),
    "oracle-map": Command(pictures.plot_oracle_map, pictures.OracleMap),
    "episode": Command(pictures.plot_episode, pictures.Panel),
    "courses": Command(pictures.plot_courses, pictures.Courses),
    "skills": Command(pictures.plot_skills, pictures.Skills),
    "run": Command(pictures.plot_run, pictures.Run),
}
COMMANDS: dict[str, Command | dict[str, Command]] = {
    "watch": Command(pictures.watch, pictures.Watch, lambda: pictures.Page),
    "table1": Command(commands.table1, commands.Table1, commands.evaluation_flags),
    "train": Command(commands.train, commands.Train, commands.train_flags),
    "evaluate": Command(commands.evaluate, commands.Evaluate, commands.evaluation_flags),
    "diagnose": Command(commands.diagnose, commands.Diagnose, commands.evaluation_flags),
    "plot": PLOTS,
    "video": Command(pictures.video, pictures.Video, pictures.video_flags),
    "export": Command(export.export, export.Export),
    "export-mjcf": Command(export.export_mjcf, export.ExportMJCF),
    "list": Command(commands.list_names, commands.List),
}
PLACE = ("__module__", "__qualname__", "__firstlineno__", "__doc__")
GROUPS = {"plot": "Draw a picture as PNG and SVG; KIND is one of those below."}


def options_of(command: Command, every: bool) -> type:
    """Return the dataclass of a command's flags; of ``every`` one, or of those used first."""
    if not every or command.more is None:
        return command.options
    # Under the name, and at the line, of the first: tyro finds the comments behind fields in the source text.
    place = {key: value for key, value in vars(command.options).items() if key in PLACE}
    mixed = type(command.options.__name__, (command.options, command.more()), place)
    return dataclass(frozen=True, kw_only=True)(mixed)


def union(commands_: dict[str, Command | dict[str, Command]], chosen: Command | None, every: bool) -> Any:
    """Return the type that tyro parses: one member per command, described at length if it is chosen."""
    members = []
    for name, entry in commands_.items():
        if isinstance(entry, dict):
            inner = tyro.conf.OmitSubcommandPrefixes[union(entry, chosen, every)]
            options, about = dataclass(type("Group", (), {"__annotations__": {"kind": inner}})), GROUPS[name]
        else:
            options = options_of(entry, every and entry is chosen)
            about = cleandoc(options.__doc__) if entry is chosen else options.__doc__.partition("\n")[0]
        members.append(Annotated[options, tyro.conf.subcommand(name, description=about)])
    return Union[tuple(members)]  # noqa: UP007 - the members are made here


def parse(words: list[str]) -> tuple[Command, Any]:
    """Return the command and its options; prints help, and leaves, where that is asked for.

    Raises
    ------
    UserError : no such command
    """
    found, program, about = COMMANDS, PROGRAM, ABOUT
    if words[:1] == ["plot"]:
        found, program, about, words = PLOTS, f"{PROGRAM} plot", GROUPS["plot"], words[1:]
        if words and words[0] not in PLOTS and not words[0].startswith("-"):
            if not (Path(words[0]) / "progress.csv").is_file():
                raise UserError(f"{words[0]} is no picture ({', '.join(PLOTS)}) and holds no progress.csv")
            words = ["run", *words]  # a run folder needs no kind
    words = words or ["--help"]
    command = found.get(words[0])
    if command is None and not words[0].startswith("-"):
        raise unknown_name("command", words[0], found)
    every = not {"-h", "--help"} & set(words)
    words = ["--help" if word == "--help-all" else word for word in words]
    return command, tyro.cli(union(found, command, every), args=words, prog=program, description=about)


def prepare_streams() -> None:
    """Make sure that a line to print never ends a command: to a closed stream, or of characters it does not know."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by whoever started us; taking its number keeps it from the files that we open
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8", errors="replace"))
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace" if stream.encoding.lower().startswith("utf") else "replace")


@contextmanager
def no_graphics(needed: bool) -> Iterator[None]:
    """Keep MuJoCo, which reads MUJOCO_GL when it is imported, from loading a graphics library unless it is ``needed``.

    The backend of matplotlib is fixed likewise: our figures need no window, and a notebook's is not installed here.
    """
    ours = {"MPLBACKEND": "agg"} | ({} if needed else {"MUJOCO_GL": "disable"})
    before = {name: os.environ.get(name) for name in ours}
    os.environ.update(ours)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def main(argv: list[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    prepare_streams()
    commands.TYPED[:] = argv = sys.argv[1:] if argv is None else argv
    if argv == ["--version"]:
        print(f"{PROGRAM} {__version__}")
        return 0
    try:
        with no_graphics(needed=argv[:1] == ["video"]):  # the one command that draws with OpenGL
            command, options = parse(argv)
            command.run(options)
        sys.stdout.flush()
    except SystemExit as done:  # tyro has printed the help, or what is wrong with a flag
        return (done.code or 0) if argv else 2
    except UserError as error:
        print(f"{PROGRAM}: {one_line(error)}", file=sys.stderr)
        return 2
    except MemoryError as error:
        print(f"{PROGRAM}: not enough memory: {one_line(error)}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # the reader of our output, `head` for one, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        if error.filename is None and error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO):
            raise
        where = f"{error.filename}: " if error.filename else ""
        print(f"{PROGRAM}: {where}{error.strerror}", file=sys.stderr)  # cannot be read or written, or a full disk
        return 2
    except KeyboardInterrupt as stopped:
        print(f"{PROGRAM}: {str(stopped) or 'interrupted'}", file=sys.stderr)
        return 130
    return 0

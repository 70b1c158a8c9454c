"""Files: written whole or not at all, read with suspicion.

A file is written under a temporary name of its own and renamed, so that a reader never meets
half of one and two writers never meet at all.  Whatever is read may be damaged, or made by
somebody else: its size is bounded, and its text, JSON or CSV is checked before anything is
believed.

In:  paths.  Out: contents, or one line that says what is wrong with them.
"""

import csv
import io
import json
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from agility_ref.errors import UserError

import numpy as np

PARTIAL = ".partial"  # the end of every temporary name
MAX_TEXT = 64 * 2**20  # bytes of a text file that is read; the longest of ours, a progress.csv, has a few


@contextmanager
def replacing(path: Path, mode: str = "wb", **options) -> Iterator[IO]:
    """Open a file that takes the place of ``path`` when the block ends, and vanishes when it fails.

    Parameters
    ----------
    path : of the file
    mode, options : as of ``open``
    """
    path = Path(path)
    own = path.with_name(f"{path.name}.{os.getpid()}-{os.urandom(4).hex()}{PARTIAL}")
    try:
        with open(own, mode, **options) as file:
            yield file
        os.replace(own, path)
    except BaseException:
        own.unlink(missing_ok=True)
        raise


def remove_partials(folder: Path) -> None:
    """Delete what killed processes left half written in a folder that nobody else writes into."""
    for left in Path(folder).glob(f"*{PARTIAL}"):
        left.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    with replacing(path, "w", encoding="utf-8") as file:
        file.write(text)


def write_csv(path: Path, rows: list[dict]) -> None:
    """Write rows that share their keys, whole or not at all."""
    with replacing(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def read_text(path: Path) -> str:
    """Read a text file of at most MAX_TEXT bytes.

    Raises
    ------
    UserError : no file, too long, or not UTF-8
    """
    if not Path(path).is_file():
        raise UserError(f"no file at {path}")
    with open(path, "rb") as file:
        content = file.read(MAX_TEXT + 1)
    if len(content) > MAX_TEXT:
        raise UserError(f"{path} is damaged: longer than {MAX_TEXT >> 20} MB")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise UserError(f"{path} is damaged: not UTF-8 text ({error.reason} at byte {error.start})") from None


def parse_json(text: str) -> dict:
    """Parse a JSON object.

    Raises
    ------
    ValueError : not JSON, another kind of value, nested without end, or with a number that is not finite or a
        whole one beyond 2^63
    """

    def refuse(word: str):
        raise ValueError(f"{word} is no number")

    def number(digits: str) -> float:
        return float(digits) if math.isfinite(float(digits)) else refuse(digits)

    def whole(digits: str) -> int:
        return int(digits) if len(digits) < 20 and abs(int(digits)) < 2**63 else refuse(digits[:40])

    try:
        record = json.loads(text, parse_constant=refuse, parse_float=number, parse_int=whole)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    if not isinstance(record, dict):
        raise ValueError(f"a {type(record).__name__} where an object is expected")
    return record


def read_json(path: Path) -> dict:
    """Read a file that holds one JSON object.

    Raises
    ------
    UserError : it holds something else
    """
    try:
        return parse_json(read_text(path))
    except UserError:
        raise
    except ValueError as error:
        raise UserError(f"{path} is damaged: not the JSON that it is to hold ({error})") from None


def read_csv(path: Path, needed: tuple[str, ...] = ()) -> list[dict[str, str]]:
    """Read a table: one dict a row; a last row that was cut short, and so has no end of line, is left out.

    Parameters
    ----------
    path : of the table
    needed : columns that it must have

    Raises
    ------
    UserError : not text, a column is missing or there twice, rows of different lengths
    """
    text = read_text(path)
    text = text[: text.rfind("\n") + 1]
    try:
        table = list(csv.reader(io.StringIO(text, newline=""), strict=True))
    except csv.Error as error:
        raise UserError(f"{path} is damaged: {error}") from None
    if not table:
        return []
    head, *rows = table
    if len(set(head)) < len(head) or not set(needed) <= set(head):
        raise UserError(f"{path} is damaged: its columns are to be {','.join(needed) or 'different'}")
    if any(len(row) != len(head) for row in rows):
        raise UserError(f"{path} is damaged: rows of different lengths")
    return [dict(zip(head, row, strict=True)) for row in rows]


def pack_stream(rng: np.random.Generator) -> np.ndarray:
    """Return where a random stream is, (6,) uint64, for a file that goes on from there."""
    state = rng.bit_generator.state
    words = [half for key in ("state", "inc") for half in divmod(state["state"][key], 2**64)]
    return np.array([*words, state["has_uint32"], state["uinteger"]], np.uint64)


def unpack_stream(rng: np.random.Generator, packed: np.ndarray) -> None:
    """Put a random stream where :func:`pack_stream` found one."""
    high, low, inc_high, inc_low, has_half, half = map(int, packed)
    state = {"state": high << 64 | low, "inc": inc_high << 64 | inc_low}
    rng.bit_generator.state = {
        "bit_generator": "PCG64", "state": state, "has_uint32": has_half & 1, "uinteger": half & (2**32 - 1)
    }  # fmt: skip

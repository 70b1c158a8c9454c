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
import lzma
import math
import os
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from agility_ref.errors import UserError

import numpy as np

PARTIAL = ".partial"  # in every temporary name, before the suffix, which says what is written
MAX_TEXT = 64 * 2**20  # bytes of a text file that is read; the longest of ours, a progress.csv, has a few

SCHEMA = "agility_ref/1"
DTYPES = [np.dtype(name) for name in ("float32", "float64", "int64", "int32", "uint64", "uint8", "bool")]
META_TYPES = {
    "policy": str, "environment": str, "preset": str, "seed": int, "steps": int, "start": int, "obs_dim": int,
    "act_dim": int, "wall_seconds": int | float, "config": dict, "skills": dict, "teachers": dict,
    "courses": list, "versions": dict,
}  # fmt: skip
MAX_BYTES = 256 * 2**20  # of all arrays together, unpacked; a checkpoint of ours has about 3 MB
MAX_ARRAYS = 1000


@contextmanager
def replacing_path(path: Path) -> Iterator[Path]:
    """Yield a name to write to; that file takes the place of ``path`` when the block ends, and vanishes when it fails."""
    path = Path(path)
    own = path.with_name(f"{path.stem}.{os.getpid()}-{os.urandom(4).hex()}{PARTIAL}{path.suffix}")
    try:
        yield own
        os.replace(own, path)
    except BaseException:
        own.unlink(missing_ok=True)
        raise


@contextmanager
def replacing(path: Path, mode: str = "wb", **options) -> Iterator[IO]:
    """Open a file that takes the place of ``path`` as with :func:`replacing_path`; ``mode`` and ``options`` as of ``open``."""
    with replacing_path(path) as own, open(own, mode, **options) as file:
        yield file


def remove_partials(folder: Path) -> None:
    """Delete what killed processes left half written in a folder that nobody else writes into."""
    for left in Path(folder).glob(f"*.*-*{PARTIAL}*"):
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


def write_npz(path: Path, arrays: dict[str, np.ndarray], meta: dict, compress: bool = True) -> None:
    """Write a checkpoint under a temporary name, then rename: never half a file.

    Compression saves a tenth of the size and takes fifteen times as long.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    record = json.dumps({"schema": SCHEMA, **meta}, sort_keys=True)
    content = io.BytesIO()  # a zip goes back and forth, which takes a quarter less time in memory
    (np.savez_compressed if compress else np.savez)(content, __meta__=np.array(record), **arrays)
    with replacing(path) as file:
        file.write(content.getbuffer())


def read_npz(path: Path) -> tuple[dict[str, np.ndarray], dict]:
    """Read a checkpoint or a cell: arrays of finite numbers, and the record of how they were made.

    Nothing is believed before it is checked: the sizes that the file claims before memory is taken,
    the kinds and the finiteness of the numbers, the types of what the record holds.

    Raises
    ------
    UserError : the file is missing, truncated, not ours, or holds what nobody can act or train with
    """
    path = Path(path)
    if not path.is_file():
        raise UserError(f"no checkpoint at {path}")
    try:
        with zipfile.ZipFile(path) as file:
            entries = file.infolist()
            if len(entries) > MAX_ARRAYS or sum(entry.file_size for entry in entries) > MAX_BYTES:
                raise ValueError(f"larger than {MAX_BYTES >> 20} MB, or more than {MAX_ARRAYS} arrays")
            if len({entry.filename for entry in entries}) < len(entries):
                raise ValueError("two arrays of one name")
            arrays = {entry.filename.removesuffix(".npy"): _read_array(file, entry) for entry in entries}
        meta = parse_json(str(arrays.pop("__meta__")))
        schema = meta.pop("schema")
    except (
        ValueError,
        TypeError,
        KeyError,
        OSError,
        EOFError,
        RuntimeError,  # a zip that asks for a password, or for a compression that Python does not know
        tokenize.TokenError,  # numpy's reader of headers
        zipfile.BadZipFile,
        zlib.error,
        lzma.LZMAError,
    ) as error:
        raise UserError(f"{path} is not a readable agility_ref checkpoint ({error})") from None
    if schema != SCHEMA:
        raise UserError(f"{path} has schema {schema!r}, this version reads {SCHEMA!r}")
    for key, kind in META_TYPES.items():
        if key in meta and (not isinstance(meta[key], kind) or isinstance(meta[key], bool)):
            raise UserError(f"{path} is damaged: its record has {key} {str(meta[key])[:40]!r}")
    if bad := not_finite(arrays):
        raise UserError(f"{path} is damaged: {bad} has numbers that are not finite")
    return arrays, {"schema": schema, **meta}


def _read_array(file: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    """Read one array of a zip; its header is compared with the size of its data first.

    Raises
    ------
    ValueError : no array of numbers, or (the record alone) of text
    """
    with file.open(entry) as data:
        version = np.lib.format.read_magic(data)
        header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        if version not in header:
            raise ValueError(f"{entry.filename} has format {version}")
        shape, fortran, dtype = header[version](data, max_header_size=10_000)
        text = entry.filename == "__meta__.npy" and dtype.kind == "U" and shape == ()
        if not text and dtype.newbyteorder("=") not in DTYPES:
            raise ValueError(f"{entry.filename} holds {dtype}")
        size = math.prod(shape) * dtype.itemsize
        if min(shape, default=0) < 0 or size > MAX_BYTES:
            raise ValueError(f"{entry.filename} claims the shape {shape}")
        content = data.read()
    if len(content) != size:
        raise ValueError(f"{entry.filename} holds {len(content)} bytes, its shape {shape} asks for {size}")
    if text and not size:
        raise ValueError("no record")
    array = np.ndarray(shape, dtype, content, order="F" if fortran else "C")
    return array.astype(dtype.newbyteorder("="))  # a copy, which may be written to


def not_finite(arrays: dict[str, np.ndarray]) -> str:
    """Return the name of the first array that holds a NaN or an infinity; "" where all are finite.

    What a policy has ``seen`` may have no limit.
    """
    for name, array in arrays.items():
        good = ~np.isnan(array) if name in ("seen.low", "seen.high") else np.isfinite(array)
        if not good.all():
            return name
    return ""


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

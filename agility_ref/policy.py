"""Policy: the numpy policy, and the one ``.npz`` file that it runs from.

A file holds everything needed to act (weights **and** the observation normaliser) and
everything needed to go on training (optimiser, counters), plus a JSON record of how it
was made.  Nothing in it can execute code: ``np.load(allow_pickle=False)``.

In:  a dict of arrays and a metadata dict.
Out: the same, checked; or a :class:`Policy`, which needs numpy alone.
"""

import hashlib
import json
import lzma
import math
import re
import tokenize
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

from agility_ref.errors import UserError
from agility_ref.files import parse_json, replacing

import numpy as np

SCHEMA = "agility_ref/1"
DTYPES = [np.dtype(name) for name in ("float32", "float64", "int64", "int32", "uint64", "uint8", "bool")]
META_TYPES = {
    "policy": str, "environment": str, "preset": str, "seed": int, "steps": int, "start": int, "obs_dim": int,
    "act_dim": int, "wall_seconds": int | float, "config": dict, "skills": dict, "teachers": dict,
    "courses": list, "versions": dict,
}  # fmt: skip
MAX_BYTES = 256 * 2**20  # of all arrays together, unpacked; a checkpoint of ours has about 3 MB
MAX_ARRAYS = 1000
MAX_WEIGHT = 1e9  # of a network that has not diverged; three layers of larger ones overflow float32
NETWORKS = ("actor.", "net.")
CLIP = 5.0  # observations are clipped to this many standard deviations, in training and acting
VAR_FLOOR = 1e-8  # added to a variance before its root is taken


def write_npz(path: Path, arrays: dict[str, np.ndarray], meta: dict, compress: bool = True) -> None:
    """Write a checkpoint under a temporary name, then rename: never half a file.

    Compression saves a tenth of the size and takes fifteen times as long.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    record = json.dumps({"schema": SCHEMA, **meta}, sort_keys=True)
    with replacing(path) as file:
        (np.savez_compressed if compress else np.savez)(file, __meta__=np.array(record), **arrays)


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


def beyond_use(arrays: dict[str, np.ndarray]) -> str:
    """Return the name of the first array that nobody can act or learn with: not finite, or a weight beyond MAX_WEIGHT."""
    huge = (name for name, a in arrays.items() if name.startswith(NETWORKS) and a.size and np.abs(a).max() > MAX_WEIGHT)
    return not_finite(arrays) or next(huge, "")


def elu(x: np.ndarray) -> np.ndarray:
    """X where positive, exp(x) - 1 elsewhere."""
    return np.maximum(x, 0) + np.expm1(np.minimum(x, 0))


def mlp(x: np.ndarray, layers: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Apply linear layers (weight (out, in), bias (out,)) with ELU between them."""
    for weight, bias in layers[:-1]:
        x = elu(x @ weight.T + bias)
    weight, bias = layers[-1]
    return x @ weight.T + bias


def layers_of(arrays: dict[str, np.ndarray], prefix: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Collect ``<prefix>.<i>.weight`` and ``.bias`` in the order of i.

    Raises
    ------
    UserError : an array under the prefix has another name
    """
    own = [n for n in arrays if n.startswith(f"{prefix}.")]
    for name in own:
        if not re.fullmatch(rf"{prefix}\.\d+\.(weight|bias)", name):
            raise UserError(f"{name} is not a layer of the {prefix}")
    names = [n for n in own if n.endswith(".weight")]
    names.sort(key=lambda n: int(n.split(".")[1]))
    return [(arrays[n], arrays[n.replace(".weight", ".bias")]) for n in names]


@dataclass(frozen=True)
class Policy:
    """An MLP with its observation normaliser, frozen; plain numpy."""

    name: str
    layers: tuple[tuple[np.ndarray, np.ndarray], ...]
    mean: np.ndarray  # (obs_dim,) subtracted from the observation
    std: np.ndarray  # (obs_dim,) divides the difference
    low: (
        np.ndarray
    )  # (obs_dim,) the quotient is clipped to this, -5 or where the checkpoint's ``seen.low`` lies, if that is higher
    high: np.ndarray  # ... and to this, 5 or where ``seen.high`` lies
    meta: dict

    @classmethod
    def from_arrays(cls, arrays: dict[str, np.ndarray], meta: dict, source: str = "checkpoint") -> "Policy":
        """Build a policy, checking names and shapes.

        Raises
        ------
        UserError : arrays are missing, or their shapes do not fit together
        """
        try:
            layers = layers_of(arrays, "actor")
            parts = {name: a for name, a in arrays.items() if name.startswith(("actor.", "normalizer.", "seen."))}
            if any(a.dtype.kind != "f" for a in parts.values()):
                raise UserError(f"{source}: weights are to be float32 or float64")
            if arrays["normalizer.var"].min(initial=0) < 0:
                raise UserError(f"{source}: normalizer.var has numbers below 0")
            if bad := beyond_use(parts):
                raise UserError(f"{source}: {bad} is not finite, or beyond {MAX_WEIGHT:g}")
            ends = [arrays["normalizer.mean"], *(bias for _, bias in layers)]
            if any(end.ndim != 1 for end in ends):
                raise UserError(f"{source}: biases and normalizer.mean have shapes {[end.shape for end in ends]}")
            mean, std = arrays["normalizer.mean"], np.sqrt(arrays["normalizer.var"] + VAR_FLOOR)
            if std.shape != mean.shape:
                raise UserError(f"{source}: normalizer.var has shape {std.shape}, mean {mean.shape}")
            seen = [
                arrays.get(f"seen.{end}", np.full_like(mean, limit))
                for end, limit in (("low", -np.inf), ("high", np.inf))
            ]
            if any(limit.shape != mean.shape for limit in seen):
                raise UserError(
                    f"{source}: seen.low and seen.high have shapes {[a.shape for a in seen]}, mean {mean.shape}"
                )
            low, high = (np.clip((limit - mean) / std, -CLIP, CLIP).astype(np.float32) for limit in seen)
            width = len(mean)
            for weight, bias in layers:
                if weight.shape != (len(bias), width):
                    raise UserError(f"{source}: layer of shape {weight.shape}, expected {(len(bias), width)}")
                width = len(bias)
        except KeyError as error:
            raise UserError(f"{source} lacks the array {error}") from None
        if not layers or width != meta.get("act_dim", width):
            raise UserError(f"{source} holds {len(layers)} actor layers with {width} outputs")
        return cls(meta.get("policy", "?"), tuple(layers), mean, std.astype(np.float32), low, high, meta)

    @classmethod
    def load(cls, path: Path) -> "Policy":
        """Read a policy from a checkpoint; see :func:`read_npz` for what is refused."""
        arrays, meta = read_npz(path)
        return cls.from_arrays(arrays, meta, str(path))

    def digest(self) -> str:
        """Return a short digest of everything that decides its actions."""
        arrays = [self.mean, self.std, self.low, self.high, *(array for layer in self.layers for array in layer)]
        return hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)).hexdigest()[:16]

    @property
    def obs_dim(self) -> int:
        """Length of the observation it takes."""
        return len(self.mean)

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Return the mean action (or logits) for observations (n, obs_dim)."""
        x = np.clip((observation - self.mean) / self.std, self.low, self.high)
        return mlp(x, self.layers)

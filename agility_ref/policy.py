"""Policy: the numpy policy, and the one ``.npz`` file that it runs from.

A file holds everything needed to act (weights **and** the observation normaliser) and
everything needed to go on training (optimiser, counters), plus a JSON record of how it
was made.  Nothing in it can execute code: ``np.load(allow_pickle=False)``.

In:  a dict of arrays and a metadata dict.
Out: the same, checked; or a :class:`Policy`, which needs numpy alone.
"""

import hashlib
import json
import os
import re
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from agility_ref.errors import UserError

SCHEMA = "agility_ref/1"
CLIP = 5.0  # observations are clipped to this many standard deviations, in training and acting
VAR_FLOOR = 1e-8  # added to a variance before its root is taken


def write_npz(path: Path, arrays: dict[str, np.ndarray], meta: dict, compress: bool = True) -> None:
    """Write a checkpoint under a temporary name, then rename: never half a file.

    Compression saves a tenth of the size and takes fifteen times as long.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    record = json.dumps({"schema": SCHEMA, **meta}, sort_keys=True)
    partial = path.with_suffix(".partial")
    with open(partial, "wb") as file:
        (np.savez_compressed if compress else np.savez)(file, __meta__=np.array(record), **arrays)
    os.replace(partial, path)


def read_npz(path: Path) -> tuple[dict[str, np.ndarray], dict]:
    """Read a checkpoint.

    Raises
    ------
    UserError : the file is missing, truncated, or not ours
    """
    path = Path(path)
    if not path.is_file():
        raise UserError(f"no checkpoint at {path}")
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        meta = json.loads(str(arrays.pop("__meta__")))
        schema = meta["schema"]
    except (
        ValueError,
        KeyError,
        TypeError,
        OSError,
        EOFError,
        AttributeError,
        RuntimeError,  # a zip that asks for a password or for an unknown compression
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise UserError(f"{path} is not a readable agility_ref checkpoint ({error})") from None
    if schema != SCHEMA:
        raise UserError(f"{path} has schema {schema!r}, this version reads {SCHEMA!r}")
    return arrays, meta


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

"""Policy: the numpy policy, and the one ``.npz`` file that it runs from.

A file holds everything needed to act (weights **and** the observation normaliser), what it
takes to go on training, and a JSON record of how it was made.  :mod:`agility_ref.files` reads it.

In:  a dict of arrays and a metadata dict.
Out: a :class:`Policy`, which needs numpy alone.
"""

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path

from agility_ref.errors import UserError
from agility_ref.files import not_finite, read_npz

import numpy as np

MAX_WEIGHT = 1e9  # of a network that has not diverged; three layers of larger ones overflow float32
NETWORKS = ("actor.", "net.")
CLIP = 5.0  # observations are clipped to this many standard deviations, in training and acting
VAR_FLOOR = 1e-8  # added to a variance before its root is taken


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
    low: np.ndarray  # (obs_dim,) the quotient is at least this: -5, or ``seen.low`` where that is higher
    high: np.ndarray  # (obs_dim,) ... and at most this: 5, or ``seen.high`` where that is lower
    meta: dict

    @classmethod
    def from_arrays(cls, arrays: dict[str, np.ndarray], meta: dict, source: str = "checkpoint") -> "Policy":
        """Build a policy, checking names and shapes.

        Raises
        ------
        UserError : arrays are missing, or their shapes do not fit together
        """
        try:
            layers, mean, var = layers_of(arrays, "actor"), arrays["normalizer.mean"], arrays["normalizer.var"]
        except KeyError as error:
            raise UserError(f"{source} lacks the array {error}") from None
        acting = {name: a for name, a in arrays.items() if name.startswith(("actor.", "normalizer.", "seen."))}
        if any(a.dtype.kind != "f" for a in acting.values()):
            raise UserError(f"{source}: weights are to be float32 or float64")
        seen = [arrays.get(f"seen.{end}", np.full_like(mean, x)) for end, x in (("low", -np.inf), ("high", np.inf))]
        width = mean.size
        parts = {"mean": mean, "var": var, "seen.low": seen[0], "seen.high": seen[1]}
        fits = [(name, array, (width,)) for name, array in parts.items()]
        for i, (weight, bias) in enumerate(layers):
            fits += [(f"layer {i}", weight, (bias.size, width)), (f"bias {i}", bias, (bias.size,))]
            width = bias.size
        for name, array, shape in fits:
            if array.shape != shape:
                raise UserError(f"{source}: {name} has shape {array.shape}, expected {shape}")
        if bad := beyond_use(acting):
            raise UserError(f"{source}: {bad} is not finite, or beyond {MAX_WEIGHT:g}")
        if var.min(initial=0) < 0:
            raise UserError(f"{source}: normalizer.var has numbers below 0")
        if not layers or width != meta.get("act_dim", width):
            raise UserError(f"{source} holds {len(layers)} actor layers with {width} outputs")
        std = np.sqrt(var + VAR_FLOOR)
        low, high = (np.clip((limit - mean) / std, -CLIP, CLIP).astype(np.float32) for limit in seen)
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

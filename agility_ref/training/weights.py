"""Shipped weights: policies inside the package, each with its digest and training record.

    agility_ref/weights/<policy>-<preset>-seed<k>.npz  and  manifest.json

In:  finished run folders.  Out: files without what only training needs, and a manifest that loading
checks them against.  ``python -m agility_ref.training.weights RUNS...`` adds runs to the package.
"""

import hashlib
import json
import sys
from importlib import resources
from pathlib import Path

from agility_ref.errors import UserError
from agility_ref.files import read_json, read_npz, write_npz, write_text
from agility_ref.training.policies import POLICIES, find_policy
from agility_ref.training.progress import read_progress

import numpy as np

WARM_STARTS = {spec.warm_start for spec in POLICIES.values()}
FOLDER = Path(str(resources.files("agility_ref") / "weights"))
CURVE_POINTS = 60  # points of progress.csv that the manifest keeps ...
CURVE_COLUMNS = ("steps", "wall_seconds", "reward", "waypoint_fraction", "level")  # ... of each, and level_<kind>


def sha256(path: Path) -> str:
    """Return the hex digest of a file, as the weights manifest records it."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def file_name(preset: str, policy: str, seed: int) -> str:
    """Return the name of a weight file."""
    return f"{find_policy(policy).name}-{preset}-seed{seed}.npz"


def shipped_seeds(preset: str, policy: str) -> list[int]:
    """Return the training seeds that a policy ships with."""
    files = FOLDER.glob(f"{find_policy(policy).name}-{preset}-seed*.npz")
    return sorted(int(file.stem.rpartition("-seed")[2]) for file in files)


def manifest(folder: Path = FOLDER) -> dict[str, dict]:
    """Read the manifest: file name -> digest and training record.

    Raises
    ------
    UserError : it is damaged
    """
    path = folder / "manifest.json"
    if not path.exists():
        return {}
    try:
        entries = read_json(path)
    except UserError as error:
        raise UserError(f"{error}; reinstall the package") from None
    for name, entry in entries.items():
        curve = entry.get("curve", {}) if isinstance(entry, dict) else None
        columns = list(curve.values()) if isinstance(curve, dict) else [None]
        if not all(isinstance(c, list) and all(type(x) in (int, float) for x in c) for c in columns) or (
            len({len(column) for column in columns}) > 1
        ):
            raise UserError(f"{path} is damaged: its entry {name[:80]!r} is no training record; reinstall the package")
    return entries


def shipped(preset: str, policy: str, seed: int, folder: Path = FOLDER) -> Path | None:
    """Return the path of shipped weights, or None where there are none.

    Raises
    ------
    UserError : the file is not the one that the manifest records
    """
    path = folder / file_name(preset, policy, seed)
    if not path.exists():
        return None
    expected = manifest(folder).get(path.name, {}).get("sha256")
    if sha256(path) != expected:
        raise UserError(f"shipped weights {path.name} differ from their manifest; reinstall the package")
    return path


def shipped_curve(path: Path) -> dict[str, np.ndarray]:
    """Return the learning curve of a shipped file, thinned, one array per column; empty where its manifest has none."""
    entry = manifest(path.parent).get(path.name, {})
    return {key: np.array(values) for key, values in entry.get("curve", {}).items()}


def _thin(values: np.ndarray) -> list[float]:
    """Keep about CURVE_POINTS values, the first and the last one among them."""
    kept = np.linspace(0, len(values) - 1, min(len(values), CURVE_POINTS + 1)).round().astype(int)
    return values[kept].tolist()


def ship(run: Path, folder: Path = FOLDER) -> Path:
    """Copy a finished run into the package and record it in the manifest.

    Raises
    ------
    UserError : the run is not finished
    """
    if not (run / "DONE").exists():
        raise UserError(f"{run} holds no finished run")
    arrays, meta = read_npz(run / "policy.npz")
    # What acts, and only where training starts from a policy its blocks and critic, half of a file.
    wanted = ("actor.", "normalizer.mean", "normalizer.var", "seen.")
    wanted += ("net.", "normalizer.count") if meta["policy"] in WARM_STARTS else ()
    kept = {name: a for name, a in arrays.items() if name.startswith(wanted)}
    path = folder / file_name(meta["preset"], meta["policy"], meta["seed"])
    meta["config"] = meta.get("config", {}) | {"out": ""}  # where it was trained is nobody's business
    write_npz(path, kept, {key: value for key, value in meta.items() if key != "schema"})
    record = {key: meta[key] for key in ("policy", "preset", "seed", "steps", "wall_seconds", "courses", "versions")}
    progress = read_progress(run / "progress.csv")
    curve = {key: _thin(v) for key, v in progress.items() if key in CURVE_COLUMNS or key.startswith("level_")}
    entries = manifest(folder) | {path.name: {"sha256": sha256(path), **record, "curve": curve}}
    write_text(folder / "manifest.json", json.dumps(entries, sort_keys=True) + "\n")
    return path


if __name__ == "__main__":
    if not sys.argv[1:]:
        sys.exit("usage: python -m agility_ref.training.weights RUN...")
    try:
        for argument in sys.argv[1:]:
            print(ship(Path(argument)))
    except UserError as error:
        sys.exit(f"agility_ref.training.weights: {error}")

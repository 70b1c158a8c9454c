"""Fuzz the files: damaged, absurd and malicious ones are refused in one line, or are as good as new.

    python benchmarks/fuzz_files.py [--mutants 10000] [--first 0] [--seed 0]

Every kind of file that the package reads is mutated: bits flipped, ends cut off, arrays swapped,
of other types and shapes, infinite, of terabytes in name only, bombs, pickles that would run
code, symbolic links, names with dots.  Each mutant is read as the package reads it.  What counts:
an error of one line or a result that can be used (for a checkpoint that was damaged byte by byte:
the very same arrays), less than 10 s, less than 2 GB, nothing executed, nothing written.  Each
mutant has a random stream of its own: ``--first 5123 --mutants 1`` tries number 5123 alone.

In:  nothing.  Out: counts for each kind of file and mutation.
"""

import argparse
import csv
import faulthandler
import io
import json
import os
import random
import resource
import sys
import tempfile
import time
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from agility_ref.curriculum import CurriculumConfig
from agility_ref.errors import UserError, one_line
from agility_ref.evaluate import METRICS
from agility_ref.files import read_npz, write_npz
from agility_ref.observation import ACTION_MIRROR, OBS_MIRROR
from agility_ref.policy import Policy
from agility_ref.ppo import Learner, PPOConfig
from agility_ref.results.cells import read_cell
from agility_ref.results.findings import ABLATION_COLUMNS, read_ablations
from agility_ref.training import weights
from agility_ref.training.bank import find_weights, run_folder
from agility_ref.training.policies import find_policy
from agility_ref.training.progress import EPISODE, PROGRESS, rows_until
from agility_ref.training.runs import TrainConfig, make_env
from agility_ref.training.state import check_arrays, go_on, learner_state, policy_arrays, robots_state

import numpy as np

PPO = PPOConfig(num_envs=4, num_steps=4, hidden=(8,))
WORDS = (
    "NaN", "nan", "inf", "-inf", "1e999", "-1", "9" * 400, "0x10", "", '"', ",", "\0", "\n", "\r", "{", "}", "[" * 5000, "null", "true",
    "../../../etc/passwd", "\ufeff", "\x1b[2J", "é", "1_0", "١",
)  # fmt: skip
VALUES = (None, True, -1, 0, 10**30, 1e308, "x", "", "../..", [], {}, [[]], {"a": {"b": [1]}}, "a\nb", "\x1b[31m")


# ---------------------------------------------------------------------------- mutations


def bytes_mutant(content: bytes, rng: random.Random) -> tuple[str, bytes]:
    """Damage bytes as disks, editors and interrupted copies do."""
    data, how = bytearray(content), rng.choice(("flip", "cut", "zeros", "twice", "delete", "insert", "empty", "tail"))
    at = rng.randrange(len(data))
    if how == "flip":
        for _ in range(rng.choice((1, 1, 2, 8))):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    elif how == "cut":
        del data[at:]
    elif how == "zeros":
        data[at : at + rng.randrange(1, 600)] = bytes(min(rng.randrange(1, 600), len(data) - at))
    elif how == "twice":
        data += data[at:]
    elif how == "delete":
        del data[at : at + rng.randrange(1, 200)]
    elif how == "insert":
        data[at:at] = rng.randbytes(rng.randrange(1, 200))
    elif how == "empty":
        data = data[:0]
    else:
        data += rng.randbytes(50)
    return how, bytes(data)


def text_mutant(content: bytes, rng: random.Random) -> tuple[str, bytes]:
    """Damage text as people and other programs do."""
    if rng.random() < 0.4:
        return bytes_mutant(content, rng)
    lines, how = content.decode().splitlines(keepends=True), rng.choice(("word", "swap", "double", "drop", "separator"))
    k = rng.randrange(len(lines))
    if how == "word":
        at = rng.randrange(len(lines[k]))
        lines[k] = lines[k][:at] + rng.choice(WORDS) + lines[k][at + rng.randrange(4) :]
    elif how == "swap":
        other = rng.randrange(len(lines))
        lines[k], lines[other] = lines[other], lines[k]
    elif how == "double":
        lines.insert(k, lines[k])
    elif how == "drop":
        del lines[k]
    else:
        lines = [line.replace(",", rng.choice((";", "\t", ",,"))) for line in lines]
    return how, "".join(lines).encode()


def json_mutant(content: bytes, rng: random.Random) -> tuple[str, bytes]:
    """Put odd values into a record, or damage its text."""
    if rng.random() < 0.5:
        return text_mutant(content, rng)
    record = json.loads(content)
    node = record
    while True:
        key = rng.choice(list(node) if isinstance(node, dict) else range(len(node)))
        if not isinstance(node[key], dict | list) or not node[key] or rng.random() < 0.3:
            break
        node = node[key]
    node[key] = rng.choice(VALUES)
    return "value", json.dumps(record).encode()


class Bomb:
    """Pickled into a file, it would leave a mark where it is unpickled."""

    def __init__(self, mark: Path):
        self.mark = mark

    def __reduce__(self):
        return (Path.touch, (self.mark,))


def claiming(shape: tuple[int, ...], content: bytes = b"") -> bytes:
    """Return an .npy file whose header claims a shape."""
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": shape})
    return file.getvalue() + content


def npz_mutant(content: bytes, rng: random.Random, mark: Path) -> tuple[str, bytes]:
    """Rewrite an .npz with an array or a record that is wrong."""
    kinds = (
        "bytes", "swap", "type", "value", "shape", "missing", "name", "record", "claim", "pickle", "bomb", "method", "double", "header",
    )  # fmt: skip
    how = rng.choices(kinds, (12, 3, 3, 3, 3, 2, 2, 6, 2, 1, 0.2, 1, 1, 3))[0]
    if how == "bytes":
        return bytes_mutant(content, rng)
    with zipfile.ZipFile(io.BytesIO(content)) as file:
        raw = {name: file.read(name) for name in file.namelist()}
    names = sorted(name for name in raw if name != "__meta__.npy")
    name, other, out = rng.choice(names), rng.choice(names), io.BytesIO()
    array = np.load(io.BytesIO(raw[name]))
    method, doubled = zipfile.ZIP_STORED, False
    if how == "swap":
        raw[name], raw[other] = raw[other], raw[name]
    elif how == "type":
        kind = rng.choice(
            ("float16", "float64", "int64", "int8", "complex64", "bool", "U7", "S3", ">f4", "uint8", "datetime64[s]")
        )
        raw[name] = npy(array.astype(kind, casting="unsafe"))
    elif how == "value":
        changed = array.copy()
        odd = (
            (np.nan, np.inf, -np.inf, 1e30, -1.0, 3.4e38)
            if array.dtype.kind == "f"
            else (-1, 1, 2**31 - 1, 2**63 - 1, -(2**63))
        )
        if changed.size:
            changed.reshape(-1)[rng.randrange(changed.size)] = np.array([rng.choice(odd)]).astype(array.dtype)[0]
        raw[name] = npy(changed)
    elif how == "shape":
        shapes = (
            array[None],
            array.reshape(-1),
            array.reshape(-1)[:1],
            array.reshape(-1)[:0],
            np.tile(array, 2),
            np.zeros((), array.dtype),
        )
        raw[name] = npy(rng.choice(shapes))
    elif how == "missing":
        del raw[rng.choice(list(raw))]
    elif how == "name":
        raw[
            rng.choice(("../../evil.npy", "/etc/evil.npy", "actor.x.npy", "actor.0.weight.npy.npy", "a\nb.npy", "a"))
        ] = raw.pop(name)
    elif how == "record":
        record = json.loads(str(np.load(io.BytesIO(raw["__meta__.npy"]))))
        _, changed = json_mutant(json.dumps(record).encode(), rng)
        raw["__meta__.npy"] = npy(np.array(changed.decode(errors="replace").replace("\0", " ")))
    elif how == "claim":
        shape = rng.choice(((10**12,), (2**40, 3), (2**62, 2**62), (10**9, 0), (10**5, 10**5), (-1, 5)))
        raw[name] = claiming(shape, bytes(100))
    elif how == "pickle":
        file = io.BytesIO()
        np.save(file, np.array([Bomb(mark)], object), allow_pickle=True)
        raw[rng.choice((name, "__meta__.npy"))] = file.getvalue()
    elif how == "bomb":
        raw[name], method = claiming((10**8,), bytes(4 * 10**8)), zipfile.ZIP_DEFLATED
    elif how == "method":
        method = rng.choice((zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA, zipfile.ZIP_DEFLATED))
    elif how == "double":
        doubled = True
    else:
        damaged = bytearray(raw[name])
        damaged[rng.randrange(min(128, len(damaged)))] = rng.choice(b"\0(){}[]',:0129<>OUV\xff\n")
        raw[name] = bytes(damaged)
    with zipfile.ZipFile(out, "w", method) as file:
        for key, part in raw.items():
            file.writestr(key, part)
        if doubled:
            file.writestr(zipfile.ZipInfo(name), raw[name])
    return how, out.getvalue()


def npy(array: np.ndarray) -> bytes:
    """Return an array as an .npy file."""
    file = io.BytesIO()
    np.save(file, array, allow_pickle=False)
    return file.getvalue()


# ---------------------------------------------------------------------------- files, and who reads them


class Files:
    """One good file of every kind in a folder, and the functions that read it."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.config = TrainConfig(
            preset="quick", out=str(folder / "runs"), ppo=PPO, curriculum=CurriculumConfig(num_levels=2, variants=1)
        )
        self.env, self.curriculum = make_env(find_policy("walk"), self.config)
        self.learner = Learner.create(OBS_MIRROR, ACTION_MIRROR, PPO, 0)
        self.observation = self.env.observation.copy()
        run = run_folder(self.config.root, "walk", 0)
        run.mkdir(parents=True)
        (run / "DONE").touch()
        self.run, self.cell_meta = run, {"policy": "walk", "environment": "gap", "seed": 0, "steps": 5}
        arrays = policy_arrays(self.learner) | learner_state(self.learner) | robots_state(self.env, self.curriculum)
        arrays |= {"progress.episodes": np.ones((3, len(EPISODE)))}
        meta = {
            "policy": "walk",
            "preset": "quick",
            "seed": 0,
            "steps": 64,
            "start": 0,
            "act_dim": 12,
            "config": {"preset": "quick"},
        }
        write_npz(run / "policy.npz", arrays, meta, compress=False)
        (run / "config.json").write_text(
            json.dumps({"policy": "walk", "preset": "quick", "ppo": {"hidden": [8]}}, indent=1)
        )
        with open(run / "progress.csv", "w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(PROGRESS)
            writer.writerows([[16 * k, *[f"{k / 7:.6g}"] * (len(PROGRESS) - 1)] for k in range(1, 5)])
        with open(folder / "ablations.csv", "w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow([*ABLATION_COLUMNS])
            rows = (
                {"seed": k, "steps": 100, "waypoint_fraction": 0.5, "ablation": "baseline", "policy": "climb"}
                for k in range(3)
            )
            writer.writerows([[row.get(c, 0.25) for c in ABLATION_COLUMNS] for row in rows])
        write_npz(folder / "cell.npz", {m: np.linspace(0, 1, 5) for m in METRICS}, self.cell_meta)
        curve = {"steps": [1, 2, 3], "reward": [0.5, 1.5, 2.5]}
        name = weights.file_name("quick", "walk", 0)
        write_npz(folder / name, policy_arrays(self.learner), meta)
        entry = {"sha256": weights.sha256(folder / name), "policy": "walk", "steps": 64, "curve": curve}
        (folder / "manifest.json").write_text(json.dumps({name: entry}))
        self.shipped = folder / name
        self.kinds: dict[str, tuple[Path, Callable, Callable]] = {
            "checkpoint": (run / "policy.npz", npz_mutant, self.read_checkpoint),
            "cell": (folder / "cell.npz", npz_mutant, self.read_cell),
            "config": (run / "config.json", json_mutant, self.read_config),
            "progress": (run / "progress.csv", text_mutant, self.read_progress),
            "ablations": (folder / "ablations.csv", text_mutant, self.read_ablations),
            "manifest": (folder / "manifest.json", json_mutant, self.read_manifest),
        }

    def read_checkpoint(self, path: Path) -> dict:
        """Act with it, and go on from it where that is possible."""
        action = Policy.load(path)(self.observation)
        if not np.isfinite(action).all():
            raise RuntimeError("a policy that loads does not act")
        arrays, _ = read_npz(path)
        check_arrays(path, arrays, self.learner, self.env, self.curriculum)
        go_on(arrays, self.learner, self.env, self.curriculum)
        self.env.step(np.zeros((PPO.num_envs, 12)))
        return arrays

    def read_cell(self, path: Path) -> dict | None:
        """Read it as a table does, which plays what it cannot read."""
        cell = read_cell(path, self.cell_meta)
        return cell and cell.arrays

    def read_config(self, path: Path) -> None:
        """Look for the weights beside it."""
        find_weights("walk", self.config)

    def read_progress(self, path: Path) -> None:
        """Read it as a run that goes on does."""
        rows_until(path, 0, 64, 16, ())

    def read_ablations(self, path: Path) -> None:
        """Read it as the findings do."""
        read_ablations(path)

    def read_manifest(self, path: Path) -> None:
        """Look for shipped weights and their curve."""
        weights.shipped("quick", "walk", 0, self.folder)
        weights.shipped_curve(self.shipped)


def odd_files(path: Path, rng: random.Random) -> str:
    """Put something at ``path`` that is no ordinary file."""
    path.unlink()
    how = rng.choice(("folder", "link to nothing", "link to itself", "endless", "fifo"))
    if how == "folder":
        path.mkdir()
    elif how == "fifo":
        os.mkfifo(path)
    else:
        path.symlink_to({"link to nothing": "../../nothing", "link to itself": path.name, "endless": "/dev/zero"}[how])
    return how


def peak_megabytes() -> float:
    """Return the most memory that this process has had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def fuzz(
    mutants: int, seed: int, folder: Path, first: int = 0, log: Callable[[str], None] = lambda line: None
) -> Counter:
    """Read ``mutants`` damaged files, from number ``first`` on.

    Returns how many were (refused | loaded | played again), by kind and mutation.

    Raises
    ------
    RuntimeError : the first mutant that was treated otherwise
    """
    counts, mark = Counter(), folder / "executed"
    files = Files(folder / "files")
    good = {kind: path.read_bytes() for kind, (path, _, _) in files.kinds.items()}
    whole = {kind: read(path) for kind, (path, _, read) in files.kinds.items()}
    listing = sorted(folder.rglob("*"))
    shares = dict(zip(files.kinds, (5, 2, 1, 1, 1, 1), strict=True))
    for mutant in range(first, first + mutants):
        rng = random.Random(f"{seed} {mutant}")
        kind = rng.choices(list(shares), list(shares.values()))[0]
        path, mutate, read = files.kinds[kind]
        if rng.random() < 0.02:
            how = odd_files(path, rng)
        else:
            how, content = mutate(good[kind], rng, mark) if mutate is npz_mutant else mutate(good[kind], rng)
            path.write_bytes(content)
        begun = time.monotonic()
        try:
            result = read(path)
            outcome = "played again" if kind == "cell" and result is None else "loaded"
        except UserError as error:
            outcome, line = "refused", one_line(error)
            if "\n" in line or not line.isprintable() or len(line) > 1000:
                raise RuntimeError(f"mutant {mutant}, {kind}, {how}: {line!r}") from None
        except BaseException as error:
            raise RuntimeError(f"mutant {mutant}, {kind}, {how}: {error!r}") from error
        damaged = how in ("flip", "cut", "zeros", "twice", "delete", "insert", "empty", "tail")
        if outcome == "loaded" and damaged and whole[kind] is not None:
            for name in whole[kind]:
                np.testing.assert_array_equal(result[name], whole[kind][name])
        if path.is_dir() and not path.is_symlink():
            path.rmdir()
        else:
            path.unlink()
        path.write_bytes(good[kind])
        if time.monotonic() - begun > 10.0 or sorted(folder.rglob("*")) != listing:
            raise RuntimeError(f"mutant {mutant}, {kind}, {how}: took {time.monotonic() - begun:.1f} s, or left files")
        counts[kind, how, outcome] += 1
        if peak_megabytes() > 2048:
            raise RuntimeError(f"mutant {mutant}, {kind}, {how}: {peak_megabytes():.0f} MB")
        if mutant % 500 == 499:
            log(f"mutants to {mutant}: {peak_megabytes():.0f} MB at the peak")
    return counts


def main() -> None:
    """Run the test that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--mutants", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    faulthandler.enable()  # names the line, should a mutant end this process
    warnings.simplefilter("ignore")  # of numpy and zipfile, about what the mutations do
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        try:
            counts = fuzz(args.mutants, args.seed, Path(folder), args.first, lambda line: print(line, flush=True))
        except RuntimeError as error:
            sys.exit(f"fuzz_files: {error}")
    kinds = dict.fromkeys(kind for kind, _, _ in counts)
    for kind in kinds:
        totals = Counter()
        for (of, _, outcome), number in counts.items():
            totals[outcome] += number * (of == kind)
        print(f"{kind:12}" + ", ".join(f"{number} {outcome}" for outcome, number in totals.items() if number))
    print(
        f"{sum(counts.values())} of {args.mutants}; peak memory {peak_megabytes():.0f} MB; {time.monotonic() - begun:.0f} s"
    )


if __name__ == "__main__":
    main()

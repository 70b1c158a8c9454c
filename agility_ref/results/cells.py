"""Cells: one policy, trained with one seed, on one terrain; stored as soon as it is played.

    <results>/cells/<policy>-<environment>-seed<k>.npz

A table that was interrupted goes on from its cells.  Each file says what it was made from:
the evaluation, the task, the digests of all weights that act, and those of the source files
that decide an episode.  If any of them has changed, the cell is played again.

In:  an :class:`Entrant` (a policy with its weights), a terrain, an evaluation config.
Out: :class:`Cell`.
"""

import hashlib
import json
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

from agility_ref.env import EnvConfig
from agility_ref.errors import UserError
from agility_ref.evaluate import METRICS, Evaluation, EvaluationConfig
from agility_ref.files import read_npz, write_npz
from agility_ref.results.published import evaluate_by_protocol
from agility_ref.selector import Hierarchy, Single
from agility_ref.training.bank import WeightsConfig, bank_steps, load_policy, weights_path
from agility_ref.training.policies import find_policy
from agility_ref.training.weights import sha256

import mujoco
import numpy as np

# Files whose text decides what happens in an episode and how it is counted.
SOURCES = (
    "files", "terrain", "world", "go1", "simulation", "rewards", "observation", "env", "curriculum", "policy", "selector",
    "evaluate", "results/published", "training/policies", "training/bank",
)  # fmt: skip


@dataclass(frozen=True)
class Cell:
    """One number per episode and metric, and where they come from."""

    policy: str
    environment: str
    seed: int  # training seed of the weights
    arrays: dict[str, np.ndarray]  # (N,) each: the four metrics, fell, difficulty, and for hierarchies :func:`choices`
    meta: dict  # what the cell was made from; see :func:`origin`

    @property
    def steps(self) -> int:
        """Environment steps spent on the policy."""
        return self.meta["steps"]

    @property
    def protocol(self) -> str:
        """How the episodes were counted."""
        return self.meta["evaluation"]["protocol"]


Cells = dict[tuple[str, str, int], Cell]
"""(policy, environment, training seed) -> its cell."""


def cell_path(folder: Path, policy: str, environment: str, seed: int) -> Path:
    """Return the file of a cell."""
    return Path(folder) / f"{policy}-{environment}-seed{seed}.npz"


def acting_policies(policy: str) -> tuple[str, ...]:
    """Names of all policies whose weights act: the policy's own, if it has any, and its skills."""
    spec = find_policy(policy)
    return (*(() if spec.method == "oracle" else (spec.name,)), *spec.skills)


@dataclass(frozen=True)
class Entrant:
    """A policy with the weights of one training seed, ready to play any terrain."""

    policy: str  # its name; an alias stands for the policy that it names
    seed: int  # training seed
    acting: Single | Hierarchy
    weights: dict[str, str]  # names of all policies whose weights act -> their sha256
    steps: int  # environment steps spent; see :func:`steps_spent`


def enter(policy: str, training: WeightsConfig) -> Entrant:
    """Load a policy with everything that acts in it.

    Raises
    ------
    UserError : unknown policy; weights are missing or unreadable
    """
    name = find_policy(policy).name
    acting = load_policy(name, training)
    digests = {other: sha256(weights_path(other, training)) for other in acting_policies(name)}
    return Entrant(name, training.seed, acting, digests, steps_spent(name, training))


def origin(entrant: Entrant, environment: str, config: EvaluationConfig) -> dict:
    """Describe everything that a cell depends on, as JSON keeps it."""
    made_from = {
        "policy": entrant.policy,
        "environment": environment,
        "seed": entrant.seed,
        "evaluation": asdict(config),
        "task": asdict(EnvConfig()),
        "weights": entrant.weights,
        "steps": entrant.steps,
        "code": code_digest(),
        "mujoco": mujoco.__version__,
        "numpy": np.__version__,
    }
    return json.loads(json.dumps(made_from))


@cache
def code_digest() -> str:
    """Digest of the source files named in SOURCES."""
    text = b"".join((Path(__file__).parent.parent / f"{name}.py").read_bytes() for name in SOURCES)
    return hashlib.sha256(text).hexdigest()


def steps_spent(policy: str, training: WeightsConfig) -> int:
    """Environment steps behind a policy: its own, and those of the bank that it chooses from or has learned from.

    Raises
    ------
    UserError : weights are missing or unreadable
    """
    spec = find_policy(policy)
    record = {} if spec.method == "oracle" else read_npz(weights_path(policy, training))[1]
    # Its own teachers, or those of the policy that it went on from.
    teachers = find_policy(spec.warm_start).teachers if record.get("start") else spec.teachers
    return record.get("steps", 0) + bank_steps(spec.skills + teachers, training)


def read_cell(path: Path, meta: dict) -> Cell | None:
    """Return the stored cell if it was made from the same as ``meta`` says, else None."""
    try:
        arrays, stored = read_npz(path)
    except UserError:  # none there, or not readable: it is played again
        return None
    stored.pop("schema")
    if stored != meta or not set(METRICS) <= set(arrays):
        return None
    return Cell(meta["policy"], meta["environment"], meta["seed"], arrays, meta)


# What a selector did.  skill[t, n] is the skill that acted in step t, -1 after the end.


def switches_per_second(skill: np.ndarray, dt: float) -> np.ndarray:
    """Changes of skill from one step to the next / seconds of the episode: (T, N) -> (N,)."""
    alive = skill >= 0
    return ((skill[1:] != skill[:-1]) & alive[1:]).sum(axis=0) / (alive.sum(axis=0) * dt)


def commonest_share(skill: np.ndarray) -> np.ndarray:
    """Share of each episode's steps that its own commonest skill took: (T, N) -> (N,).

    A course of one obstacle may rightly be played by one skill; ``commonest`` of
    :func:`agility_ref.results.diagnosis.diagnose` pools all episodes.
    """
    counts = np.stack([(skill == k).sum(axis=0) for k in range(skill.max() + 1)])
    return counts.max(axis=0) / counts.sum(axis=0)


def oracle_accuracy(skill: np.ndarray, oracle: np.ndarray) -> np.ndarray:
    """Share of the episode's steps with the skill that the oracle names there: (T, N) -> (N,)."""
    alive = skill >= 0
    return ((skill == oracle) & alive).sum(axis=0) / alive.sum(axis=0)


def choices(played: Evaluation) -> dict[str, np.ndarray]:
    """Return what the selector did in each episode (N,), and what the oracle asked for on the same path.

    The path is the policy's own, so ``wanted_switches_per_second`` is how often *it* should
    have switched.  Empty for a policy without skills, and for episodes counted as published.
    """
    if played.skill is None:
        return {}
    return {
        "switches_per_second": switches_per_second(played.skill, played.dt),
        "commonest_share": commonest_share(played.skill),
        "oracle_accuracy": oracle_accuracy(played.skill, played.oracle),
        "wanted_switches_per_second": switches_per_second(played.oracle, played.dt),
        "wanted_commonest_share": commonest_share(played.oracle),
    }


def find_cell(entrant: Entrant, environment: str, config: EvaluationConfig, folder: Path) -> Cell:
    """Return the stored cell, or play and store it.

    Parameters
    ----------
    entrant : who plays
    environment, config : what is played
    folder : of the cells
    """
    meta = origin(entrant, environment, config)
    path = cell_path(folder, entrant.policy, environment, entrant.seed)
    cell = read_cell(path, meta)
    if cell is None:
        played = evaluate_by_protocol(entrant.acting, environment, config)
        arrays = {k: getattr(played, k) for k in (*METRICS, "fell", "difficulty")} | choices(played)
        write_npz(path, arrays, meta)
        cell = Cell(entrant.policy, environment, entrant.seed, arrays, meta)
    return cell


def stack(cells: Cells, policy: str, environment: str, name: str, seeds: list[int]) -> np.ndarray:
    """Return one array of a policy's cells, (S, N), one row per training seed."""
    policy = find_policy(policy).name
    return np.stack([cells[policy, environment, seed].arrays[name] for seed in seeds]).astype(float)


def seeds_of(cells: Cells, policy: str, environment: str) -> list[int]:
    """Return the training seeds of which there is a cell, in order."""
    policy = find_policy(policy).name
    return sorted(seed for p, e, seed in cells if (p, e) == (policy, environment))

"""Fidelity: whether policies hold under finer physics than they were trained with.

    python benchmarks/fidelity.py agility_ref/weights/{walk,leap,climb}-full-seed0.npz [--json]
    python benchmarks/fidelity.py --candidates "chosen" "Euler" [--json]

Plays each policy's evaluation under the physics it was trained with and at 2.5 ms with MuJoCo's
default solver settings, on the same episodes.  The policy holds if it loses no more of its
waypoints than the 95 % interval under its own physics.  With ``--candidates`` the policies are
first trained under candidates of ``physics.py``; finished runs are kept and taken up again.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Annotated
from unittest.mock import patch

from agility_ref import go1
from agility_ref.env import TRAINING, EnvConfig
from agility_ref.errors import UserError
from agility_ref.evaluate import EvaluationConfig, evaluate
from agility_ref.go1 import PhysicsConfig
from agility_ref.observation import OBS_DIM
from agility_ref.pictures.plots import learning_curve
from agility_ref.policy import Policy
from agility_ref.selector import Single
from agility_ref.stats import bootstrap_interval, paired_difference, wilson_interval
from agility_ref.training.bank import run_folder
from agility_ref.training.runs import TrainConfig, train_policy

import numpy as np
from common import machine, report, start, substitute
from physics import Candidate, candidates
from tyro.conf import Positional


@dataclass(frozen=True)
class Config:
    """Policies under finer physics."""

    weights: Annotated[tuple[str, ...], Positional] = ()
    """Checkpoints to play."""
    candidates: tuple[str, ...] = ()
    """Candidates of physics.py under which to train policies and play them."""
    policies: tuple[str, ...] = ("walk", "climb")
    """What to train under each candidate, preset quick, after what it starts from."""
    seed: int = 0
    """Training seed."""
    runs: str = "runs/physics"
    """Folder of these runs."""
    episodes: int = 64
    """Complete episodes of each evaluation."""
    json: bool = False
    """Print one JSON object."""


@contextmanager
def edited(candidate: Candidate) -> Iterator[None]:
    """Compile every robot with the candidate's edits of the MJCF."""
    plain = go1.make_xml

    def make_xml(*args, **kwargs) -> str:
        xml = plain(*args, **kwargs)
        for old, new in candidate.edits:
            xml = substitute(xml, old, new)
        return xml

    with patch.object(go1, "make_xml", make_xml):
        yield


def fine(physics: PhysicsConfig) -> PhysicsConfig:
    """Return the same robot at 2.5 ms with MuJoCo's default 100 iterations and 50 of line search."""
    dt = physics.timestep * physics.substeps
    return replace(physics, timestep=0.0025, substeps=round(dt / 0.0025), iterations=100, ls_iterations=50)


def trained_physics(policy: Policy) -> PhysicsConfig:
    """Return the physics that a checkpoint's record names; the chosen one where it names none."""
    recorded = policy.meta.get("config", {}).get("env", {}).get("physics", {})
    return PhysicsConfig(**{f.name: recorded[f.name] for f in fields(PhysicsConfig) if f.name in recorded})


def hold(path: str | Path, candidate: Candidate, episodes: int) -> list[dict]:
    """Play one policy under both physics, the same courses and starts; finer physics has no edits."""
    policy = Policy.load(path)
    if policy.obs_dim != OBS_DIM or len(policy.layers[-1][1]) != 12:
        raise UserError(f"{path} is a selector: play its skills")
    name, physics, rows = policy.meta.get("policy", str(path)), trained_physics(policy), []
    for environment in policy.meta["courses"]:
        evaluation = EvaluationConfig(episodes, preset=policy.meta.get("preset", "full"))
        with edited(candidate):
            trained = evaluate(Single(name, policy), environment, evaluation, EnvConfig(physics=physics))
        finer = evaluate(Single(name, policy), environment, evaluation, EnvConfig(physics=fine(physics)))
        low, high = bootstrap_interval(trained.waypoint_fraction, np.mean)
        rows.append(
            {
                "candidate": candidate.name,
                "policy": name,
                "environment": environment,
                "waypoint_fraction": float(trained.waypoint_fraction.mean()),
                "interval": [low, high],
                "fine_waypoint_fraction": float(finer.waypoint_fraction.mean()),
                "difference": paired_difference(finer.waypoint_fraction, trained.waypoint_fraction),
                "falls": float(trained.fell.mean()),
                "falls_interval": wilson_interval(int(trained.fell.sum()), episodes),
                "fine_falls": float(finer.fell.mean()),
                "holds": bool(finer.waypoint_fraction.mean() >= low),
            }
        )
    return rows


def train_under(candidate: Candidate, config: Config) -> list[Path]:
    """Train the policies under a candidate, those that are not there; return their checkpoints."""
    slug = candidate.name.replace(" ", "-").replace(",", "")
    env = replace(TRAINING, physics=candidate.physics)
    recipe = TrainConfig(preset="quick", seed=config.seed, out=str(Path(config.runs) / slug), env=env)
    folders = [run_folder(recipe.root, name, config.seed) for name in config.policies]
    with edited(candidate):
        for name, folder in zip(config.policies, folders, strict=True):
            if not (folder / "DONE").exists():
                train_policy(name, recipe, draw=learning_curve)
    return [folder / "policy.npz" for folder in folders]


def main(config: Config) -> None:
    started = machine()
    known = {candidate.name: candidate for candidate in candidates() if candidate.ground == "courses"}
    if unknown := [name for name in config.candidates if name not in known]:
        raise UserError(f"no candidate {'; '.join(unknown)} on the training courses; there are: {'; '.join(known)}")
    if not (config.weights or config.candidates):
        raise UserError("give checkpoints to play, or --candidates")
    rows = [row for path in config.weights for row in hold(path, known["chosen"], config.episodes)]
    for name in config.candidates:
        for path in train_under(known[name], config):
            rows += hold(path, known[name], config.episodes)
    table = [
        {
            "physics": r["candidate"],
            "policy": f"{r['policy']} on {r['environment']}",
            "waypoints": f"{r['waypoint_fraction']:.3f} [{r['interval'][0]:.3f}, {r['interval'][1]:.3f}]",
            "at 2.5 ms": f"{r['fine_waypoint_fraction']:.3f}",
            "difference": "{:+.3f} [{:+.3f}, {:+.3f}]".format(*r["difference"]),
            "falls": f"{r['falls']:.2f} [{r['falls_interval'][0]:.2f}, {r['falls_interval'][1]:.2f}]",
            "falls at 2.5 ms": f"{r['fine_falls']:.2f}",
            "holds": "yes" if r["holds"] else "NO",
        }
        for r in rows
    ]
    report(config.json, started, {"config": asdict(config), "fidelity": rows}, table)


if __name__ == "__main__":
    start(main, Config)

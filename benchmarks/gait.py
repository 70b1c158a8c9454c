"""How the policies walk: what no reward and no column of Table 1 says.

    python benchmarks/gait.py [walk gen-5 ...] [--preset quick] [--seeds 0 1 2] [--json]

Plays level ground with noise and pushes and measures, after two seconds: the share of the
time that each foot stands, the height of its swings, how often it swings, and how often
anything but a foot touches the ground.  tests/pictures/test_gait.py holds the shipped walk to bounds.
"""

from dataclasses import asdict, dataclass

from agility_ref.evaluate import EvaluationConfig
from agility_ref.pictures.gait import measure
from agility_ref.pictures.record import record
from agility_ref.training.bank import load_policy
from agility_ref.training.runs import TrainConfig

import numpy as np
import tyro
from common import machine, report, start


@dataclass(frozen=True)
class Config:
    """Gait of policies."""

    policies: tyro.conf.Positional[tuple[str, ...]] = ("walk",)
    """Names of policies, see `agility-ref list`."""
    preset: str = "full"
    """Names the weights."""
    seeds: tuple[int, ...] = (0,)
    """Training seeds."""
    runs: str = ""
    """Folder of runs to look in before the shipped weights; runs/<preset> by default."""
    environment: str = "walk"
    """Course to walk on."""
    difficulty: float = 0.0
    """Of the courses, 0 to 1."""
    episodes: int = 32
    """Episodes, one per course; usual 16 to 64."""
    clean: bool = False
    """Turn noise, pushes, payload and friction differences off."""
    json: bool = False
    """Print one JSON object."""


def main(config: Config) -> None:
    started = machine()
    evaluation = EvaluationConfig(difficulty=config.difficulty, clean=config.clean)
    figures, rows = [], []
    for name in config.policies:
        for seed in config.seeds:
            policy = load_policy(name, TrainConfig(preset=config.preset, seed=seed, out=config.runs))
            episodes = record(policy, config.environment, evaluation, tuple(range(config.episodes)))
            gait, falls = measure(episodes), float(np.mean([e.fell for e in episodes]))
            values = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in asdict(gait).items()}
            figures.append({"policy": name, "seed": seed, "falls": falls, **values})
            rows.append(
                {
                    "policy": name,
                    "seed": seed,
                    "feet stand FR FL RR RL [%]": " ".join(f"{100 * share:.0f}" for share in gait.contact_share),
                    "diagonals agree": f"{gait.diagonal_correlation:.2f}",
                    "swings rise [cm]": " ".join(f"{100 * height:.1f}" for height in gait.swing_clearance),
                    "swings/s": " ".join(f"{rate:.1f}" for rate in gait.swings_per_second),
                    "body touches [%]": f"{100 * gait.body_share:.1f}",
                    "torque / limit": f"{gait.torque_share:.2f}",
                    "falls": f"{falls:.2f}",
                }
            )
    report(config.json, started, {"config": asdict(config), "gaits": figures}, rows)


if __name__ == "__main__":
    start(main, Config)

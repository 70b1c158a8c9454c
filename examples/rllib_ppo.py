"""PPO of RLlib (its new API stack), in this process, all robots in one vector environment.

    pip install "agility-ref[gym]" "ray[rllib]"
    python examples/rllib_ppo.py --steps 2000000

RLlib makes the environment itself, through its registered ``vector_entry_point``.
"""

import agility_ref.gym  # noqa: F401  registers the ids, and comes before numpy

# isort: split

import time
from collections import deque
from dataclasses import dataclass, replace

from agility_ref.env import TRAINING
from agility_ref.terrain import NUM_WAYPOINTS

import numpy as np
import ray
import tyro
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.connectors.env_to_module import MeanStdFilter
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig


@dataclass(frozen=True)
class Config:
    """Train PPO of RLlib."""

    id: str = "Go1Walk-v0"
    """Environment; also Go1ClimbUp, Go1ClimbDown, Go1Climb, Go1Gap, Go1Beam and Go1ClimbGap, all -v0."""
    difficulty: tuple[float, float] = (0.0, 0.4)
    """Courses are spread evenly between these two."""
    steps: int = 2_000_000
    """Environment steps of all robots together."""
    num_envs: int = 64
    """Robots in the simulator."""
    batch_size: int = 4096
    """Steps of all robots between two updates."""
    seed: int = 0
    """Of networks and exploration."""


def main(config: Config) -> float:
    """Train; return the waypoint fraction of the last 100 episodes."""
    waypoints: deque[float] = deque(maxlen=100)
    # RLlib's first standard deviation is 1; an action of 1 is 1.2 rad by default, and 0.45 rad here.
    task = replace(TRAINING, action_limit=1.5)

    def note(episode, **_) -> None:
        waypoints.append(episode.get_infos(-1)["totals"]["waypoints"] / NUM_WAYPOINTS)

    ray.init(num_cpus=1, include_dashboard=False)  # RLlib stores its settings there; all else is in this process
    algorithm = (
        PPOConfig()
        .environment(f"agility_ref.gym:{config.id}", env_config={"difficulty": config.difficulty, "config": task})
        .env_runners(
            num_env_runners=0,
            num_envs_per_env_runner=config.num_envs,
            gym_env_vectorize_mode="vector_entry_point",
            env_to_module_connector=lambda env, spaces, device: MeanStdFilter(),
        )
        .learners(num_learners=0)
        .training(
            train_batch_size_per_learner=config.batch_size, minibatch_size=config.batch_size // 4, num_epochs=4,
            lr=3e-4, gamma=0.98, lambda_=0.95, clip_param=0.2, entropy_coeff=0.005, vf_loss_coeff=0.5, grad_clip=1.0,
        )
        .rl_module(
            # RLlib's PPO has separate networks by default, its DefaultModelConfig shared ones
            model_config=DefaultModelConfig(fcnet_hiddens=[256, 128], fcnet_activation="elu", vf_share_layers=False)
        )
        .callbacks(on_episode_end=note)
        .debugging(seed=config.seed, log_level="ERROR")
        .build_algo()
    )  # fmt: skip
    start, steps, iteration = time.perf_counter(), 0, 0
    while steps < config.steps:
        steps = algorithm.train()["num_env_steps_sampled_lifetime"]
        iteration += 1
        if iteration % 10 == 0 and waypoints:
            print(f"{steps:9.0f} steps   waypoints {np.mean(waypoints):.2f}", flush=True)
    reached = float(np.mean(waypoints)) if waypoints else 0.0
    print(f"{steps:.0f} steps in {time.perf_counter() - start:.0f} s: waypoints {reached:.2f}")
    algorithm.stop()
    ray.shutdown()
    return reached


if __name__ == "__main__":
    main(tyro.cli(Config))

"""Against Stable-Baselines3 PPO on the same environment.

    python benchmarks/vs_stable_baselines3.py [--json]      needs: pip install "agility-ref[bench]"

Both learn the quick walk from scratch: the same robots and courses, two separate ELU
networks of the same widths, the same batch, minibatches, epochs, discount and clipping.
What stays each library's own: our KL-adaptive learning rate against its constant one, our
hand-scaled scandots against its ``VecNormalize``, advantages normalised over the batch against
over each minibatch, gradients of actor and critic clipped apart against together.  Neither has
a schedule for the exploration noise.  They take turns, a few iterations each, and each has its
own clock.
"""

import sys
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from itertools import islice
from pathlib import Path

from agility_ref.observation import ACTION_MIRROR, OBS_MIRROR, SCANDOTS
from agility_ref.ppo import Learner, PPOConfig, train
from agility_ref.terrain import NUM_WAYPOINTS
from agility_ref.training.policies import find_policy
from agility_ref.training.runs import TrainConfig, ppo_config

import numpy as np
import torch
from common import available_cores, machine, report, require, start, walk_training


@dataclass(frozen=True)
class Config:
    """Our PPO against Stable-Baselines3's."""

    steps: int = 3_000_000
    """Environment steps of each, at most; each stops at the goal."""
    goal: float = 0.8
    """Waypoint fraction of the last 200 training episodes at which a clock stops."""
    seed: int = 0
    """Seed of both."""
    learning_rate: float = 3e-4
    """Constant learning rate of Stable-Baselines3; its default."""
    their_threads: int = 0
    """Torch threads of Stable-Baselines3; 0 for torch's default, all cores."""
    turn: int = 10
    """Iterations before the other's turn."""
    json: bool = False
    """Print one JSON object."""


class Race:
    """One learner's clock, steps and recent episodes."""

    def __init__(self, name: str, threads: int = 0):
        self.name = name
        self.episodes: deque[float] = deque(maxlen=200)
        self.steps, self.seconds = 0, 0.0
        self.threads = threads or available_cores()
        self.reached_steps: int | None = None
        self.reached_seconds: float | None = None

    def waypoint_fraction(self) -> float:
        """Mean over the last 200 episodes; 0 until there are as many."""
        return float(np.mean(self.episodes)) if len(self.episodes) == self.episodes.maxlen else 0.0

    def figures(self) -> dict:
        """Return what is printed."""
        return {
            "steps": self.steps,
            "seconds": self.seconds,
            "steps_per_second": self.steps / self.seconds,
            "waypoint_fraction": self.waypoint_fraction(),
            "reached_steps": self.reached_steps,
            "reached_seconds": self.reached_seconds,
        }


def our_turns(race: Race, config: Config) -> Callable[[], None]:
    """Return a function that trains ours for one turn."""
    ppo = replace(ppo_config(find_policy("walk"), TrainConfig()), final_std=PPOConfig().init_std, anneal_share=0.0)
    env, _ = walk_training(config.seed, ppo.num_envs)
    learner = Learner.create(OBS_MIRROR, ACTION_MIRROR, ppo, config.seed, fixed=SCANDOTS)
    iterations = train(env, learner, config.steps)

    def turn() -> None:
        for record in islice(iterations, config.turn):
            race.steps = record["steps"]
            race.episodes.extend(episode["waypoints"] / NUM_WAYPOINTS for episode in record["episodes"])

    return turn


def their_turns(race: Race, config: Config) -> Callable[[], None]:
    """Return a function that trains Stable-Baselines3 for one turn."""
    sys.path.append(str(Path(__file__).parent.parent / "examples"))
    from agility_ref.gym import Go1VectorEnv

    from sb3_ppo import Go1VecEnv, Progress
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    ppo = ppo_config(find_policy("walk"), TrainConfig())
    envs = Go1VectorEnv("walk", ppo.num_envs, courses=1, autoreset_mode="SameStep")
    envs.go1, _ = walk_training(config.seed, ppo.num_envs, autoreset=False)  # our courses and curriculum
    hidden, progress = list(ppo.hidden), Progress(every=0)
    model = PPO(
        "MlpPolicy",
        VecNormalize(Go1VecEnv(envs), norm_reward=False, clip_obs=5.0),
        learning_rate=config.learning_rate,
        n_steps=ppo.num_steps,
        batch_size=ppo.batch_size // ppo.num_minibatches,
        n_epochs=ppo.update_epochs,
        gamma=ppo.gamma,
        gae_lambda=ppo.gae_lambda,
        clip_range=ppo.clip_coef,
        ent_coef=ppo.ent_coef,
        vf_coef=0.5,
        max_grad_norm=ppo.max_grad_norm,
        policy_kwargs={
            "net_arch": {"pi": hidden, "vf": hidden},
            "activation_fn": torch.nn.ELU,
            "log_std_init": float(np.log(ppo.init_std / envs.go1.config.action_limit)),
        },
        seed=config.seed,
        device="cpu",
    )

    def turn() -> None:
        model.learn(config.turn * ppo.batch_size, progress, reset_num_timesteps=False)
        race.episodes.extend(progress.waypoints)
        progress.waypoints.clear()
        race.steps = model.num_timesteps

    return turn


def main(config: Config) -> None:
    require("stable_baselines3", "Stable-Baselines3")
    started = machine()
    ours, theirs = Race("agility_ref"), Race("stable-baselines3", config.their_threads)
    turns = [(ours, our_turns(ours, config)), (theirs, their_turns(theirs, config))]
    while running := [(race, turn) for race, turn in turns if race.reached_steps is None and race.steps < config.steps]:
        for race, turn in running:
            torch.set_num_threads(race.threads)
            start = time.perf_counter()
            turn()
            race.seconds += time.perf_counter() - start
            race.threads = torch.get_num_threads()  # ours chooses its own when it starts
            if race.waypoint_fraction() >= config.goal:
                race.reached_steps, race.reached_seconds = race.steps, race.seconds
    figures = {race.name: race.figures() for race, _ in turns}
    figures["steps_per_second_ratio"] = (ours.steps / ours.seconds) / (theirs.steps / theirs.seconds)
    if ours.reached_seconds and theirs.reached_seconds:
        figures["wall_time_ratio"] = ours.reached_seconds / theirs.reached_seconds
    rows = [
        {
            "PPO": race.name,
            "steps/s": f"{race.steps / race.seconds:.0f}",
            f"steps to {config.goal}": race.reached_steps or f"not in {race.steps}",
            "wall [s]": f"{race.reached_seconds:.0f}" if race.reached_seconds else "-",
            "waypoints at the end": f"{race.waypoint_fraction():.2f}",
        }
        for race, _ in turns
    ]
    report(config.json, started, {"config": asdict(config), **figures}, rows)


if __name__ == "__main__":
    start(main, Config)

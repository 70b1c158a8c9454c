"""PPO of Stable-Baselines3 on all robots of one simulator.

    pip install "agility-ref[gym]" stable-baselines3
    python examples/sb3_ppo.py --steps 2000000

:class:`Go1VecEnv` is the whole connection: Gymnasium's vector environment, resetting in the same
step, as the VecEnv that Stable-Baselines3 trains on.  Everything else is Stable-Baselines3's own.
"""

import agility_ref.gym  # noqa: F401  registers the ids, and comes before numpy

# isort: split

import time
from dataclasses import dataclass
from pathlib import Path

from agility_ref.env import TRAINING
from agility_ref.terrain import NUM_WAYPOINTS

import gymnasium
import numpy as np
import torch
import tyro
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecNormalize


@dataclass(frozen=True)
class Config:
    """Train PPO of Stable-Baselines3."""

    id: str = "Go1Walk-v0"
    """Environment; also Go1ClimbUp, Go1ClimbDown, Go1Climb, Go1Gap, Go1Beam and Go1ClimbGap, all -v0."""
    difficulty: tuple[float, float] = (0.0, 0.4)
    """Courses are spread evenly between these two."""
    steps: int = 2_000_000
    """Environment steps of all robots together."""
    num_envs: int = 256
    """Robots in the simulator."""
    seed: int = 0
    """Of episodes, networks and exploration."""
    out: str = ""
    """Folder for model.zip and normalizer.pkl; nothing is kept by default."""


class Go1VecEnv(VecEnv):
    """A vector environment of Gymnasium in mode SAME_STEP, as Stable-Baselines3 wants it.

    The info of a robot whose episode ended has ``terminal_observation``, ``TimeLimit.truncated``,
    ``is_success``, ``waypoints`` (0 to 1) and ``episode`` (r, l, t); all others are empty.
    """

    def __init__(self, envs: gymnasium.vector.VectorEnv):
        self.envs, self._started = envs, time.monotonic()
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> np.ndarray:
        """Start new episodes."""
        obs, _ = self.envs.reset(seed=self._seeds[0])
        self._reset_seeds()
        return obs

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions for the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict]]:
        """Advance every robot."""
        obs, reward, terminated, truncated, info = self.envs.step(self._actions)
        done = terminated | truncated
        infos: list[dict] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(done):
            last = info["final_info"]
            totals = {name: values[i] for name, values in last["totals"].items() if not name.startswith("_")}
            infos[i] = {
                "terminal_observation": info["final_obs"][i],
                "TimeLimit.truncated": bool(truncated[i]),
                "is_success": bool(last["is_success"][i]),
                "waypoints": totals["waypoints"] / NUM_WAYPOINTS,
                "episode": {"r": totals["reward"], "l": totals["length"], "t": time.monotonic() - self._started},
            }
        return obs, reward, done, infos

    def close(self) -> None:
        """Close the simulator."""
        self.envs.close()

    def get_attr(self, name, indices=None):
        """Return an attribute of the simulator, once for each robot; all share it."""
        return [getattr(self.envs, name)] * len(list(self._get_indices(indices)))

    def set_attr(self, name, value, indices=None):
        """Robots share one simulator and cannot differ in an attribute."""
        raise NotImplementedError("the robots share one simulator")

    def env_method(self, name, *args, indices=None, **kwargs):
        """Robots share one simulator and have no methods of their own."""
        raise NotImplementedError("the robots share one simulator")

    def env_is_wrapped(self, wrapper_class, indices=None):
        """No robot is wrapped."""
        return [False] * len(list(self._get_indices(indices)))


class Progress(BaseCallback):
    """Collect the waypoint fractions of the episodes that end; print their mean now and then."""

    def __init__(self, every: int = 10):
        super().__init__()
        self.every = every  # rollouts between two lines, 0 for none
        self.waypoints: list[float] = []
        self._rollouts = 0

    def _on_step(self) -> bool:
        self.waypoints += [info["waypoints"] for info in self.locals["infos"] if info]
        return True

    def _on_rollout_end(self) -> None:
        self._rollouts += 1
        if self.every and self._rollouts % self.every == 0 and self.waypoints:
            print(f"{self.num_timesteps:9} steps   waypoints {np.mean(self.waypoints[-100:]):.2f}", flush=True)


def main(config: Config) -> float:
    """Train; return the waypoint fraction of the last 100 episodes."""
    torch.set_num_threads(1)
    robots = gymnasium.make_vec(
        config.id, num_envs=config.num_envs, difficulty=config.difficulty, config=TRAINING, autoreset_mode="SameStep"
    )
    # epsilon: on nearly flat ground the 132 scandots would else be blown up to noise of size 1
    envs = VecNormalize(Go1VecEnv(robots), norm_reward=False, clip_obs=5.0, epsilon=0.1**2)
    model = PPO(
        "MlpPolicy", envs, learning_rate=lambda left: 1e-3 * left, n_steps=16, batch_size=1024, n_epochs=4, gamma=0.98,
        ent_coef=0.005, max_grad_norm=1.0, target_kl=0.1, seed=config.seed, device="cpu",
        policy_kwargs={
            "net_arch": [256, 128],
            "activation_fn": torch.nn.ELU,
            "log_std_init": float(np.log(0.2)),  # an action of 1 is 1.2 rad: 0.2 explores by 0.24 rad
        },
    )  # fmt: skip
    progress = Progress()
    start = time.perf_counter()
    model.learn(config.steps, progress)
    reached = float(np.mean(progress.waypoints[-100:])) if progress.waypoints else 0.0
    print(f"{model.num_timesteps} steps in {time.perf_counter() - start:.0f} s: waypoints {reached:.2f}")
    if config.out:
        Path(config.out).mkdir(parents=True, exist_ok=True)
        model.save(Path(config.out) / "model.zip")
        envs.save(str(Path(config.out) / "normalizer.pkl"))
    envs.close()
    return reached


if __name__ == "__main__":
    main(tyro.cli(Config))

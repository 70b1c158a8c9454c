"""PPO of TorchRL, all robots in one ``GymWrapper``.

    pip install "agility-ref[gym]" torchrl
    python examples/torchrl_ppo.py --steps 2000000

The vector environment is wrapped in mode DISABLED, in which TorchRL resets the robots that are done,
through ``reset_mask``.  Collector, advantages and loss are TorchRL's own.
"""

import agility_ref.gym  # noqa: F401  registers the ids, and comes before numpy

# isort: split

import time
from collections import deque
from dataclasses import dataclass

from agility_ref.env import TRAINING
from agility_ref.terrain import NUM_WAYPOINTS

import gymnasium
import numpy as np
import torch
import tyro
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import Unbounded
from torchrl.envs import GymWrapper, TransformedEnv, VecNormV2
from torchrl.envs.gym_like import BaseInfoDictReader
from torchrl.modules import IndependentNormal, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE


@dataclass(frozen=True)
class Config:
    """Train PPO of TorchRL."""

    id: str = "Go1Walk-v0"
    """Environment; also Go1ClimbUp, Go1ClimbDown, Go1Climb, Go1Gap, Go1Beam and Go1ClimbGap, all -v0."""
    difficulty: tuple[float, float] = (0.0, 0.4)
    """Courses are spread evenly between these two."""
    steps: int = 2_000_000
    """Environment steps of all robots together."""
    num_envs: int = 256
    """Robots in the simulator."""
    num_steps: int = 16
    """Steps of every robot between two updates."""
    seed: int = 0
    """Of episodes, networks and exploration."""


class ReadWaypoints(BaseInfoDictReader):
    """Keep the number of waypoints that each robot has reached in its episode."""

    def __init__(self, num_envs: int):
        self.info_spec = {"waypoints": Unbounded((num_envs,), dtype=torch.int64)}

    def __call__(self, info: dict, tensordict):
        """Write ``waypoints`` (N,); zero after a reset, whose info is empty."""
        totals = info.get("totals", {"waypoints": np.zeros(self.info_spec["waypoints"].shape, np.int64)})
        return tensordict.set("waypoints", torch.from_numpy(totals["waypoints"]))

    @property
    def info_spec(self) -> dict:
        """Shapes of what is written."""
        return self._info_spec

    @info_spec.setter
    def info_spec(self, spec: dict) -> None:
        self._info_spec = spec


def mlp(outputs: int) -> nn.Sequential:
    """Return an ELU network of the widths that the other examples have."""
    return nn.Sequential(nn.LazyLinear(256), nn.ELU(), nn.Linear(256, 128), nn.ELU(), nn.Linear(128, outputs))


def main(config: Config) -> float:
    """Train; return the waypoint fraction of the last 100 episodes."""
    torch.set_num_threads(1)
    torch.manual_seed(config.seed)
    envs = gymnasium.make_vec(
        config.id, num_envs=config.num_envs, difficulty=config.difficulty, config=TRAINING, autoreset_mode="Disabled"
    )
    wrapped = GymWrapper(envs).set_info_dict_reader(ReadWaypoints(config.num_envs))
    wrapped.set_seed(config.seed)
    env = TransformedEnv(wrapped, VecNormV2(in_keys=["observation"], decay=0.9999))

    act_dim = envs.single_action_space.shape[0]
    scale = NormalParamExtractor(scale_mapping="biased_softplus_0.2")  # an action of 1 is 1.2 rad
    actor = ProbabilisticActor(
        TensorDictModule(nn.Sequential(mlp(2 * act_dim), scale), ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"], distribution_class=IndependentNormal, return_log_prob=True,
    )  # fmt: skip
    critic = ValueOperator(mlp(1), in_keys=["observation"])
    batch_size = config.num_envs * config.num_steps
    collector = Collector(
        env, actor, frames_per_batch=batch_size, total_frames=-(-config.steps // batch_size) * batch_size
    )
    warm = env.fake_tensordict()
    actor(warm), critic(warm)  # the lazy layers learn their widths
    advantage = GAE(gamma=0.98, lmbda=0.95, value_network=critic)
    loss_module = ClipPPOLoss(
        actor, critic, clip_epsilon=0.2, entropy_coeff=0.005, critic_coeff=0.5, normalize_advantage=True
    )
    optimizer = torch.optim.Adam(loss_module.parameters(), 3e-4)

    waypoints: deque[float] = deque(maxlen=100)
    start, steps = time.perf_counter(), 0
    for iteration, batch in enumerate(collector, 1):
        steps += batch.numel()
        ended = batch["next", "done"].squeeze(-1)
        waypoints.extend((batch["next", "waypoints"][ended] / NUM_WAYPOINTS).tolist())
        with torch.no_grad():
            advantage(batch)
        flat = batch.reshape(-1)
        for _ in range(4):
            for mb in torch.randperm(len(flat)).chunk(4):
                losses = loss_module(flat[mb])
                optimizer.zero_grad()
                (losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]).backward()
                nn.utils.clip_grad_norm_(loss_module.parameters(), 1.0)
                optimizer.step()
        if iteration % 10 == 0 and waypoints:
            print(f"{steps:9} steps   waypoints {np.mean(waypoints):.2f}", flush=True)
    reached = float(np.mean(waypoints)) if waypoints else 0.0
    print(f"{steps} steps in {time.perf_counter() - start:.0f} s: waypoints {reached:.2f}")
    collector.shutdown()
    return reached


if __name__ == "__main__":
    main(tyro.cli(Config))

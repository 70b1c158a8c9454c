"""Learner: everything that training changes, and how it is saved and resumed.

Network, observation normaliser, optimisers, step size, counters.  In: sizes and a
:class:`~agility_ref.policies.PPOConfig`.  Out: arrays for a checkpoint, and back.
"""

from dataclasses import dataclass, field

import numpy as np
import torch

from agility_ref.errors import UserError
from agility_ref.networks import ActorCritic, Gaussian, Normalizer
from agility_ref.observation import SCANDOT_STD
from agility_ref.policies import PPOConfig


@dataclass
class Learner:
    """What training changes: network, normaliser, optimiser, counters."""

    net: ActorCritic
    normalizer: Normalizer
    config: PPOConfig
    distribution: type = Gaussian
    seed: int = 0
    learning_rate: float = field(init=False)
    steps: int = 0
    """Environment steps so far, warm start included."""
    start: int = 0
    """Of these, the warm start's."""
    actor_start: int = 0
    """Environment steps up to which the critic learns alone, see :meth:`warm_start`."""
    anneal: float = 1.0
    """Factor of KL target and lowest step size; see :func:`schedule`."""

    def __post_init__(self):
        self.learning_rate = self.config.learning_rate
        # Actor and critic share no weights: each has its optimiser and its gradient norm, so the
        # weight of the value loss in the textbook's sum has nothing left to balance.
        actor = [*self.net.actor.parameters(), self.net.log_std]
        self.actor_optimizer = torch.optim.Adam(actor, self.learning_rate, fused=True)
        self.critic_optimizer = torch.optim.Adam(self.net.critic.parameters(), self.learning_rate, fused=True)
        self.generator = torch.Generator().manual_seed(self.seed)

    @property
    def actor_rests(self) -> bool:
        """Whether the critic still learns alone."""
        return self.steps < self.actor_start

    @classmethod
    def create(
        cls,
        obs_dim: int,
        act_dim: int,
        config: PPOConfig,
        seed: int,
        distribution: type = Gaussian,
        fixed: slice = slice(0, 0),
    ) -> "Learner":
        """Start from scratch; ``fixed`` observations are not normalised but divided by SCANDOT_STD."""
        torch.manual_seed(seed)
        net = ActorCritic(obs_dim, act_dim, config.hidden, config.init_std)
        return cls(net, Normalizer(obs_dim, fixed, SCANDOT_STD), config, distribution, seed)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the network and the normaliser, as checkpoints hold them."""
        n = self.normalizer
        arrays = {name: p.detach().numpy().copy() for name, p in self.net.named_parameters()}
        return arrays | {
            "normalizer.mean": n.mean.copy(), "normalizer.var": n.var.copy(), "normalizer.count": np.array(n.count)
        }  # fmt: skip

    def training_arrays(self) -> dict[str, np.ndarray]:
        """Return what resuming needs beyond :meth:`arrays`: Adam's moments, the rate, when the actor starts."""
        state = {
            "optimizer.learning_rate": np.array(self.learning_rate),
            "optimizer.actor_start": np.array(self.actor_start),
        }
        for name, parameter in self.net.named_parameters():
            for key, value in self._optimizer(name).state.get(parameter, {}).items():
                state[f"optimizer.{name}.{key}"] = value.numpy().copy()
        return state

    def _optimizer(self, parameter_name: str) -> torch.optim.Adam:
        return self.critic_optimizer if parameter_name.startswith("critic.") else self.actor_optimizer

    def load_arrays(self, arrays: dict[str, np.ndarray]) -> None:
        """Copy :meth:`arrays`, and :meth:`training_arrays` where present, into this learner.

        Raises
        ------
        UserError : the arrays are those of another network
        """
        with torch.no_grad():
            for name, parameter in self.net.named_parameters():
                shape = arrays[name].shape if name in arrays else None
                if shape != tuple(parameter.shape):
                    raise UserError(f"checkpoint has {name} of shape {shape}, this network {tuple(parameter.shape)}")
                parameter.copy_(torch.from_numpy(arrays[name]))
        n = self.normalizer
        n.mean[:], n.var[:] = arrays["normalizer.mean"], arrays["normalizer.var"]
        n.count = float(arrays["normalizer.count"])
        self.learning_rate = float(arrays.get("optimizer.learning_rate", self.learning_rate))
        self.actor_start = int(arrays.get("optimizer.actor_start", self.actor_start))
        for name, parameter in self.net.named_parameters():
            keys = ("step", "exp_avg", "exp_avg_sq")
            if f"optimizer.{name}.step" in arrays:
                self._optimizer(name).state[parameter] = {
                    key: torch.from_numpy(arrays[f"optimizer.{name}.{key}"].copy()) for key in keys
                }

    def warm_start(self, arrays: dict[str, np.ndarray], steps: int, std: float, critic_steps: int = 0) -> None:
        """Go on from another policy's network after its ``steps``, with a fresh optimiser and exploration noise ``std``.

        A policy that was not learned from rewards has no critic.  The values of a new one would
        ruin its actor, which therefore rests for the first ``critic_steps`` environment steps, and
        starts with small ones.
        """
        self.steps = self.start = self.actor_start = steps
        if not any(name.startswith("critic.") for name in arrays):
            self.actor_start += critic_steps
            self.learning_rate = self.config.learning_rate_min
        own = {name: array for name, array in self.arrays().items() if not name.startswith(("actor.", "normalizer."))}
        self.load_arrays(own | {name: a for name, a in arrays.items() if not name.startswith("optimizer.")})
        self.net.log_std.data.fill_(float(np.log(std)))

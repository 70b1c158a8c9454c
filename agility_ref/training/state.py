"""State: a learner as the arrays of a checkpoint, to act from, to go on from, or to start another policy from.

In:  a :class:`~agility_ref.ppo.Learner`.  Out: a dict of arrays; and back.
"""

from agility_ref.errors import UserError
from agility_ref.ppo import Learner

import numpy as np
import torch

MOMENTS = ("step", "exp_avg", "exp_avg_sq")  # what Adam remembers of each parameter


def policy_arrays(learner: Learner) -> dict[str, np.ndarray]:
    """Return what acts, as :class:`~agility_ref.policy.Policy` reads it: dense layers and the normaliser."""
    norm = learner.normalizer
    actor = {f"actor.{name}": array for name, array in learner.net.actor.dense().items()}
    return actor | {"normalizer.mean": norm.mean.copy(), "normalizer.var": norm.var.copy()}


def learner_state(learner: Learner) -> dict[str, np.ndarray]:
    """Return what going on takes beyond :func:`policy_arrays`: weights in blocks, Adam's moments, counters, noise."""
    state = {
        "normalizer.count": np.array(learner.normalizer.count),
        "optimizer.learning_rate": np.array(learner.learning_rate),
        "optimizer.actor_start": np.array(learner.actor_start),
        "optimizer.generator": learner.generator.get_state().numpy(),
    }
    for name, parameter in learner.net.named_parameters():
        state[f"net.{name}"] = parameter.detach().numpy().copy()
        for key, value in _optimizer(learner, name).state.get(parameter, {}).items():
            state[f"optimizer.{name}.{key}"] = value.numpy().copy()
    return state


def load_learner(learner: Learner, arrays: dict[str, np.ndarray]) -> None:
    """Copy :func:`policy_arrays` and :func:`learner_state` into a learner.

    Raises
    ------
    UserError : the arrays are those of another network
    """
    _load_network(learner, arrays)
    learner.learning_rate = float(arrays["optimizer.learning_rate"])
    learner.actor_start = int(arrays["optimizer.actor_start"])
    learner.generator.set_state(torch.from_numpy(arrays["optimizer.generator"].copy()))
    for name, parameter in learner.net.named_parameters():
        if f"optimizer.{name}.step" in arrays:  # an actor that has rested so far has none
            moments = {key: torch.from_numpy(arrays[f"optimizer.{name}.{key}"].copy()) for key in MOMENTS}
            _optimizer(learner, name).state[parameter] = moments


def warm_start(learner: Learner, arrays: dict[str, np.ndarray], steps: int, std: float, critic_steps: int = 0) -> None:
    """Go on from another policy's network after its ``steps``, with a fresh optimiser and exploration noise ``std``.

    A policy that was not learned from rewards has no critic.  The values of a new one would ruin
    its actor, which therefore rests for the first ``critic_steps`` environment steps, and starts
    with small ones.
    """
    learner.steps = learner.start = learner.actor_start = steps
    own = {"net.log_std": learner.net.log_std.detach().numpy()}
    if not any(name.startswith("net.critic.") for name in arrays):
        learner.actor_start += critic_steps
        learner.learning_rate = learner.config.learning_rate_min
        own |= {f"net.critic.{name}": p.detach().numpy() for name, p in learner.net.critic.named_parameters()}
    _load_network(learner, arrays | own)
    learner.net.log_std.data.fill_(float(np.log(std)))


def _optimizer(learner: Learner, parameter_name: str) -> torch.optim.Adam:
    return learner.critic_optimizer if parameter_name.startswith("critic.") else learner.actor_optimizer


@torch.no_grad()
def _load_network(learner: Learner, arrays: dict[str, np.ndarray]) -> None:
    """Copy weights and normaliser."""
    for name, parameter in learner.net.named_parameters():
        shape = arrays[f"net.{name}"].shape if f"net.{name}" in arrays else None
        if shape != tuple(parameter.shape):
            raise UserError(f"checkpoint has net.{name} of shape {shape}, this network {tuple(parameter.shape)}")
        parameter.copy_(torch.from_numpy(arrays[f"net.{name}"].copy()))
    norm = learner.normalizer
    norm.mean[:], norm.var[:] = arrays["normalizer.mean"], arrays["normalizer.var"]
    norm.count = float(arrays["normalizer.count"])

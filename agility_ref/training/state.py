"""State: a training run as the arrays of a checkpoint: to act from, to go on from, to start another policy from.

A stopped run that goes on is the run that was not stopped, to the last bit: weights, Adam's moments
and step sizes, where the robots are in their episodes, which courses come next, and where every
random stream is.

In:  a learner, its robots, their curriculum.  Out: a dict of arrays; and back.
"""

from pathlib import Path

from agility_ref.curriculum import Curriculum
from agility_ref.env import Go1Env
from agility_ref.errors import UserError
from agility_ref.files import pack_stream, unpack_stream
from agility_ref.ppo import Learner
from agility_ref.terrain import NUM_WAYPOINTS
from agility_ref.training.progress import EPISODE

import numpy as np
import torch

# What the next step of Go1Env depends on, beside the physics and the random streams.
ENVIRONMENT = (
    "course", "waypoint_index", "command", "yaw", "base_lin_vel", "projected_gravity", "heading_error", "foot_contact",
    "push_timer", "_reach_timer", "_reach_step", "_step_count", "_last_action", "_scandots", "_clock",
    "_episode_reward", "_episode_edge", "observation",
)  # fmt: skip
CURRICULUM = ("frontier", "score", "kind", "level")  # what its next course depends on
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


def robots_state(env: Go1Env, curriculum: Curriculum) -> dict[str, np.ndarray]:
    """Return where the robots are, and which courses come next."""
    state = {name: array.copy() for name, array in _live(env, curriculum).items()}
    streams = {name: pack_stream(rng) for name, rng in _streams(env, curriculum).items()}
    return state | streams | {"env.physics": env.simulation.batch.state.copy()}


def _live(env: Go1Env, curriculum: Curriculum) -> dict[str, np.ndarray]:
    """Return the arrays themselves: writing to one changes the robots or the curriculum."""
    parts = (("env", env, ENVIRONMENT), ("curriculum", curriculum, CURRICULUM))
    return {f"{part}.{name.strip('_')}": getattr(x, name) for part, x, names in parts for name in names}


def _streams(env: Go1Env, curriculum: Curriculum) -> dict[str, np.random.Generator]:
    return {"env.rng": env.rng, "env.disturbance_rng": env._disturbance_rng, "curriculum.rng": curriculum.rng}


def load_robots(env: Go1Env, curriculum: Curriculum, arrays: dict[str, np.ndarray]) -> None:
    """Put the robots where :func:`robots_state` found them; ``env.observation`` is what they saw last.

    Raises
    ------
    UserError : a robot or a frontier is on no course of this world
    """
    levels = curriculum.config.num_levels
    ends = {
        "env.course": len(env.world), "env.waypoint_index": NUM_WAYPOINTS, "curriculum.kind": len(curriculum.frontier),
        "curriculum.level": levels, "curriculum.frontier": levels,
    }  # fmt: skip
    for name, end in ends.items():
        if arrays[name].min() < 0 or arrays[name].max() >= end:
            raise UserError(f"{name} of the checkpoint must be from 0 to {end - 1}")
    for name, array in _live(env, curriculum).items():
        array[...] = arrays[name]
    env.simulation.load_state(env.course, arrays["env.physics"])
    for name, rng in _streams(env, curriculum).items():
        unpack_stream(rng, arrays[name])


def go_on(arrays: dict[str, np.ndarray], learner: Learner, env: Go1Env, curriculum: Curriculum) -> None:
    """Put everything where :func:`learner_state` and :func:`robots_state` found it.

    Raises
    ------
    UserError : the arrays cannot be those of a run
    """
    load_robots(env, curriculum, arrays)
    load_learner(learner, arrays)


def load_learner(learner: Learner, arrays: dict[str, np.ndarray]) -> None:
    """Copy :func:`policy_arrays` and :func:`learner_state` into a learner.

    Raises
    ------
    UserError : the arrays are those of another network, or hold no random stream
    """
    _load_network(learner, arrays)
    learner.learning_rate = float(arrays["optimizer.learning_rate"])
    learner.actor_start = int(arrays["optimizer.actor_start"])
    try:
        learner.generator.set_state(torch.from_numpy(arrays["optimizer.generator"].copy()))
    except RuntimeError as error:
        raise UserError(f"the checkpoint has no state of a random stream ({str(error).splitlines()[0]})") from None
    for name, parameter in learner.net.named_parameters():
        if f"optimizer.{name}.step" in arrays:  # an actor that has rested so far has none
            moments = {key: torch.from_numpy(arrays[f"optimizer.{name}.{key}"].copy()) for key in MOMENTS}
            _optimizer(learner, name).state[parameter] = moments


def check_arrays(
    saved: Path, arrays: dict[str, np.ndarray], learner: Learner, env: Go1Env, curriculum: Curriculum
) -> None:
    """Refuse a checkpoint that training cannot go on from: every array is to be there, of its shape and type.

    Parameters
    ----------
    saved : the file
    arrays : its contents
    learner, env, curriculum : of the same run at its beginning

    Raises
    ------
    UserError : names the array
    """
    like = policy_arrays(learner) | learner_state(learner) | robots_state(env, curriculum)
    for name, parameter in learner.net.named_parameters():
        if f"optimizer.{name}.step" in arrays:
            moment = parameter.detach().numpy()
            like |= {f"optimizer.{name}.{key}": moment for key in ("exp_avg", "exp_avg_sq")}
            like[f"optimizer.{name}.step"] = np.zeros((), np.float32)
    for name, array in like.items():
        if name not in arrays:
            raise UserError(
                f"{saved} can act but not be trained further: it lacks the state of a training run ({name})"
            )
        if (arrays[name].shape, arrays[name].dtype) != (array.shape, array.dtype):
            found = f"{arrays[name].dtype} of shape {arrays[name].shape}"
            raise UserError(f"{saved}: {name} is {found}, this run needs {array.dtype} of {array.shape}")
    if arrays.get("progress.episodes", np.zeros(0)).shape[1:] != (len(EPISODE),):
        raise UserError(f"{saved} can act but not be trained further: it lacks the state of its averages")


def has_blocks(arrays: dict[str, np.ndarray]) -> bool:
    """Whether a checkpoint holds the blocks of a symmetric actor, from which training can start."""
    return any(name.startswith("net.actor.own.") for name in arrays)


def warm_start(learner: Learner, arrays: dict[str, np.ndarray], steps: int, std: float, critic_steps: int = 0) -> None:
    """Go on from another policy's network after its ``steps``, with a fresh optimiser and exploration noise ``std``.

    A policy that was not learned from rewards has no critic.  The values of a new one would at first ruin
    the actor, which therefore rests for ``critic_steps`` environment steps and then starts with
    the smallest step size.
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

"""Resume: the part of a checkpoint with which a stopped run is the run that was not stopped, to the last bit.

The weights, Adam's moments and the step sizes are the learner's own arrays.  To them come where
the robots are in their episodes, which courses come next, and where every random stream is.

In:  what trains: a learner, its robots, their curriculum.  Out: arrays, and what trains put back by them.
"""

from pathlib import Path

import numpy as np
import torch

from agility_ref.curriculum import Curriculum
from agility_ref.env import Go1Env
from agility_ref.errors import UserError
from agility_ref.ppo import Learner
from agility_ref.selector import SelectorEnv
from agility_ref.training.progress import EPISODE


def going_on(learner: Learner, env: Go1Env | SelectorEnv, curriculum: Curriculum) -> dict[str, np.ndarray]:
    """Return what a checkpoint holds beside the learner's own arrays."""
    parts = {"env": env.state(), "curriculum": curriculum.state()}
    arrays = {f"{part}.{name}": array for part, state in parts.items() for name, array in state.items()}
    return arrays | {"learner.generator": learner.generator.get_state().numpy().view(np.int64)}


def go_on(arrays: dict[str, np.ndarray], learner: Learner, env: Go1Env | SelectorEnv, curriculum: Curriculum) -> None:
    """Put everything where :func:`going_on` found it.

    Raises
    ------
    UserError : the arrays cannot be those of a run
    """
    for part, owner in (("env.", env), ("curriculum.", curriculum)):
        owner.load_state({n.removeprefix(part): array for n, array in arrays.items() if n.startswith(part)})
    try:
        learner.generator.set_state(torch.from_numpy(arrays["learner.generator"].view(np.uint8)))
    except RuntimeError as error:
        raise UserError(f"the checkpoint has no state of a random stream ({str(error).splitlines()[0]})") from None


def check_arrays(saved: Path, arrays: dict[str, np.ndarray], learner: Learner, state: dict[str, np.ndarray]) -> None:
    """Refuse a checkpoint that training cannot go on from: every array is to be there, of its shape and type.

    Parameters
    ----------
    saved : the file
    arrays : its contents
    learner : that is to go on
    state : of :func:`going_on`, of the same run at its beginning

    Raises
    ------
    UserError : names the array
    """
    network = learner.arrays()
    like = network | state | learner.training_arrays()
    for name in network:
        if f"optimizer.{name}.step" in arrays:
            like |= {f"optimizer.{name}.{key}": network[name] for key in ("exp_avg", "exp_avg_sq")}
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

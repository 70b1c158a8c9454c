"""Limits: the settings that a training run can be made with.

In:  a :class:`~agility_ref.training.runs.TrainConfig`.  Out: nothing, or an error that names the flag.
"""

import math
from dataclasses import asdict
from typing import TYPE_CHECKING

from agility_ref.errors import UserError
from agility_ref.training.bank import as_flags
from agility_ref.training.policies import PolicySpec

if TYPE_CHECKING:
    from agility_ref.training.runs import TrainConfig

# Flag -> the least or most that is allowed: a number, or the flag that holds it.
AT_LEAST: dict[str, float | str] = {
    "seed": 0,
    "steps": 0,
    "ppo.num-steps": 1,
    "ppo.update-epochs": 1,
    "ppo.num-minibatches": 1,
    "ppo.hidden": 1,
    "ppo.gamma": 0,
    "ppo.gae-lambda": 0,
    "ppo.ent-coef": 0,
    "ppo.learning-rate-min": 0,
    "ppo.learning-rate-max": "ppo.learning-rate-min",
    "ppo.critic-learning-rate": 0,
    "ppo.anneal-share": 0,
    "env.physics.substeps": 1,
    "env.physics.iterations": 1,
    "env.physics.kd": 0,
    "env.noise": 0,
    "env.start-noise": 0,
    "env.gait-clock": 0,
    "env.stall-seconds": 0,
    "env.turned-start-share": 0,
    "env.action-repeat": 1,
    "env.scandot-period": 1,
    "env.push-interval": 0,
    "env.payload-high": 0,
    "env.command-high": "env.command-low",
    "env.friction-high": "env.friction-low",
    "curriculum.num-levels": 1,
    "curriculum.variants": 1,
    "selector.decision-steps": 1,
    "selector.switch-cost": 0,
    "selector.ent-coef": 0,
    "supervised.dagger-rounds": 0,
    "supervised.epochs": 1,
    "supervised.batch-size": 1,
    "supervised.hidden": 1,
    "distill.dagger-rounds": 0,
    "distill.action-noise": 0,
    "distill.epochs": 1,
    "distill.batch-size": 1,
    "fine-tune.critic-steps": 0,
    "fine-tune.critic-learning-rate": 0,
    "fine-tune.num-steps": 1,
    "fine-tune.learning-rate-min": 0,
    "fine-tune.anneal-share": 0,
    "fine-tune.ent-coef": 0,
}
ABOVE_ZERO = (
    "ppo.init-std",
    "ppo.final-std",
    "ppo.learning-rate",
    "ppo.clip-coef",
    "ppo.target-kl",
    "ppo.max-grad-norm",
    "warm-std",
    "supervised.learning-rate",
    "distill.learning-rate",
    "fine-tune.std",
    "fine-tune.target-kl",
    "env.physics.timestep",
    "env.physics.kp",
    "env.action-scale",
    "env.action-limit",
    "env.waypoint-radius",
    "env.max-tilt",
    "env.command-low",
    "env.friction-low",
    "env.episode-seconds",
)
AT_MOST: dict[str, float | str] = {
    "seed": 2**63 - 1,  # torch counts no further
    "ppo.gamma": 1,
    "ppo.gae-lambda": 1,
    "ppo.anneal-share": 1,
    "env.turned-start-share": 1,
    "fine-tune.learning-rate-min": "ppo.learning-rate-max",
    "fine-tune.anneal-share": 1,
}


def check_settings(spec: PolicySpec, config: "TrainConfig") -> None:
    """Refuse numbers that no run can be made with.

    Raises
    ------
    UserError : names the flag, what was given and what is allowed
    """
    given = as_flags(asdict(config))
    for flag, value in given.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise UserError(f"{flag} must be a finite number, got {value}")
    for flag in ("ppo.hidden", "supervised.hidden"):
        given[flag] = min(given[flag], default=1)  # the narrowest layer
    robots = {"ppo.num-envs": max(len(spec.courses), 1)}  # one for every kind of course
    for flag, bound in (AT_LEAST | robots).items():
        least = given.get(bound, bound)
        if not given[flag] >= least:
            raise UserError(f"{flag} must be at least {least}, got {given[flag]}")
    for flag in ABOVE_ZERO:
        if not given[flag] > 0:
            raise UserError(f"{flag} must be above 0, got {given[flag]}")
    for flag, bound in (AT_MOST | {"ppo.num-minibatches": config.ppo.batch_size}).items():
        most = given.get(bound, bound)
        if not given[flag] <= most:
            raise UserError(f"{flag} must be at most {most}, got {given[flag]}")

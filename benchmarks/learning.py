"""Training with evaluations on the way: what ``time_to_skill.py`` and ``ablations.py`` share.

A run's ``progress.csv`` says how the exploring robots do on the levels that they have
reached, and a curriculum keeps that between its two thresholds.  Here training stops every
so many steps, its clock too, and the deterministic policy plays complete episodes on the
courses of an evaluation: curves of different recipes can be compared.

The training is that of ``agility-ref train``, to the last bit (tests/test_benchmarks.py).
"""

import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from agility_ref.env import EnvConfig
from agility_ref.errors import UserError
from agility_ref.evaluate import EvaluationConfig, evaluate
from agility_ref.observation import ACTION_MIRROR, OBS_MIRROR, SCANDOTS
from agility_ref.pictures.plots import band, new_figure, style
from agility_ref.policy import Policy
from agility_ref.ppo import Learner, train
from agility_ref.selector import Single
from agility_ref.training.policies import find_policy, requirements
from agility_ref.training.runs import TrainConfig, make_env, ppo_config
from agility_ref.training.state import learner_state, policy_arrays, warm_start

import numpy as np

CURVE_COLUMNS = ("steps", "seconds", "waypoint_fraction", "falls", "level")
Judge = Callable[[Policy], dict[str, float]]
"""A policy -> its waypoint_fraction and falls."""


@dataclass(frozen=True)
class Trained:
    """A policy in or after training, from which another may start."""

    arrays: dict[str, np.ndarray]
    """What acts, and what going on takes."""
    steps: int
    """Environment steps, warm start included."""
    seconds: float
    """Wall time of training, warm start included; neither building the courses nor evaluating counts."""
    curve: list[dict]
    """One entry an evaluation, with CURVE_COLUMNS."""


def check_skill(name: str) -> None:
    """Refuse what PPO does not train from scratch.

    Raises
    ------
    UserError : unknown policy, or one that needs others trained first
    """
    for other in (name, *requirements(name)):
        if find_policy(other).method != "ppo":
            raise UserError(
                f"{name} learns from trained skills; give one that learns to move from scratch, such as walk"
            )


def own_courses(name: str, preset: str, episodes: int, task: EnvConfig = EnvConfig()) -> Judge:
    """Judge by complete episodes on the policy's own courses, d ~ U(0, max), noise and pushes on; the mean over them."""
    courses, config = find_policy(name).courses, EvaluationConfig(episodes, preset=preset)

    def judge(policy: Policy) -> dict[str, float]:
        played = [evaluate(Single(name, policy), course, config, task) for course in courses]
        return {
            "waypoint_fraction": float(np.mean([p.waypoint_fraction.mean() for p in played])),
            "falls": float(np.mean([p.fell.mean() for p in played])),
        }

    return judge


def learn(
    name: str,
    config: TrainConfig,
    total: int,
    judge: Judge | None = None,
    every: int = 0,
    goal: float = math.inf,
    start: Trained | None = None,
) -> Trained:
    """Train one policy as ``agility-ref train`` does.

    Parameters
    ----------
    name : a policy that PPO trains
    config : preset, seed, hyper-parameters, task and levels
    total : environment steps at the end, warm start included
    judge : evaluates the policy at the start, every ``every`` steps and at the end; None for never
    every : environment steps between evaluations
    goal : waypoint fraction at which training ends early
    start : the warm start; None for from scratch

    Raises
    ------
    UserError : nothing is left to train after the warm start
    """
    spec = find_policy(name)
    env, curriculum = make_env(spec, config)
    learner = Learner.create(OBS_MIRROR, ACTION_MIRROR, ppo_config(spec, config), config.seed, fixed=SCANDOTS)
    seconds, curve = 0.0, []
    if start is not None:
        warm_start(learner, start.arrays, start.steps, config.warm_std)
        seconds = start.seconds
    if learner.steps >= total:
        raise UserError(f"{total} steps leave nothing to train: {learner.steps} are spent, warm start included")

    def trained() -> Trained:
        return Trained(policy_arrays(learner) | learner_state(learner), learner.steps, seconds, curve)

    def evaluated() -> bool:
        """Note how the policy does now; say whether the goal is reached."""
        level = float(curriculum.levels().mean()) if config.curriculum.enabled else None
        figures = judge(Policy.from_arrays(policy_arrays(learner), {"policy": name}))
        curve.append({"steps": learner.steps, "seconds": seconds, **figures, "level": level})
        return figures["waypoint_fraction"] >= goal

    following = learner.steps + every if judge else math.inf
    if judge and evaluated():
        return trained()
    clock = time.perf_counter()
    for record in train(env, learner, total):
        if record["steps"] >= following or (judge and record["steps"] >= total):
            seconds += time.perf_counter() - clock
            following += every
            if evaluated():
                break
            clock = time.perf_counter()
    else:
        seconds += time.perf_counter() - clock
    return trained()


def learn_from_scratch(name: str, config: TrainConfig, total: int, judge: Judge, every: int, goal: float) -> Trained:
    """Train a policy and, before it and on the same clock, the warm start that it needs."""
    start = None
    for other in requirements(name) if config.warm_start else ():
        tell(f"{other}, seed {config.seed}: warm start")
        start = learn(other, config, find_policy(other).steps(config.preset), start=start)
    tell(f"{name}, seed {config.seed}")
    return learn(name, config, total, judge, every, goal, start)


def evaluation_task(task: EnvConfig) -> EnvConfig:
    """Return a training task without what only training has: turned starts and an end to standing still."""
    return replace(task, turned_start_share=0.0, stall_seconds=0.0)


def tell(line: str = "") -> None:
    """Say on stderr what is going on, where somebody watches; an empty line clears it."""
    if sys.stderr.isatty():
        print(f"\r{line:70}" + "\r" * (not line), end="", file=sys.stderr, flush=True)


# ---------------------------------------------------------------------------- curves


def draw_curves(axis, label: str, curves: list[list[dict]], colour: str, x: str = "steps", unit: float = 1e-6) -> None:
    """Draw the waypoint fraction of every seed, and their IQM with a 95 % band where there are several.

    Parameters
    ----------
    axis : of matplotlib
    label : of the line in the legend
    curves : one a seed, as in :class:`Trained`
    colour : of all its lines
    x : column along the axis
    unit : what x is multiplied with
    """
    lines = [np.array([[point[x] * unit, point["waypoint_fraction"]] for point in curve]).T for curve in curves]
    alone = len(lines) == 1
    for line in lines:
        axis.plot(*line, color=colour, linewidth=2.4 if alone else 0.8, alpha=1.0 if alone else 0.6)
    if not alone:
        begin, end = max(line[0, 0] for line in lines), min(line[0, -1] for line in lines)
        grid = np.linspace(begin, end, 60)
        middle, low, high = band(np.stack([np.interp(grid, *line) for line in lines]))
        axis.fill_between(grid, low, high, color=colour, alpha=0.2, linewidth=0)
        axis.plot(grid, middle, color=colour, linewidth=2.4)
    axis.plot([], [], color=colour, linewidth=2.4, label=label)


def curve_grid(rows: int, columns: int, size: tuple[float, float]):
    """Return (figure, axes) for waypoint fractions."""
    with style():
        figure, axes = new_figure(rows, columns, size)
        for axis in axes.flat:
            axis.set(ylim=(0.0, 1.02))
            axis.set_xlabel("environment steps [million]")
        for axis in axes[:, 0]:
            axis.set_ylabel("waypoint fraction")
        return figure, axes

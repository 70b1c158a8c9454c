"""Diagnosis: what a selector chooses, where it errs, and what its errors cost.

Paper section 4.3: selectors keep switching, or collapse into one skill.  In: a
:class:`~agility_ref.trace.Trace` of a selector, and of the oracle on the same episodes.
Out: accuracy, confusion, flicker, collapse, places, regret; JSON-ready.

A wrong choice is one that is not the oracle's, which need not be one that fails: only the
regret says what it cost.
"""

import numpy as np

from agility_ref.evaluate import oracle_accuracy, switches_per_second
from agility_ref.odd_behaviours import odd_behaviours
from agility_ref.stats import bootstrap_interval, paired_difference
from agility_ref.terrain import SKILLS
from agility_ref.trace import Trace

OFFSETS = np.linspace(-1.5, 2.0, 36)  # [m] borders of the 0.1 m bins around an obstacle

# ---------------------------------------------------------------------------- choices


def confusion(skill: np.ndarray, oracle: np.ndarray, num_skills: int) -> np.ndarray:
    """Count steps by the skill wanted (rows) and the skill chosen (columns)."""
    counts = np.zeros((num_skills, num_skills), int)
    np.add.at(counts, (oracle[skill >= 0], skill[skill >= 0]), 1)
    return counts


def commonest(skill: np.ndarray) -> tuple[int, float]:
    """Skill that acts in most steps of all episodes, and its share of them: 1 is a collapse into one mode."""
    counts = np.bincount(skill[skill >= 0])
    return int(counts.argmax()), float(counts.max() / counts.sum())


# ---------------------------------------------------------------------------- places


def nearest_obstacle(trace: Trace) -> tuple[np.ndarray, np.ndarray]:
    """Where each step is, seen from the obstacle whose span is nearest.

    Returns
    -------
    offset : (T, N) x minus the x at which that obstacle begins [m]; NaN on a course without
    kind : (T, N) the skill it needs, index into SKILLS
    """
    x = trace.position[:, :, 0]
    offset, kind, least = np.full(x.shape, np.nan), np.zeros(x.shape, int), np.full(x.shape, np.inf)
    for k, skill in enumerate(SKILLS):
        for x0, x1 in np.moveaxis(trace.spans(skill), (1, 2), (0, 1)):
            # distance from x to the span [x0, x1], 0 inside it
            distance = np.maximum(np.maximum(x0 - x, x - x1), 0.0)
            nearer = distance < least  # never where the span is NaN
            least[nearer] = distance[nearer]
            offset[nearer] = (x - x0)[nearer]
            kind[nearer] = k
    return offset, kind


def profile(offset: np.ndarray, kind: np.ndarray, steps: np.ndarray, borders: np.ndarray = OFFSETS) -> np.ndarray:
    """Count the steps marked in ``steps`` (T, N) by kind of obstacle and place: (5, bins)."""
    return np.stack([np.histogram(offset[steps & (kind == k)], borders)[0] for k in range(len(SKILLS))])


def wrong_share(trace: Trace) -> np.ndarray:
    """Share of the time in each place that was spent on a wrong skill, by kind of obstacle: (5, bins).

    Every episode that came to a place counts once there, however long it stood; NaN where none came.
    """
    offset, kind = nearest_obstacle(trace)
    episodes = [np.s_[:, [n]] for n in range(len(trace.courses))]
    wrong = np.stack([profile(offset[n], kind[n], trace.wrong[n]) for n in episodes])
    steps = np.stack([profile(offset[n], kind[n], trace.skill[n] >= 0) for n in episodes])
    came = (steps > 0).sum(axis=0)
    return np.where(came > 0, (wrong / np.maximum(steps, 1)).sum(axis=0) / np.maximum(came, 1), np.nan)


# ---------------------------------------------------------------------------- everything


def mean_interval(values: np.ndarray) -> dict[str, float]:
    """Mean over episodes (N,) and its 95 % interval."""
    low, high = bootstrap_interval(values, np.mean)
    return {"mean": float(values.mean()), "low": low, "high": high}


def regret(trace: Trace, oracle: Trace) -> dict[str, float]:
    """Waypoint fraction that the oracle reaches beyond the policy's, on the same episodes, with its 95 % interval."""
    mean, low, high = paired_difference(oracle.waypoint_fraction, trace.waypoint_fraction)
    return {"mean": mean, "low": low, "high": high}


def measure(trace: Trace, oracle: Trace, same_skills: Trace) -> dict:
    """Measure a policy on one environment; JSON-ready.

    Parameters
    ----------
    trace : the policy's episodes
    oracle : the same episodes played by the oracle of Table 1, over five skills
    same_skills : ... and by the oracle over the skills that the policy has: the regret
        against it is the selector's own, the rest is due to the skills
    """
    counts = confusion(trace.skill, trace.oracle, len(trace.skills))
    most, most_share = commonest(trace.skill)
    offset, kind = nearest_obstacle(trace)
    alive, share = trace.skill >= 0, wrong_share(trace)
    return {
        "policy": trace.policy,
        "environment": trace.environment,
        "episodes": len(trace.courses),
        "environment_steps": int(alive.sum()),
        "skills": list(trace.skills),
        "accuracy": mean_interval(oracle_accuracy(trace.skill, trace.oracle)),
        "confusion": counts.tolist(),
        "switches_per_second": mean_interval(switches_per_second(trace.skill, trace.dt)),
        "wanted_switches_per_second": mean_interval(switches_per_second(trace.oracle, trace.dt)),
        "commonest": {
            "skill": trace.skills[most],
            "share": most_share,
            "wanted_share": float((trace.oracle == most).sum() / alive.sum()),
        },
        "waypoint_fraction": mean_interval(trace.waypoint_fraction),
        "regret": regret(trace, oracle),
        "regret_same_skills": regret(trace, same_skills),
        "places": {
            "obstacles": list(SKILLS),
            "borders": OFFSETS.round(3).tolist(),
            "wrong_share": np.where(np.isnan(share), None, share.round(4)).tolist(),
            "wrong": profile(offset, kind, trace.wrong).tolist(),
            "steps": profile(offset, kind, alive).tolist(),
        },
        "odd_behaviours": odd_behaviours(trace),
    }

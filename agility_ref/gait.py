"""Gait: what the feet, the joints and the body do while a robot walks.

A policy can reach every waypoint on three legs, or shuffle.  The reward does not say so and
Table 1 does not either; these numbers do.

In:  recorded episodes, or arrays (T, N, 4) over T control steps, N robots and the feet FR, FL,
     RR, RL.
Out: a :class:`Gait`, one number a foot.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from agility_ref.go1 import FOOT_RADIUS, TORQUE_LIMITS
from agility_ref.record import Episode
from agility_ref.terrain import Course
from agility_ref.world import World


@dataclass(frozen=True)
class Gait:
    """How robots walked, over all their counted steps."""

    contact_share: np.ndarray
    """(4,) share of the steps in which each foot stood."""
    swing_clearance: np.ndarray
    """(4,) height of the top of a swing over the ground, mean over swings [m]; NaN for a foot without any."""
    swings_per_second: np.ndarray
    """(4,) how often each foot was lifted and put down [1/s]; a fluttering foot is far above the others."""
    torque_share: float
    """Largest joint torque as a share of its limit."""
    body_share: float
    """Share of the steps in which trunk, a thigh or a calf touched the ground."""


# ---------------------------------------------------------------------------- arrays
# counted[t, n] says that step t of robot n counts: it has settled, and its episode has not ended.


def contact_share(contact: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """Share of the counted steps in which each foot stands: (T, N, 4) bool, (T, N) bool -> (4,)."""
    return contact[counted].mean(axis=0)


def swing_peaks(contact: np.ndarray, clearance: np.ndarray, counted: np.ndarray) -> list[np.ndarray]:
    """Greatest clearance of every swing, a swing being all steps between two contacts of a foot.

    Parameters
    ----------
    contact : (T, N, 4) bool, the foot stands
    clearance : (T, N, 4) height of the foot's lowest point over the ground [m]
    counted : (T, N) bool; a swing counts if all of its steps and both contacts do

    Returns
    -------
    four arrays, one a foot, with one entry a swing of any robot [m]
    """
    peaks: list[list[float]] = [[], [], [], []]
    for robot in range(contact.shape[1]):
        steps = np.flatnonzero(counted[:, robot])
        for foot in range(4):
            standing = steps[contact[steps, robot, foot]]
            # Two contacts with air between them: every gap in the list of the steps it stood in.
            for before, after in pairwise(standing):
                if after - before > 1 and counted[before:after, robot].all():
                    peaks[foot].append(float(clearance[before + 1 : after, robot, foot].max()))
    return [np.array(foot) for foot in peaks]


def foot_clearance(foot_pos: np.ndarray, course: Course) -> np.ndarray:
    """Height of the feet's lowest points over the ground under them [m]: (..., 3) centres -> (...)."""
    return foot_pos[..., 2] - FOOT_RADIUS - World([course]).ground(0, foot_pos)


# ---------------------------------------------------------------------------- episodes


def _side_by_side(arrays: list[np.ndarray], length: int) -> np.ndarray:
    """Pad arrays (T_n, ...) with zeros to (length, N, ...)."""
    padded = np.zeros((length, len(arrays), *arrays[0].shape[1:]), arrays[0].dtype)
    for n, array in enumerate(arrays):
        padded[: len(array), n] = array
    return padded


def measure(episodes: list[Episode], settle: float = 2.0) -> Gait:
    """Measure the gait of episodes after ``settle`` seconds, the torques from the first step on.

    Raises
    ------
    ValueError : no episode lasts that long
    """
    length = max(len(e) for e in episodes)
    first = round(settle / episodes[0].dt)
    counted = np.stack([(np.arange(length) >= first) & (np.arange(length) < len(e)) for e in episodes], axis=1)
    if not counted.any():
        raise ValueError(f"no episode lasts {settle} s")
    contact = _side_by_side([e.foot_contact for e in episodes], length)
    clearance = _side_by_side([foot_clearance(e.foot_pos, e.course) for e in episodes], length)
    body = _side_by_side([e.body_contact.any(axis=1) for e in episodes], length)
    peaks = swing_peaks(contact, clearance, counted)
    seconds = counted.sum() * episodes[0].dt
    return Gait(
        contact_share=contact_share(contact, counted),
        swing_clearance=np.array([p.mean() if len(p) else np.nan for p in peaks]),
        swings_per_second=np.array([len(p) / seconds for p in peaks]),
        torque_share=max(float((np.abs(e.torque) / TORQUE_LIMITS).max()) for e in episodes),
        body_share=float(body[counted].mean()),
    )

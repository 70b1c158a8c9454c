"""Odd behaviours of a selector, each a definition that counts what the paper tells.

Paper sections 4.2 and 4.3: a leap abandoned midway for climb-up, a leap where climbing down
was wanted, and the beam policy that kicks the robot back from an up-step.

In:  arrays (T, N), T control steps of N episodes.  Out: (T, N) bool, the steps that count.
The paper gives no numbers, so the thresholds are ours.
"""

import numpy as np

from agility_ref.trace import Trace

LEAP_BEGUN, LEAP_OVER = 0.1, 0.4  # [s] a leap that acts for less is a flicker; ... for more, may be over
STEP_REACH = 0.6  # [m] "before an up-step": within a robot's length
KICK_SPEED = 0.5  # [m/s] backwards; no push is faster


def onsets(mask: np.ndarray) -> np.ndarray:
    """(T, N) bool, the first step of every run of true steps."""
    first = mask.copy()
    first[1:] &= ~mask[:-1]
    return first


def inside(x: np.ndarray, spans: np.ndarray) -> np.ndarray:
    """(T, N) bool, x (T, N) lies in one of its episode's spans (N, K, 2)."""
    return ((x[:, :, None] >= spans[:, :, 0]) & (x[:, :, None] <= spans[:, :, 1])).any(axis=2)


def duration(mask: np.ndarray) -> np.ndarray:
    """(T, N) steps that the run of true steps has lasted, this one included; 0 outside a run."""
    lasted = np.zeros(mask.shape, int)
    for t in range(len(mask)):
        lasted[t] = (lasted[t - 1] + 1) * mask[t] if t else mask[t]
    return lasted


def abandoned_leap(skill: np.ndarray, over_pit: np.ndarray, leap: int, climb: int, begun: int, over: int) -> np.ndarray:
    """Climb-up chosen in mid-leap ("to fake a climb down policy by abandoning the leap policy midway").

    Step t counts where ``climb`` acts and ``leap`` acted up to t - 1, for at least ``begun``
    steps, and the robot is in mid-leap: its trunk over a gap's pit, or the leap at most
    ``over`` steps old.

    Parameters
    ----------
    skill : (T, N) skill chosen, -1 after the end
    over_pit : (T, N) bool
    leap, climb : indices of the two skills; where a bank has one skill for up and down, that one
    begun, over : least duration of a leap, and of one that may have ended [control steps]

    Returns
    -------
    (T, N) bool
    """
    found = np.zeros(skill.shape, bool)
    age = duration(skill == leap)[:-1]
    found[1:] = (skill[1:] == climb) & (age >= begun) & (over_pit[1:] | (age <= over))
    return found


def passes(x: np.ndarray, alive: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(T, N) bool, the trunk passes one of its episode's edges (N, K) [m] between this step and the next."""
    found = np.zeros(x.shape, bool)
    before, after = x[:-1, :, None] < edges, x[1:, :, None] >= edges
    found[:-1] = (before & after).any(axis=2) & alive[1:]
    return found


def leapt_down(x: np.ndarray, skill: np.ndarray, edges: np.ndarray, leap: int) -> np.ndarray:
    """Leaping off instead of climbing down ("the robot learns to leap instead of climb down").

    Step t counts where the trunk passes the edge of a down-step between t and t + 1 while
    ``leap`` acts.  x, skill (T, N); edges (N, K) [m], NaN where there are fewer.
    """
    return passes(x, skill >= 0, edges) & (skill == leap)


def kicked_back(vx: np.ndarray, near: np.ndarray, speed: float = KICK_SPEED) -> np.ndarray:
    """Kicking back ("goes close to the upstep and makes a weird kicking motion to set it back far").

    Step t counts where the beam policy acts before an up-step, ``near`` (T, N) bool, and the
    trunk moves backwards along the course faster than ``speed``; vx (T, N) [m/s].
    """
    return near & (vx < -speed)


def odd_behaviours(trace: Trace) -> dict[str, dict | None]:
    """Count the paper's odd behaviours: events, episodes that have one, and chances.

    A chance is a leap of at least LEAP_BEGUN, a down-step passed, an up-step approached, and for the kick an
    up-step approached on the beam policy.  None where the policy lacks the skill.
    """
    x, skill, alive = trace.position[:, :, 0], trace.skill, trace.skill >= 0
    own = {name: k for k, name in enumerate(trace.skills)}
    climb, leap, beam = own.get("climb-up", own.get("climb")), own.get("leap"), own.get("beam")
    up, down = trace.spans("climb-up"), trace.spans("climb-down")
    approach = alive & inside(x, up - (STEP_REACH, 0.0))
    marks: dict[str, tuple[np.ndarray, np.ndarray] | None] = dict.fromkeys(
        ("abandoned_leap", "leapt_down", "beam_before_up_step", "kicked_back")
    )
    if leap is not None and climb is not None:
        begun, over = (max(round(seconds / trace.dt), 1) for seconds in (LEAP_BEGUN, LEAP_OVER))
        left = abandoned_leap(skill, inside(x, trace.spans("leap")), leap, climb, begun, over)
        marks["abandoned_leap"] = left, duration(skill == leap) == begun
    if leap is not None:
        marks["leapt_down"] = leapt_down(x, skill, down[:, :, 0], leap), passes(x, alive, down[:, :, 0])
    if beam is not None:
        near = approach & (skill == beam)
        marks["beam_before_up_step"] = near, onsets(approach)
        marks["kicked_back"] = kicked_back(trace.velocity[:, :, 0], near), onsets(near)
    return {
        name: mark and {
            "events": int(onsets(mark[0]).sum()),
            "episodes": int(mark[0].any(axis=0).sum()),
            "chances": int(mark[1].sum()),
        }
        for name, mark in marks.items()
    }  # fmt: skip

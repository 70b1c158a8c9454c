"""Gait: what the feet, the joints and the body do while a robot walks, as numbers and as a panel.

A policy can reach every waypoint on three legs, or shuffle.  The reward does not say so and
Table 1 does not either; these numbers do.

In:  recorded episodes, or arrays (T, N, 4) over T steps, N robots and the feet FR, FL,
     RR, RL.
Out: a :class:`Gait`, one number per foot; for one episode a figure of gait, progress, reward
     terms, joints and torques.
"""

from dataclasses import dataclass
from itertools import pairwise

from agility_ref.errors import UserError
from agility_ref.go1 import DOF_RANGE, FOOT_RADIUS, LEGS, TORQUE_LIMITS
from agility_ref.pictures.plots import BLUE, LEG_COLOURS, ORANGE, RED, empty_figure, style
from agility_ref.pictures.record import Episode, side_by_side
from agility_ref.terrain import NUM_WAYPOINTS, Course
from agility_ref.world import World

import numpy as np


@dataclass(frozen=True)
class Gait:
    """How robots walked, over all their counted steps."""

    contact_share: np.ndarray  # (4,) share of the steps in which each foot stood.
    diagonal_correlation: float  # How alike diagonal feet stand: 1 for a trot, -1 for a pace or a bound.
    swing_clearance: np.ndarray
    """(4,) height of the top of a swing over the ground, mean over swings [m]; NaN for a foot without any."""
    swings_per_second: np.ndarray
    """(4,) how often each foot was lifted and put down [1/s]; a fluttering foot is far above the others."""
    torque_share: float  # Largest joint torque as a share of its limit.
    body_share: float  # Share of the steps in which trunk, a thigh or a calf touched the ground.


# ---------------------------------------------------------------------------- arrays
# counted[t, n] says that step t of robot n counts: it has settled, and its episode has not ended.


def contact_share(contact: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """Share of the counted steps in which each foot stands: (T, N, 4) bool, (T, N) bool -> (4,)."""
    return contact[counted].mean(axis=0)


def diagonal_correlation(contact: np.ndarray, counted: np.ndarray) -> float:
    """Correlation of FR with RL and of FL with RR, the mean of the two: (T, N, 4) bool, (T, N) bool -> number.

    NaN where a foot never moves.
    """
    fr, fl, rr, rl = contact[counted].T.astype(float)
    if min(np.ptp(foot) for foot in (fr, fl, rr, rl)) == 0.0:
        return np.nan
    return float(np.corrcoef(fr, rl)[0, 1] + np.corrcoef(fl, rr)[0, 1]) / 2


def swing_peaks(contact: np.ndarray, clearance: np.ndarray, counted: np.ndarray) -> list[np.ndarray]:
    """Greatest clearance of every swing, a swing being all steps between two contacts of a foot.

    Parameters
    ----------
    contact : (T, N, 4) bool, the foot stands
    clearance : (T, N, 4) height of the foot's lowest point over the ground [m]
    counted : (T, N) bool; a swing counts if all of its steps and both contacts do

    Returns
    -------
    four arrays, one per foot, with one entry per swing of any robot [m]
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
    contact, body = side_by_side(episodes, "foot_contact"), side_by_side(episodes, "body_contact").any(axis=2)
    clearance = np.zeros(contact.shape)
    for n, e in enumerate(episodes):
        clearance[: len(e), n] = foot_clearance(e.foot_pos, e.course)
    peaks = swing_peaks(contact, clearance, counted)
    seconds = counted.sum() * episodes[0].dt
    return Gait(
        contact_share=contact_share(contact, counted),
        diagonal_correlation=diagonal_correlation(contact, counted),
        swing_clearance=np.array([p.mean() if len(p) else np.nan for p in peaks]),
        swings_per_second=np.array([len(p) / seconds for p in peaks]),
        torque_share=max(float((np.abs(e.torque) / TORQUE_LIMITS).max()) for e in episodes),
        body_share=float(body[counted].mean()),
    )


def episode_panel(episode: Episode, seconds: float = 3.0, start: float | None = None):
    """Gait, progress, reward terms, joint angles and torques of one episode; return the figure.

    Parameters
    ----------
    episode : what was played
    seconds : length of the window of the joint panels [s]
    start : where it begins [s]; by default it is the middle of the episode

    Raises
    ------
    UserError : a window of no length, or outside of the episode
    """
    if not 0.0 < seconds < np.inf:
        raise UserError(f"seconds must be above 0, got {seconds}")
    duration = len(episode) * episode.dt
    begin = max((duration - seconds) / 2, 0.0) if start is None else start
    if not 0.0 <= begin < duration:
        raise UserError(f"start must lie within the episode, 0 to {duration:g} s, got {begin:g}")
    window = (episode.time >= begin) & (episode.time <= begin + seconds)
    with style():
        figure = empty_figure((14.0, 9.6))
        figure.set_layout_engine("constrained")
        left, right = figure.add_gridspec(1, 2, width_ratios=[1.25, 1.0])
        gait, progress, rewards = (figure.add_subplot(s) for s in left.subgridspec(3, 1, height_ratios=[1.0, 1.2, 2.6]))
        _draw_gait(gait, episode)
        _draw_progress(progress, episode)
        _draw_rewards(rewards, episode)
        for axis in (gait, progress, rewards):
            axis.set_xlim(0, duration)
            axis.axvspan(begin, begin + seconds, color="black", alpha=0.06, linewidth=0)
        gait.legend(loc="upper right", bbox_to_anchor=(1.0, 1.25), ncols=2)
        rewards.set_xlabel("time [s]; the shaded part is shown on the right")
        panels = right.subgridspec(6, 1).subplots(sharex=True)
        _draw_joints(panels, episode, window)
        figure.suptitle(episode.summary(), x=0.01, ha="left", fontsize=15)
        return figure


def _bars(axis, on: np.ndarray, dt: float, y: float, height: float, colour: str, label: str | None = None) -> None:
    """Draw a bar wherever ``on`` (T,) is true."""
    flips = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]])))
    spans = [(a * dt, (b - a) * dt) for a, b in zip(flips[::2], flips[1::2], strict=True)]
    axis.broken_barh(spans, (y - height / 2, height), color=colour, linewidth=0, label=label)


def _draw_gait(axis, episode: Episode) -> None:
    """A bar while a foot stands; on the right its share of the time and the height of its swings."""
    gait = measure([episode], settle=0.0)
    for k, leg in enumerate(LEGS):
        height = gait.swing_clearance[k]
        swing = "no swing" if np.isnan(height) else f"{100 * height:.1f} cm"
        note = f"{100 * gait.contact_share[k]:.0f} %, {swing}"
        axis.text(1.01, 3 - k, note, transform=axis.get_yaxis_transform(), va="center", fontsize=10.5)
        _bars(axis, episode.foot_contact[:, k], episode.dt, 3 - k, 0.7, LEG_COLOURS[leg])
        label = "on an edge" if k == 0 else None
        _bars(axis, episode.foot_on_edge[:, k], episode.dt, 3 - k, 0.9, RED, label)
    axis.set_yticks([3, 2, 1, 0], LEGS)
    axis.set_ylim(-0.6, 3.6)
    axis.text(1.01, 3.75, "stands, swings to", transform=axis.get_yaxis_transform(), va="center", fontsize=10.5)
    axis.set_title("feet on the ground", loc="left")


def _draw_progress(axis, episode: Episode) -> None:
    axis.step(episode.time, episode.waypoint_index, where="post", color=BLUE)
    axis.set_ylim(-0.3, NUM_WAYPOINTS + 0.3)
    axis.set_ylabel("waypoints", color=BLUE)
    twin = axis.twinx()
    twin.plot(episode.time, np.rad2deg(episode.heading_error), color=ORANGE, linewidth=1.0)
    limit = max(30.0, np.abs(np.rad2deg(episode.heading_error)).max())
    twin.set_ylim(-1.05 * limit, 1.05 * limit)
    twin.set_ylabel("heading error [°]", color=ORANGE)
    twin.spines["right"].set_visible(True)
    twin.grid(visible=False)


def _draw_rewards(axis, episode: Episode) -> None:
    """One row per term, each on its own scale; what it summed to stands on the right."""
    names = sorted(episode.reward_terms, key=lambda name: -episode.reward_terms[name].sum())
    rows = np.stack([episode.reward_terms[name] for name in names])
    width = max(round(0.1 / episode.dt), 1)  # steps averaged in one cell of the picture, about 0.1 s
    cells = np.add.reduceat(rows, np.arange(0, rows.shape[1], width), axis=1)
    scale = np.percentile(np.abs(cells), 98, axis=1, keepdims=True)
    extent = (0, cells.shape[1] * width * episode.dt, len(names) - 0.5, -0.5)
    axis.imshow(
        cells / np.maximum(scale, 1e-12),
        aspect="auto",
        cmap="RdBu",
        vmin=-1,
        vmax=1,
        extent=extent,
        interpolation="nearest",
    )
    axis.set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
    for k, row in enumerate(rows):
        axis.text(1.01, k, f"{row.sum():+.2f}", transform=axis.get_yaxis_transform(), va="center", fontsize=10.5)
    axis.grid(visible=False)
    axis.set_title(f"reward terms: blue earns, red costs; sum {episode.reward.sum():+.2f}", loc="left")


def _draw_joints(axes, episode: Episode, window: np.ndarray) -> None:
    """Angles with their targets (dotted), then torques; limits dashed where they are near."""
    time = episode.time[window]
    for part, name in enumerate(("hip", "thigh", "calf")):
        angle, torque = axes[part], axes[3 + part]
        for k, leg in enumerate(LEGS):
            joint, colour = 3 * k + part, LEG_COLOURS[leg]
            angle.plot(time, episode.qpos[window, 7 + joint], color=colour, linewidth=1.5, label=leg)
            angle.plot(time, episode.target[window, joint], ":", color=colour, linewidth=1.3)
            torque.plot(time, episode.torque[window, joint], color=colour, linewidth=1.3)
        for limit in DOF_RANGE[part]:
            low, high = angle.get_ylim()
            if low < limit < high:
                angle.axhline(limit, color="black", linestyle="--", linewidth=1)
        for limit in (-TORQUE_LIMITS[part], TORQUE_LIMITS[part]):
            torque.axhline(limit, color="black", linestyle="--", linewidth=1)
        torque.set_ylim(-1.12 * TORQUE_LIMITS[part], 1.12 * TORQUE_LIMITS[part])
        angle.set_ylabel(f"{name} [rad]")
        torque.set_ylabel(f"{name} [N m]")
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.02, 0.96), ncols=4, handlelength=1.0, columnspacing=0.8)
    axes[0].set_title("angles, targets dotted", loc="left", fontsize=11.5)
    axes[3].set_title("torques, limits dashed", loc="left", fontsize=11.5)
    axes[5].set_xlabel("time [s]")

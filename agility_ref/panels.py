"""Episode panel: gait, progress, reward terms, joints and torques of one episode.

In:  an :class:`~agility_ref.record.Episode`.  Out: a matplotlib figure.
"""

import numpy as np

from agility_ref.errors import UserError
from agility_ref.gait import measure
from agility_ref.go1 import DOF_RANGE, LEGS, TORQUE_LIMITS
from agility_ref.plots import BLUE, ORANGE, RED, empty_figure, style
from agility_ref.record import Episode
from agility_ref.scene import LEG_COLOURS
from agility_ref.terrain import NUM_WAYPOINTS


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
    """One row a term, each on its own scale; what it summed to stands on the right."""
    names = sorted(episode.reward_terms, key=lambda name: -episode.reward_terms[name].sum())
    rows = np.stack([episode.reward_terms[name] for name in names])
    width = max(round(0.1 / episode.dt), 1)  # steps averaged in one cell of the picture, 0.1 s
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

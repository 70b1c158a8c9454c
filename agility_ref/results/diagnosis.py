"""Diagnosis: what a selector chooses, where it errs, and what its errors cost.

Paper section 4.3: selectors keep switching, or collapse into one skill.  Sections 4.2 and 4.3
also tell of odd behaviours: a leap abandoned midway for climb-up, a leap where climbing down
was wanted, and the beam policy that kicks the robot back from an up-step.  The paper gives no
numbers for these, so the thresholds are ours.

In:  a :class:`~agility_ref.pictures.record.Trace` of a selector, and of the oracle on the same episodes;
     arrays are (T, N) for T control steps of N episodes.
Out: accuracy, confusion, flicker, collapse, places, regret, odd behaviours, JSON-ready; and figures.

A wrong choice is one that is not the oracle's, which need not be one that fails: only the
regret says what it cost.
"""

from agility_ref.evaluate import oracle_accuracy, switches_per_second
from agility_ref.pictures.plots import SKILL_COLOURS, empty_figure, new_figure, skill_colour, style
from agility_ref.pictures.record import Trace
from agility_ref.stats import bootstrap_interval, paired_difference
from agility_ref.terrain import LANE_LENGTH, LANE_WIDTH, SKILLS
from agility_ref.world import LEAD, height_map, region_map

import numpy as np

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


HALF_WIDTH = 1.5  # [m] of the lane shown on either side of its middle


def _rgb(names: list[str]) -> np.ndarray:
    """Colours of skills, (n, 3) from 0 to 1."""
    from matplotlib.colors import to_rgb

    return np.array([to_rgb(skill_colour(name)) for name in names])


def _legend(figure, names: list[str]) -> None:
    from matplotlib.patches import Patch

    items = [Patch(color=skill_colour(name), label=name) for name in names]
    figure.legend(handles=items, loc="outside lower center", ncols=6)


def confusion_figure(traces: list[Trace]):
    """One confusion matrix an environment: share of the oracle's steps (rows) by the skill chosen (columns)."""
    skills = traces[0].skills
    with style():
        figure, axes = new_figure(1, len(traces), (3.2 * len(traces) + 1.4, 4.6))
        for axis, trace in zip(axes[0], traces, strict=True):
            counts = confusion(trace.skill, trace.oracle, len(skills))
            wanted = counts.sum(axis=1, keepdims=True)
            shares = counts / np.maximum(wanted, 1)
            axis.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
            for (i, j), share in np.ndenumerate(shares):
                if wanted[i, 0]:
                    colour = "white" if share > 0.6 else "black"
                    axis.text(j, i, f"{100 * share:.0f}", ha="center", va="center", color=colour)
            axis.set_xticks(range(len(skills)), skills, rotation=45, ha="right")
            axis.set_yticks(range(len(skills)), skills if axis is axes[0, 0] else [""] * len(skills))
            agree = 100 * oracle_accuracy(trace.skill, trace.oracle).mean()
            axis.set_title(f"{trace.environment}: {agree:.0f} % agree", loc="left")
            axis.set_xlabel("chosen")
            axis.grid(visible=False)
        axes[0, 0].set_ylabel("wanted by the oracle")
        figure.suptitle(f"{traces[0].policy}: skill chosen, % of each row", x=0.01, ha="left")
        return figure


def timeline_figure(traces: list[Trace], episodes: int = 8):
    """Skill chosen over time in the first episodes of each environment, the oracle's in a thin band below."""
    with style():
        figure, axes = new_figure(len(traces), 1, (10.0, 0.9 + 2.3 * len(traces)))
        for axis, trace in zip(axes[:, 0], traces, strict=True):
            shown = min(episodes, trace.skill.shape[1])
            # The last colour is that of nothing: after the end, and between two episodes.
            colours = np.vstack([_rgb(list(trace.skills)), [1.0, 1.0, 1.0]])
            nothing = np.full(len(trace.skill), -1)
            rows = [row for n in range(shown) for row in (*[trace.skill[:, n]] * 3, trace.oracle[:, n], nothing)]
            seconds = len(trace.skill) * trace.dt
            axis.imshow(colours[rows], aspect="auto", extent=(0, seconds, shown, 0), interpolation="nearest")
            axis.set_yticks(np.arange(shown) + 0.4, range(shown))
            axis.set(ylabel="episode")
            axis.set_title(trace.environment, loc="left")
            axis.grid(visible=False)
        axes[-1, 0].set_xlabel("time [s]")
        figure.suptitle(f"{traces[0].policy}: skill chosen, and below it the oracle's", x=0.01, ha="left")
        _legend(figure, list(traces[0].skills))
        return figure


def mistakes_figure(traces: list[Trace]):
    """Wrong choices around the obstacles, and from above on one course of each environment."""
    profiles, lanes = [[f"{part}{k}" for k in range(len(traces))] for part in ("profile", "lane")]
    with style():
        figure = empty_figure((12.0, 4.2 + 2.2 * len(traces)))
        figure.set_layout_engine("constrained")
        axes = figure.subplot_mosaic(
            [profiles, *[[lane] * len(traces) for lane in lanes]], height_ratios=[1.5, *[1.0] * len(traces)]
        )
        for trace, above, below in zip(traces, profiles, lanes, strict=True):
            _draw_profile(axes[above], trace)
            _draw_course(axes[below], trace)
        axes[profiles[0]].set_ylabel("share of time on a wrong skill,\nby nearest obstacle")
        axes[lanes[-1]].set_xlabel("x [m]; dots: wrong choices, in the colour of the skill chosen")
        figure.suptitle(f"{traces[0].policy}: where its choice is not the oracle's", x=0.01, ha="left")
        shown = {*SKILLS, *traces[0].skills}
        _legend(figure, [name for name in SKILL_COLOURS if name in shown])
        return figure


def _draw_profile(axis, trace: Trace) -> None:
    """Draw the share of wrong choices around each kind of obstacle; dashed, where the oracle's region begins."""
    for name, share in zip(SKILLS, wrong_share(trace), strict=True):
        if not np.isnan(share).all():
            axis.stairs(share, OFFSETS, color=SKILL_COLOURS[name], linewidth=2.0)
            axis.axvline(-LEAD[name], color=SKILL_COLOURS[name], linestyle="--", linewidth=1.5)
    axis.axvline(0.0, color="black", linewidth=1.0)
    axis.set(xlim=(OFFSETS[0], OFFSETS[-1]), ylim=(0, 1.02), xlabel="x from the obstacle [m]")
    axis.set_title(trace.environment, loc="left")


def widest_mistakes(trace: Trace) -> int:
    """Episode whose wrong choices are spread over the most decimetres of x."""
    tenths = np.where(trace.wrong, (10 * trace.position[:, :, 0]).astype(int), -1)
    return int(np.argmax([len(np.unique(column[column >= 0])) for column in tenths.T]))


def _draw_course(axis, trace: Trace) -> None:
    """Draw a course from above: height, the oracle's regions, the path, wrong choices by the skill chosen."""
    n = widest_mistakes(trace)
    course, played = trace.courses[n], trace.skill[:, n] >= 0
    heights = height_map(course)
    axis.imshow(
        heights.T, origin="lower", extent=(0, LANE_LENGTH, -LANE_WIDTH / 2, LANE_WIDTH / 2), cmap="gray",
        vmin=heights.min() - 0.5 * max(np.ptp(heights), 0.2), interpolation="nearest", aspect="auto",
    )  # fmt: skip
    colours = np.array([(*rgb, 0.0 if name == "walk" else 0.5) for name, rgb in zip(SKILLS, _rgb(SKILLS), strict=True)])
    regions = colours[region_map(course)][None]
    axis.imshow(
        regions, extent=(0, LANE_LENGTH, -HALF_WIDTH, HALF_WIDTH), aspect="auto", interpolation="nearest"
    )  # fmt: skip
    x, y = trace.position[played, n, :2].T
    axis.plot(x, y, color="black", linewidth=1.0)
    wrong = trace.wrong[played, n]
    chosen = _rgb(list(trace.skills))[trace.skill[played, n][wrong]]
    axis.scatter(x[wrong], y[wrong], s=26, c=chosen, edgecolors="black", linewidths=0.5, zorder=4)
    axis.set(xlim=(0, course.waypoints[:, 0].max() + 1.0), ylim=(-HALF_WIDTH, HALF_WIDTH), ylabel="y [m]")
    axis.set_title(
        f"{trace.environment}, episode {n}, d = {course.difficulty:.2f}: wrong in {100 * wrong.mean():.0f} % of its steps",
        loc="left", fontsize=12,
    )  # fmt: skip
    axis.grid(visible=False)

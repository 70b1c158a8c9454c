"""Diagnosis: what a selector chooses, where it errs, and what its errors cost.

Paper section 4.3: selectors keep switching, or collapse into one skill.  Sections 4.2 and 4.3
also tell of odd behaviours: a leap abandoned midway for climb-up, a leap where climbing down
was wanted, and the beam policy that kicks the robot back from an up-step.  The paper gives no
numbers for these, so the thresholds are ours.

In:  recorded episodes of a selector, and of the oracle on the same courses; arrays (T,) over the steps of one.
Out: accuracy, confusion, flicker, collapse, places, regret, odd behaviours, JSON-ready; figures; a report.

A wrong choice is one that is not the oracle's, which need not be one that fails: only the
regret says what it cost.
"""

from pathlib import Path

from agility_ref.evaluate import EvaluationConfig, evaluation_env
from agility_ref.pictures.plots import (
    SKILL_COLOURS,
    empty_figure,
    new_figure,
    save_figure,
    skill_colour,
    skill_legend,
    style,
)
from agility_ref.pictures.record import Episode, play, side_by_side
from agility_ref.results.cells import oracle_accuracy, switches_per_second
from agility_ref.selector import oracle_hierarchy
from agility_ref.stats import bootstrap_interval, paired_difference
from agility_ref.terrain import LANE_LENGTH, LANE_WIDTH, NUM_WAYPOINTS, SKILLS
from agility_ref.training.bank import WeightsConfig, load_policy
from agility_ref.world import LEAD, height_map, region_map

import numpy as np

LEAP_BEGUN, LEAP_OVER = 0.1, 0.4  # [s] a leap that acts for less is a flicker; ... for more, may be over
STEP_REACH = 0.6  # [m] "before an up-step": within a robot's length
KICK_SPEED = 0.5  # [m/s] backwards; no push is faster
OFFSETS = np.linspace(-1.5, 2.0, 36)  # [m] borders of the 0.1 m bins around an obstacle
HALF_WIDTH = 1.5  # [m] of the lane shown on either side of its middle

# ---------------------------------------------------------------------------- odd behaviours


def onsets(mask: np.ndarray) -> np.ndarray:
    """(T,) bool, the first step of every run of true steps."""
    first = mask.copy()
    first[1:] &= ~mask[:-1]
    return first


def inside(x: np.ndarray, spans: np.ndarray) -> np.ndarray:
    """(T,) bool, x (T,) lies in one of the spans (K, 2)."""
    return ((x[:, None] >= spans[:, 0]) & (x[:, None] <= spans[:, 1])).any(axis=1)


def duration(mask: np.ndarray) -> np.ndarray:
    """(T,) steps that the run of true steps has lasted, this one included; 0 outside a run."""
    steps = np.arange(len(mask))
    return np.where(mask, steps - np.maximum.accumulate(np.where(mask, -1, steps)), 0)


def abandoned_leap(skill: np.ndarray, over_pit: np.ndarray, leap: int, climb: int, begun: int, over: int) -> np.ndarray:
    """Climb-up chosen in mid-leap ("to fake a climb down policy by abandoning the leap policy midway").

    Step t counts where ``climb`` acts and ``leap`` acted up to t - 1, for at least ``begun``
    steps, and the robot is in mid-leap: its trunk over a gap's pit, ``over_pit`` (T,) bool, or the
    leap at most ``over`` steps old.  ``climb`` is the skill that climbs up, or up and down.
    """
    found = np.zeros(skill.shape, bool)
    age = duration(skill == leap)[:-1]
    found[1:] = (skill[1:] == climb) & (age >= begun) & (over_pit[1:] | (age <= over))
    return found


def passes(x: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(T,) bool, the trunk passes one of the edges (K,) [m] between this step and the next."""
    found = np.zeros(x.shape, bool)
    found[:-1] = ((x[:-1, None] < edges) & (x[1:, None] >= edges)).any(axis=1)
    return found


def odd_marks(e: Episode) -> dict[str, tuple[np.ndarray, np.ndarray] | None]:
    """Mark the paper's odd behaviours in one episode: name -> (T,) where it happens and where it might.

    abandoned_leap       see there; a chance is a leap of at least LEAP_BEGUN
    leapt_down           the trunk passes the edge of a down-step while ``leap`` acts ("learns to leap instead of climb down")
    beam_before_up_step  the beam policy acts within STEP_REACH before an up-step
    kicked_back          ... and the trunk moves back faster than KICK_SPEED ("a weird kicking motion to set it back far")

    None where the policy lacks the skill.
    """
    x, skill, own = e.qpos[:, 0], e.skill, {name: k for k, name in enumerate(e.skills)}
    climb, leap, beam = own.get("climb-up", own.get("climb")), own.get("leap"), own.get("beam")
    marks = dict.fromkeys(("abandoned_leap", "leapt_down", "beam_before_up_step", "kicked_back"))
    if leap is not None and climb is not None:
        begun, over = (max(round(seconds / e.dt), 1) for seconds in (LEAP_BEGUN, LEAP_OVER))
        left = abandoned_leap(skill, inside(x, e.spans("leap")), leap, climb, begun, over)
        marks["abandoned_leap"] = left, duration(skill == leap) == begun
    if leap is not None:
        down = passes(x, e.spans("climb-down")[:, 0])
        marks["leapt_down"] = down & (skill == leap), down
    if beam is not None:
        approach = inside(x, e.spans("climb-up") - (STEP_REACH, 0.0))
        near = approach & (skill == beam)
        marks["beam_before_up_step"] = near, onsets(approach)
        marks["kicked_back"] = near & (e.qvel[:, 0] < -KICK_SPEED), onsets(near)
    return marks


def odd_behaviours(episodes: list[Episode]) -> dict[str, dict[str, int] | None]:
    """Count events, episodes that have one, and chances of each odd behaviour."""
    marks = [odd_marks(e) for e in episodes]
    return {
        name: first and {
            "events": sum(int(onsets(m[name][0]).sum()) for m in marks),
            "episodes": sum(int(m[name][0].any()) for m in marks),
            "chances": sum(int(m[name][1].sum()) for m in marks),
        }
        for name, first in marks[0].items()
    }  # fmt: skip


# ---------------------------------------------------------------------------- choices and places


def confusion(episodes: list[Episode]) -> np.ndarray:
    """Count steps by the skill wanted (rows) and the skill chosen (columns)."""
    counts = np.zeros((len(episodes[0].skills),) * 2, int)
    for e in episodes:
        np.add.at(counts, (e.wanted, e.skill), 1)
    return counts


def nearest_obstacle(e: Episode) -> tuple[np.ndarray, np.ndarray]:
    """Where each step is, seen from the obstacle whose span is nearest.

    Returns
    -------
    offset : (T,) x minus the x at which that obstacle begins [m]; NaN on a course without
    kind : (T,) the skill it needs, index into SKILLS
    """
    x = e.qpos[:, 0]
    if not e.course.obstacles:
        return np.full(x.shape, np.nan), np.zeros(x.shape, int)
    start, stop = np.array([(o.x0, o.x1) for o in e.course.obstacles]).T
    # distance from x to the span [x0, x1], 0 inside it; of two equally near, the skill that comes first in SKILLS
    kinds = np.array([SKILLS.index(o.skill) for o in e.course.obstacles])
    order = np.argsort(kinds, kind="stable")
    distance = np.maximum(np.maximum(start - x[:, None], x[:, None] - stop), 0.0)[:, order]
    nearest = order[distance.argmin(axis=1)]
    return x - start[nearest], kinds[nearest]


def profile(e: Episode, steps: np.ndarray, borders: np.ndarray = OFFSETS) -> np.ndarray:
    """Count the steps marked in ``steps`` (T,) by kind of obstacle and place: (5, bins)."""
    offset, kind = nearest_obstacle(e)
    return np.stack([np.histogram(offset[steps & (kind == k)], borders)[0] for k in range(len(SKILLS))])


def wrong_share(episodes: list[Episode]) -> np.ndarray:
    """Share of the time in each place that was spent on a wrong skill, by kind of obstacle: (5, bins).

    Every episode that came to a place counts once there, however long it stood; NaN where none came.
    """
    wrong = np.stack([profile(e, e.wrong) for e in episodes])
    steps = np.stack([profile(e, np.ones(len(e), bool)) for e in episodes])
    came = (steps > 0).sum(axis=0)
    return np.where(came > 0, (wrong / np.maximum(steps, 1)).sum(axis=0) / np.maximum(came, 1), np.nan)


def mean_interval(values: np.ndarray) -> dict[str, float]:
    """Mean over episodes (N,) and its 95 % interval."""
    low, high = bootstrap_interval(values, np.mean)
    return {"mean": float(values.mean()), "low": low, "high": high}


def regret(episodes: list[Episode], oracle: list[Episode]) -> dict[str, float]:
    """Waypoint fraction that the oracle reaches beyond the policy's, on the same episodes, with its 95 % interval."""
    best, own = (np.array([e.reached for e in played]) / NUM_WAYPOINTS for played in (oracle, episodes))
    return dict(zip(("mean", "low", "high"), paired_difference(best, own), strict=True))


def diagnose(episodes: list[Episode], oracle: list[Episode], same_skills: list[Episode]) -> dict:
    """Measure a policy on one environment; JSON-ready.

    Parameters
    ----------
    episodes : the policy's
    oracle : the same episodes played by the oracle of Table 1, over five skills
    same_skills : ... and by the oracle over the skills that the policy has: the regret
        against it is the selector's own, the rest is due to the skills
    """
    e, counts, share = episodes[0], confusion(episodes), wrong_share(episodes)
    skill, wanted = (side_by_side(episodes, name, -1) for name in ("skill", "wanted"))
    most, steps = int(counts.sum(axis=0).argmax()), int(counts.sum())
    return {
        "policy": e.policy,
        "environment": e.environment,
        "episodes": len(episodes),
        "environment_steps": steps,
        "skills": list(e.skills),
        "accuracy": mean_interval(oracle_accuracy(skill, wanted)),
        "confusion": counts.tolist(),
        "switches_per_second": mean_interval(switches_per_second(skill, e.dt)),
        "wanted_switches_per_second": mean_interval(switches_per_second(wanted, e.dt)),
        "commonest": {  # over all episodes: a share of 1 is a collapse into one skill
            "skill": e.skills[most],
            "share": float(counts.sum(axis=0)[most] / steps),
            "wanted_share": float(counts.sum(axis=1)[most] / steps),
        },
        "waypoint_fraction": mean_interval(np.array([e.reached for e in episodes]) / NUM_WAYPOINTS),
        "regret": regret(episodes, oracle),
        "regret_same_skills": regret(episodes, same_skills),
        "places": {
            "obstacles": list(SKILLS),
            "borders": OFFSETS.round(3).tolist(),
            "wrong_share": np.where(np.isnan(share), None, share.round(4)).tolist(),
            "wrong": sum(profile(e, e.wrong) for e in episodes).tolist(),
            "steps": sum(profile(e, np.ones(len(e), bool)) for e in episodes).tolist(),
        },
        "odd_behaviours": odd_behaviours(episodes),
    }


def play_and_diagnose(
    name: str, environments: tuple[str, ...], config: EvaluationConfig, training: WeightsConfig
) -> tuple[list[list[Episode]], list[dict]]:
    """Play a selector and the oracles on every environment; return the selector's episodes and the reports."""
    from tqdm import tqdm

    policy, oracle = load_policy(name, training), load_policy("oracle", training)
    same = oracle_hierarchy("oracle over the same skills", {skill.name: skill for skill in policy.skills})

    def episodes_of(hierarchy, environment: str) -> list[Episode]:
        # Robots anew for each policy, as an evaluation has them: the same to the last bit.
        return play(hierarchy, evaluation_env(environment, config), environment, config.seed)

    played, reports = [], []
    for environment in tqdm(environments, unit="environment", leave=False, disable=None):
        best = episodes_of(oracle, environment)
        own = best if name == "oracle" else episodes_of(policy, environment)
        played.append(own)
        restricted = best if own[0].skills == best[0].skills else episodes_of(same, environment)
        reports.append(diagnose(own, best, restricted))
    return played, reports


def report_text(report: dict) -> str:
    """Return one environment's report for a terminal."""
    skills, most = report["skills"], report["commonest"]
    played = f"{report['episodes']} episodes, {report['environment_steps']} steps"
    lines = [f"{report['policy']} on {report['environment']}: {played}"]
    for key, label in {
        "accuracy": "accuracy", "switches_per_second": "switches [1/s]", "wanted_switches_per_second": "  the oracle's",
        "waypoint_fraction": "waypoint fraction", "regret": "regret", "regret_same_skills": "  same skills",
    }.items():  # fmt: skip
        lines.append("  {:20} {mean:7.3f}  [{low:.3f}, {high:.3f}]".format(label, **report[key]))
    lines.append(
        "  {:20} {share:7.3f}  {skill}; the oracle's share {wanted_share:.3f}".format("commonest skill", **most)
    )
    width = max(map(len, skills)) + 1
    lines.append(f"  {'wanted: chosen [%]':20}" + "".join(f"{name:>{width}}" for name in skills))
    for name, row in zip(skills, report["confusion"], strict=True):
        shares = [f"{100 * count / sum(row):.1f}" if sum(row) else "-" for count in row]
        lines.append(f"  {name:20}" + "".join(f"{share:>{width}}" for share in shares))
    for name, found in report["odd_behaviours"].items():
        said = "{events} in {episodes} episodes; {chances} chances".format(**found) if found else "lacks the skill"
        lines.append(f"  {name.replace('_', ' '):20} {said}")
    return "\n".join(lines) + "\n"


# ---------------------------------------------------------------------------- figures


def confusion_figure(played: list[list[Episode]]):
    """One confusion matrix per environment: share of the oracle's steps (rows) by the skill chosen (columns)."""
    skills = played[0][0].skills
    with style():
        figure, axes = new_figure(1, len(played), (3.2 * len(played) + 1.4, 4.6))
        for axis, episodes in zip(axes[0], played, strict=True):
            counts = confusion(episodes)
            wanted = counts.sum(axis=1, keepdims=True)
            shares = counts / np.maximum(wanted, 1)
            axis.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
            for (i, j), share in np.ndenumerate(shares):
                if wanted[i, 0]:
                    colour = "white" if share > 0.6 else "black"
                    axis.text(j, i, f"{100 * share:.0f}", ha="center", va="center", color=colour)
            axis.set_xticks(range(len(skills)), skills, rotation=45, ha="right")
            axis.set_yticks(range(len(skills)), skills if axis is axes[0, 0] else [""] * len(skills))
            agree = 100 * np.mean([1 - e.wrong.mean() for e in episodes])
            axis.set_title(f"{episodes[0].environment}: {agree:.0f} % agree", loc="left")
            axis.set_xlabel("chosen")
            axis.grid(visible=False)
        axes[0, 0].set_ylabel("wanted by the oracle")
        figure.suptitle(f"{played[0][0].policy}: skill chosen, % of each row", x=0.01, ha="left")
        return figure


def timeline_figure(played: list[list[Episode]], shown: int = 8):
    """Skill chosen over time in the first episodes of each environment, the oracle's in a thin band below."""
    from matplotlib.colors import to_rgb

    first = played[0][0]
    colours = np.array([to_rgb(colour) for colour in (*map(skill_colour, first.skills), "white")])  # white: the end
    with style():
        figure, axes = new_figure(len(played), 1, (10.0, 0.9 + 2.3 * len(played)))
        for axis, episodes in zip(axes[:, 0], played, strict=True):
            skill, oracle = (side_by_side(episodes[:shown], name, -1) for name in ("skill", "wanted"))
            nothing = np.full(len(skill), -1)
            rows = [row for n in range(skill.shape[1]) for row in (*[skill[:, n]] * 3, oracle[:, n], nothing)]
            extent = (0, len(skill) * first.dt, skill.shape[1], 0)
            axis.imshow(colours[rows], aspect="auto", extent=extent, interpolation="nearest")
            axis.set_yticks(np.arange(skill.shape[1]) + 0.4, range(skill.shape[1]))
            axis.set(ylabel="episode")
            axis.set_title(episodes[0].environment, loc="left")
            axis.grid(visible=False)
        axes[-1, 0].set_xlabel("time [s]")
        figure.suptitle(f"{first.policy}: skill chosen, and below it the oracle's", x=0.01, ha="left")
        skill_legend(figure, first.skills)
        return figure


def mistakes_figure(played: list[list[Episode]]):
    """Wrong choices around the obstacles, and from above on one course of each environment."""
    profiles, lanes = [[f"{part}{k}" for k in range(len(played))] for part in ("profile", "lane")]
    with style():
        figure = empty_figure((12.0, 4.2 + 2.2 * len(played)))
        figure.set_layout_engine("constrained")
        axes = figure.subplot_mosaic(
            [profiles, *[[lane] * len(played) for lane in lanes]], height_ratios=[1.5, *[1.0] * len(played)]
        )
        for episodes, above, below in zip(played, profiles, lanes, strict=True):
            _draw_profile(axes[above], episodes)
            _draw_course(axes[below], widest_mistakes(episodes), episodes)
        axes[profiles[0]].set_ylabel("share of time on a wrong skill,\nby nearest obstacle")
        axes[lanes[-1]].set_xlabel("x [m]; dots: wrong choices, in the colour of the skill chosen")
        figure.suptitle(f"{played[0][0].policy}: where its choice is not the oracle's", x=0.01, ha="left")
        skill_legend(figure, [name for name in SKILL_COLOURS if name in {*SKILLS, *played[0][0].skills}])
        return figure


def _draw_profile(axis, episodes: list[Episode]) -> None:
    """Draw the share of wrong choices around each kind of obstacle; dashed, where the oracle's region begins."""
    for name, share in zip(SKILLS, wrong_share(episodes), strict=True):
        if not np.isnan(share).all():
            axis.stairs(share, OFFSETS, color=SKILL_COLOURS[name], linewidth=2.0)
            axis.axvline(-LEAD[name], color=SKILL_COLOURS[name], linestyle="--", linewidth=1.5)
    axis.axvline(0.0, color="black", linewidth=1.0)
    axis.set(xlim=(OFFSETS[0], OFFSETS[-1]), ylim=(0, 1.02), xlabel="x from the obstacle [m]")
    axis.set_title(episodes[0].environment, loc="left")


def widest_mistakes(episodes: list[Episode]) -> int:
    """Number of the episode whose wrong choices are spread over the most decimetres of x."""
    return int(np.argmax([len(np.unique((10 * e.qpos[e.wrong, 0]).astype(int))) for e in episodes]))


def _draw_course(axis, n: int, episodes: list[Episode]) -> None:
    """Draw a course from above: height, the oracle's regions, the path, wrong choices by the skill chosen."""
    from matplotlib.colors import to_rgba

    e, heights = episodes[n], height_map(episodes[n].course)
    axis.imshow(
        heights.T, origin="lower", extent=(0, LANE_LENGTH, -LANE_WIDTH / 2, LANE_WIDTH / 2), cmap="gray",
        vmin=heights.min() - 0.5 * max(np.ptp(heights), 0.2), interpolation="nearest", aspect="auto",
    )  # fmt: skip
    colours = np.array([to_rgba(skill_colour(name), 0.0 if name == "walk" else 0.5) for name in SKILLS])
    regions, extent = colours[region_map(e.course)][None], (0, LANE_LENGTH, -HALF_WIDTH, HALF_WIDTH)
    axis.imshow(regions, extent=extent, aspect="auto", interpolation="nearest")
    x, y = e.qpos[:, :2].T
    axis.plot(x, y, color="black", linewidth=1.0)
    chosen = [skill_colour(e.skills[k]) for k in e.skill[e.wrong]]
    axis.scatter(x[e.wrong], y[e.wrong], s=26, c=chosen, edgecolors="black", linewidths=0.5, zorder=4)
    axis.set(xlim=(0, e.course.waypoints[:, 0].max() + 1.0), ylim=(-HALF_WIDTH, HALF_WIDTH), ylabel="y [m]")
    axis.set_title(
        f"{e.environment}, episode {n}, d = {e.course.difficulty:.2f}: wrong in {100 * e.wrong.mean():.0f} % of its steps",
        loc="left", fontsize=12,
    )  # fmt: skip
    axis.grid(visible=False)


def draw(played: list[list[Episode]], folder: Path, command: str) -> list[Path]:
    """Write the three figures; return their paths."""
    figures = {"confusion": confusion_figure, "timeline": timeline_figure, "mistakes": mistakes_figure}
    names = {kind: folder / f"diagnose-{played[0][0].policy}-{kind}.png" for kind in figures}
    return [path for kind, make in figures.items() for path in save_figure(make(played), names[kind], command)]

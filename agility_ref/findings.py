"""Findings: what the paper's abstract, its sections 4.2 and 4.3 and its Table 1 say, asked of our cells.

One function a claim.  Unless the claim names another quantity, the measure is the waypoint
fraction: rewards depend on weights that differ from the paper's, and a long episode is
neither good nor bad in itself.  :mod:`agility_ref.verdicts` has the rule.

In:  :class:`~agility_ref.evidence.Evidence`.  Out: a list of :class:`~agility_ref.verdicts.Finding`.
"""

from collections.abc import Callable
from itertools import product
from math import nan
from pathlib import Path

import numpy as np

from agility_ref.bank import TrainConfig
from agility_ref.cells import Cells, seeds_of
from agility_ref.evidence import Evidence, gather
from agility_ref.policies import ENVIRONMENTS, find_policy
from agility_ref.progress import write_text
from agility_ref.verdicts import Comparison, Finding, markdown, over_seeds, paired

SELECTORS, GENERALISTS = ("oracle", "ps-sl-5"), ("gen-3", "gen-5")
FLICKER = 2.0  # a selector flickers if it switches more than this many times as often as the oracle would
COLLAPSE = 0.95  # ... and has collapsed if one skill acts for more than this share of an episode
EQUAL = 0.1  # terrains are equally hard if the waypoint fraction differs by less than this
EARLY = 0.25  # "early" is at this share of the shortest specialist's training after the warm start

# The specialists that a generalist replaces.  Without walk, from which all of these start.
REPLACED = {"gen-3": ("climb", "leap"), "gen-5": ("climb-up", "climb-down", "leap", "beam")}
# The specialist of each terrain, and the oracle's other skills.
OWN = {"gap": "leap", "beam": "beam", "climb": "climb"}
FOREIGN = {
    "gap": ("climb-up", "climb-down", "beam", "walk"),
    "beam": ("climb-up", "climb-down", "leap", "walk"),
    "climb": ("climb-up", "climb-down", "leap", "beam", "walk"),
}
BASELINE, NO_CURRICULUM, ACTION_STACKING = "baseline", "no-curriculum", "action-repeat"
SEEN = "The learned selectors have trained on Climb+Gap courses, their skills and the generalists on climbing and leaping apart."


# ---------------------------------------------------------------------------- section 4.3, selectors and generalists


def selectors_win_where_one_skill_is_asked_for(e: Evidence) -> Finding:
    """Judge "outperform the generalists in skill-specific environments (Gap, Beam, Climb)"."""
    return Finding(
        "Oracle and PS-SL-5 outperform the generalists on Gap, Beam and Climb.", "section 4.3",
        "Waypoint fraction of each selector minus that of each generalist.",
        tuple(e.compare((s, t), (g, t)) for t, s, g in product(("gap", "beam", "climb"), SELECTORS, GENERALISTS)),
    )  # fmt: skip


def generalists_win_on_climb_gap(e: Evidence) -> Finding:
    """Judge "the generalist outperforms in more difficult and dynamic terrains (Climb+Gap)"."""
    return Finding(
        "The generalists outperform Oracle and PS-SL-5 on Climb+Gap.", "section 4.3",
        f"Waypoint fraction of each generalist minus that of each selector.  {SEEN}",
        tuple(e.compare((g, "climb-gap"), (s, "climb-gap")) for g, s in product(GENERALISTS, SELECTORS)),
    )  # fmt: skip


def generalists_win_reward_on_climb_gap(e: Evidence) -> Finding:
    """The same in reward, the column of Table 1 that bears the paper's sentence out."""
    return Finding(
        "The generalists earn more reward than Oracle and PS-SL-5 on Climb+Gap.", "section 4.3 and Table 1",
        "Reward of an episode; the weights of its terms are not the paper's.",
        tuple(e.compare((g, "climb-gap"), (s, "climb-gap"), "reward") for g, s in product(GENERALISTS, SELECTORS)),
    )  # fmt: skip


def rl_selector_wins_waypoints_on_climb_gap(e: Evidence) -> Finding:
    """Judge "the RL+PPO-based Selector outperforms the generalist in reaching waypoints in the hardest terrain"."""
    return Finding(
        "PS-RL-3 reaches more waypoints than PS-SL-5 and the generalists on Climb+Gap.", "section 4.3 and Table 1",
        f"Waypoint fraction of PS-RL-3 minus that of each of the others.  {SEEN}",
        tuple(e.compare(("ps-rl-3", "climb-gap"), (p, "climb-gap")) for p in ("ps-sl-5", *GENERALISTS)),
    )  # fmt: skip


def _flickers_or_collapses(e: Evidence, policy: str, reward: str) -> Finding:
    seeds = seeds_of(e.cells, policy, "climb-gap")
    names = ("switches_per_second", "wanted_switches_per_second", "commonest_share", "wanted_commonest_share")
    switches, wanted, share, wanted_share = (e.scores(policy, "climb-gap", name, seeds) for name in names)
    return Finding(
        f"PS-RL-3 trained on {reward} keeps switching, or collapses to one skill.", "sections 4.2 and 4.3",
        f"On Climb+Gap, against what the oracle asks for along the same path.  It flickers if it switches more than "
        f"{FLICKER:g} times as often; it has collapsed if its commonest skill acts for more than {COLLAPSE:.0%} of the "
        "episode, and for more than the oracle's would.",
        (
            paired(f"{policy}: switches/s - {FLICKER:g} x wanted", switches, FLICKER * wanted if seeds else None),
            paired(
                f"{policy}: share of one skill - {COLLAPSE:g} or wanted",
                share, np.maximum(COLLAPSE, wanted_share) if seeds else None,
            ),
        ),
        any_of=True,
    )  # fmt: skip


def rl_selector_on_reward_is_unsteady(e: Evidence) -> Finding:
    """Judge "keeps switching its predicted policy" and "mode collapse", for the original reward."""
    return _flickers_or_collapses(e, "ps-rl-3-env", "the environment's reward")


def rl_selector_on_oracle_reward_is_unsteady(e: Evidence) -> Finding:
    """Judge the same for the oracle's reward."""
    return _flickers_or_collapses(e, "ps-rl-3-oracle", "the oracle's reward")


# ---------------------------------------------------------------------------- section 4.3 and Table 1, terrains


def specialists_fail_elsewhere(e: Evidence) -> Finding:
    """Judge what Table 1 shows: on each terrain the specialists of other terrains fall behind its own."""
    return Finding(
        "Specialists fail off their own course.", "Table 1",
        "Waypoint fraction of the terrain's own specialist minus that of each other of the oracle's five skills there.",
        tuple(e.compare((OWN[t], t), (other, t)) for t in OWN for other in FOREIGN[t]),
    )  # fmt: skip


def climb_gap_is_the_hardest(e: Evidence) -> Finding:
    """Judge "climb = leap = plank < climb and leap", its second half."""
    easier = [("ps-sl-5", t) for t in ("climb", "gap", "beam")] + [("ps-rl-3", t) for t in ("climb", "gap")]
    return Finding(
        "Climb+Gap is harder for the learned selectors than Climb, Gap and Beam.", "section 4.3",
        "Waypoint fraction of one selector on two terrains; PS-RL-3 has no skill for beams.  How hard a terrain is "
        "depends on its dimensions, and those of Beam and Climb+Gap are ours.",
        tuple(e.compare(side, (side[0], "climb-gap")) for side in easier),
    )  # fmt: skip


def other_terrains_are_equally_hard(e: Evidence) -> Finding:
    """Judge "climb = leap = plank", the first half: equality needs a margin."""
    pairs = (("climb", "gap"), ("gap", "beam"), ("climb", "beam"))
    return Finding(
        "Climb, Gap and Beam are equally hard for PS-SL-5.", "section 4.3",
        f"Waypoint fraction on two terrains; equal if the interval lies within +-{EQUAL}, unequal if it lies outside.",
        tuple(e.compare(("ps-sl-5", a), ("ps-sl-5", b), margin=EQUAL) for a, b in pairs),
    )  # fmt: skip


# ---------------------------------------------------------------------------- abstract, learning curves


def _level_differences(e: Evidence, generalist: str, late: bool) -> np.ndarray:
    """Level of the generalist minus the mean level of the specialists that it replaces, (S,).

    The generalist's is that on the courses of those specialists.  Early: all after the same
    number of steps, warm start included.  Late: each at its end.
    """
    names, found = (generalist, *REPLACED[generalist]), []
    for seed in sorted({seed for _, seed in e.curves}):
        if not all((name, seed) in e.curves for name in names):
            continue
        own, *curves = (e.curves[name, seed] for name in names)
        kinds = [f"level_{find_policy(name).courses[0]}" for name in names[1:]]
        if not all(kind in own for kind in kinds):
            continue
        start, end = max(c["steps"][0] for c in (own, *curves)), min(c["steps"][-1] for c in curves)
        at = start + EARLY * (end - start)
        pairs = [((own["steps"], own[kind]), (c["steps"], c["level"])) for kind, c in zip(kinds, curves, strict=True)]
        levels = [[level[-1] if late else np.interp(at, steps, level) for steps, level in pair] for pair in pairs]
        found.append(np.mean([generalist_level - level for generalist_level, level in levels]))
    return np.array(found)


def generalists_learn_faster_early(e: Evidence) -> Finding:
    """Judge "a generalist exhibits accelerated early-stage learning"."""
    return Finding(
        "Generalists learn faster early.", "abstract",
        f"Level of the curriculum after {EARLY:.0%} of the shortest specialist's training, all after the same number of "
        "steps: the generalist's on their courses minus the mean of the specialists that it replaces.",
        tuple(over_seeds(f"{g}: early level", _level_differences(e, g, late=False)) for g in REPLACED),
    )  # fmt: skip


def generalists_plateau_below(e: Evidence) -> Finding:
    """Judge "its performance tends to plateau at a suboptimal level"."""
    return Finding(
        "Generalists plateau below the specialists.", "abstract",
        "Level of the curriculum at the end of training: the mean of the specialists minus the generalist's on their "
        "courses; Table 1 prints the steps of each.",
        tuple(over_seeds(f"{g}: final level", -_level_differences(e, g, late=True)) for g in REPLACED),
    )  # fmt: skip


# ---------------------------------------------------------------------------- section 4.2, ablations


def _ablation(e: Evidence, name: str) -> Comparison:
    """Compare the baseline with one ablation, per seed and policy, each at the end of its training."""
    last: dict[tuple[str, str, int], tuple[int, float]] = {}
    for row in e.ablations:
        key = (row["ablation"], row["policy"], row["seed"])
        last[key] = max(last.get(key, (-1, nan)), (row["steps"], row["waypoint_fraction"]))
    both = {(p, s) for a, p, s in last if a == name and (BASELINE, p, s) in last}
    policies = sorted({p for p, _ in both})
    seeds = sorted(s for s in {s for _, s in both} if all((p, s) in both for p in policies))
    differences = [[last[BASELINE, p, s][1] - last[name, p, s][1] for p in policies] for s in seeds]
    return over_seeds(f"{BASELINE} - {name}" + (f" ({', '.join(policies)})" if policies else ""), np.array(differences))


def curriculum_is_crucial(e: Evidence) -> Finding:
    """Judge "Curriculum is crucial for the robot to learn anything"."""
    return Finding(
        "Curriculum is crucial.", "section 4.2",
        "Waypoint fraction of policies trained with the curriculum minus that of the same trained without.",
        (_ablation(e, NO_CURRICULUM),),
    )  # fmt: skip


def action_stacking_hurts(e: Evidence) -> Finding:
    """Judge "Action stacking (repeating the same action for multiple timesteps) worsened the performance"."""
    names = sorted({row["ablation"] for row in e.ablations if row["ablation"].startswith(ACTION_STACKING)})
    return Finding(
        "Action stacking hurts.", "section 4.2",
        "Waypoint fraction of policies that choose every action minus that of policies that hold each for some steps.",
        tuple(_ablation(e, name) for name in names or [ACTION_STACKING]),
    )  # fmt: skip


CLAIMS: tuple[Callable[[Evidence], Finding], ...] = (
    selectors_win_where_one_skill_is_asked_for,
    generalists_win_on_climb_gap,
    generalists_win_reward_on_climb_gap,
    rl_selector_wins_waypoints_on_climb_gap,
    rl_selector_on_reward_is_unsteady,
    rl_selector_on_oracle_reward_is_unsteady,
    specialists_fail_elsewhere,
    climb_gap_is_the_hardest,
    other_terrains_are_equally_hard,
    generalists_learn_faster_early,
    generalists_plateau_below,
    curriculum_is_crucial,
    action_stacking_hurts,
)


# ---------------------------------------------------------------------------- all of them


def check(cells: Cells, training: TrainConfig, ablations: Path) -> list[Finding]:
    """Judge every claim by the cells of a table; see :func:`agility_ref.evidence.gather`."""
    policies = {name for generalist, replaced in REPLACED.items() for name in (generalist, *replaced)}
    evidence = gather(cells, training, ablations, policies)
    return [claim(evidence) for claim in CLAIMS]


def compare(cells: Cells, policies: tuple[str, ...]) -> list[Comparison]:
    """Compare the first policy's waypoint fraction with that of each other one, terrain by terrain."""
    evidence = Evidence(cells, {}, [])
    return [evidence.compare((policies[0], t), (other, t)) for other in policies[1:] for t in ENVIRONMENTS]


def write(findings: list[Finding], folder: Path, caption: str) -> Path:
    """Write findings.md; return its path."""
    path = Path(folder) / "findings.md"
    write_text(path, markdown(findings, caption))
    return path

"""The policies of Table 1, as data: what each is, trains on and may spend.

Paper sections 3.1.1 (specialists), 3.2 (selectors), 4 (generalists) and 5 (the post-generalist,
its future work).  Budgets are in environment steps and **include the warm start**; a generalist may
spend as much as all the specialists it replaces together.
"""

from dataclasses import dataclass

from agility_ref.curriculum import PRESETS
from agility_ref.errors import unknown_name

ENVIRONMENTS = ("climb-gap", "gap", "beam", "climb")  # the column blocks of Table 1, in its order


@dataclass(frozen=True)
class PolicySpec:
    """One row of Table 1."""

    name: str
    label: str  # as the paper prints it, where it does
    method: str  # ppo, oracle, supervised (selector), ppo-selector or distilled
    courses: tuple[str, ...] = ()  # course kinds it trains on; the curriculum says how often each
    budget: tuple[int, int] = (0, 0)  # environment steps under (quick, full), warm start included
    warm_start: str | None = None  # policy whose weights it starts from
    skills: tuple[str, ...] = ()  # frozen policies that a selector chooses from, in the order of its outputs
    teachers: tuple[str, ...] = ()
    """Frozen policies that a distilled one imitates, each where the oracle would choose it."""
    reward: str = "environment"  # what a ppo-selector is rewarded with: environment, or oracle (+1 right, -1 wrong)

    def steps(self, preset: str) -> int:
        """Budget in environment steps under a preset."""
        return self.budget[list(PRESETS).index(preset)]


M = 1_000_000
FIVE = ("walk", "climb-up", "climb-down", "leap", "beam")  # in the order of terrain.SKILLS
THREE = ("walk", "climb", "leap")
SEVEN = ("climb-up", "climb-down", "climb", "gap", "beam", "walk", "climb-gap")  # all kinds of course

_SPECS = (
    PolicySpec("climb-up", "CU", "ppo", ("climb-up",), (2_400_000, 6 * M), "walk"),
    PolicySpec("climb-down", "CD", "ppo", ("climb-down",), (2 * M, 4 * M), "walk"),
    PolicySpec("leap", "Leap", "ppo", ("gap",), (4 * M, 12 * M), "walk"),
    PolicySpec("beam", "Beam", "ppo", ("beam",), (3 * M, 10 * M), "walk"),
    PolicySpec("walk", "Walk", "ppo", ("walk",), (1_200_000, 2 * M)),
    PolicySpec("climb", "Climb", "ppo", ("climb",), (3 * M, 6 * M), "walk"),
    PolicySpec("oracle", "Oracle", "oracle", skills=FIVE),
    PolicySpec(
        "ps-rl-3-env", "PS-RL-3 (env)", "ppo-selector", ("climb", "gap", "climb-gap"),
        (300_000, 2 * M), skills=THREE,
    ),
    PolicySpec(
        "ps-rl-3-oracle", "PS-RL-3 (oracle)", "ppo-selector", ("climb", "gap", "climb-gap"),
        (300_000, 2 * M), skills=THREE, reward="oracle",
    ),
    PolicySpec("ps-sl-5", "PS-SL-5", "supervised", SEVEN, (300_000, 1 * M), skills=FIVE),
    PolicySpec("gen-3", "GEN-3", "ppo", ("climb", "gap", "walk"), (5_800_000, 16 * M), "walk"),
    PolicySpec(
        "gen-5", "GEN-5", "ppo", ("climb-up", "climb-down", "gap", "beam", "walk"),
        (7_800_000, 26 * M), "walk",
    ),
    PolicySpec("distilled", "Distilled", "distilled", SEVEN, (300_000, 1 * M), teachers=FIVE),
    PolicySpec(
        "post-gen", "Post-GEN", "ppo", ("climb", "gap", "beam", "walk", "climb-gap"),
        (2_500_000, 6 * M), "distilled",
    ),
)  # fmt: skip
POLICIES = {spec.name: spec for spec in _SPECS}
ALIASES = {"ps-rl-3": "ps-rl-3-oracle"}  # the paper does not say which of the two its Table 1 shows
TABLE_ROWS = (
    "climb-up", "climb-down", "leap", "beam", "walk", "climb", "oracle", "ps-rl-3", "ps-sl-5", "gen-3", "gen-5",
)  # fmt: skip


def find_policy(name: str) -> PolicySpec:
    """Look a policy up by its command-line name.

    Raises
    ------
    UserError : no such policy
    """
    name = ALIASES.get(name, name)
    if name not in POLICIES:
        raise unknown_name("policy", name, [*POLICIES, *ALIASES])
    return POLICIES[name]


def requirements(name: str) -> tuple[str, ...]:
    """Names of the policies that must be trained before this one, in order."""
    spec = find_policy(name)
    first = ((spec.warm_start,) if spec.warm_start else ()) + spec.skills + spec.teachers
    ordered: list[str] = []
    for other in first:
        ordered += [p for p in (*requirements(other), other) if p not in ordered]
    return tuple(ordered)

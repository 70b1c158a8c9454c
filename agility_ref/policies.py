"""The policies of Table 1, as data: what each is, trains on and may spend, and with which PPO.

Paper sections 3.1.1 (specialists), 3.2 (selectors), 4 (generalists) and 5 (the post-generalist,
its future work).  Budgets are in environment steps and **include the warm start**; a generalist may
spend as much as all the specialists it replaces together.
"""

from dataclasses import dataclass

from agility_ref.errors import unknown_name

ENVIRONMENTS = ("climb-gap", "gap", "beam", "climb")  # the column blocks of Table 1, in its order


@dataclass(frozen=True)
class PPOConfig:
    """Hyper-parameters, the same for every policy of Table 1 unless said otherwise."""

    num_envs: int = 256
    """Robots simulated side by side; usual 64 to 4096."""
    num_steps: int = 16
    """Control steps per robot and iteration; usual 16 to 64."""
    update_epochs: int = 4
    """Passes over the batch per iteration; usual 3 to 10."""
    num_minibatches: int = 4
    """Minibatches per pass; usual 2 to 8."""
    gamma: float = 0.99
    """Discount per control step; usual 0.97 to 0.995."""
    gae_lambda: float = 0.95
    """Weight of longer returns in the advantage; usual 0.9 to 0.97."""
    clip_coef: float = 0.2
    """How far the policy ratio may move before its gradient stops; usual 0.1 to 0.3."""
    ent_coef: float = 0.005
    """Weight of the entropy bonus; usual 0 to 0.01."""
    max_grad_norm: float = 1.0
    """Gradients of actor and of critic are each scaled down to this norm; usual 0.5 to 1."""
    learning_rate: float = 1e-3
    """Start of the adaptive rate; usual 3e-4 to 1e-3."""
    learning_rate_min: float = 1.5e-4
    """Floor of the adaptive rate; 1e-5 stalls at batches of 4096."""
    learning_rate_max: float = 3e-3
    """Ceiling of the adaptive rate."""
    critic_learning_rate: float = 0.0
    """Step size of the critic; 0 for the actor's of the moment.  Set it where that becomes small; usual 5e-4 to 1e-3."""
    target_kl: float = 0.02
    """KL divergence per minibatch that the rate is steered to; usual 0.005 to 0.02."""
    init_std: float = 0.8
    """Standard deviation of the first policy; usual 0.5 to 1."""
    final_std: float = 0.2
    """The standard deviation may not exceed a line from init_std to this; usual 0.1 to 0.3, init_std for no limit."""
    anneal_share: float = 0.25
    """Last share of the steps in which KL target and lowest step size fall to zero; 0 for never."""
    mirror: bool = False
    """Learn from the mirror images, left for right, of every other robot's steps; skills only."""
    hidden: tuple[int, ...] = (256, 128)
    """Units of the hidden layers of actor and critic."""

    @property
    def batch_size(self) -> int:
        """Environment steps per iteration."""
        return self.num_envs * self.num_steps


@dataclass(frozen=True)
class Preset:
    """A scale at which the whole table can be trained."""

    name: str
    max_difficulty: float
    """Hardest difficulty in training, and the top of the range in evaluation."""


PRESETS = {"quick": Preset("quick", 0.4), "full": Preset("full", 1.0)}


@dataclass(frozen=True)
class PolicySpec:
    """One row of Table 1."""

    name: str
    label: str
    """As the paper prints it, where it does."""
    method: str
    """ppo, oracle, supervised (selector), ppo-selector or distilled."""
    courses: tuple[str, ...] = ()
    """Course kinds it trains on, in equal shares."""
    budget: tuple[int, int] = (0, 0)
    """Environment steps under (quick, full), warm start included."""
    warm_start: str | None = None
    """Policy whose weights it starts from."""
    skills: tuple[str, ...] = ()
    """Frozen policies that a selector chooses from, in the order of its outputs."""
    teachers: tuple[str, ...] = ()
    """Frozen policies that a distilled one imitates, each where the oracle would choose it."""
    reward: str = "environment"
    """What a ppo-selector is rewarded with: environment, or oracle (+1 right, -1 wrong)."""

    def steps(self, preset: str) -> int:
        """Budget in environment steps under a preset."""
        return self.budget[list(PRESETS).index(preset)]


M = 1_000_000
FIVE = ("walk", "climb-up", "climb-down", "leap", "beam")  # in the order of terrain.SKILLS
THREE = ("walk", "climb", "leap")
SEVEN = ("climb-up", "climb-down", "climb", "gap", "beam", "walk", "climb-gap")  # all kinds of course

_SPECS = (
    PolicySpec("climb-up", "CU", "ppo", ("climb-up",), (2_300_000, 10 * M), "walk"),
    PolicySpec("climb-down", "CD", "ppo", ("climb-down",), (2_000_000, 8 * M), "walk"),
    PolicySpec("leap", "Leap", "ppo", ("gap",), (2_600_000, 15 * M), "walk"),
    PolicySpec("beam", "Beam", "ppo", ("beam",), (2_300_000, 15 * M), "walk"),
    PolicySpec("walk", "Walk", "ppo", ("walk",), (1_500_000, 2 * M)),
    PolicySpec("climb", "Climb", "ppo", ("climb",), (2_500_000, 12 * M), "walk"),
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
    PolicySpec("gen-3", "GEN-3", "ppo", ("climb", "gap", "walk"), (3_600_000, 25 * M), "walk"),
    PolicySpec(
        "gen-5", "GEN-5", "ppo", ("climb-up", "climb-down", "gap", "beam", "walk"),
        (4_700_000, 42 * M), "walk",
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


def find_preset(name: str) -> Preset:
    """Look a preset up.

    Raises
    ------
    UserError : no such preset
    """
    if name not in PRESETS:
        raise unknown_name("preset", name, PRESETS)
    return PRESETS[name]


def requirements(name: str) -> tuple[str, ...]:
    """Names of the policies that must be trained before this one, in order."""
    spec = find_policy(name)
    first = ((spec.warm_start,) if spec.warm_start else ()) + spec.skills + spec.teachers
    ordered: list[str] = []
    for other in first:
        ordered += [p for p in (*requirements(other), other) if p not in ordered]
    return tuple(ordered)

"""Wrong answers to assignment 4."""

from mutants import Mutant

NET, FRONTIER = "hw4/symmetry.py", "hw4/frontier.py"

MUTANTS = (
    Mutant(
        "hips keep their sign",
        NET,
        (('-1.0 if joint.endswith("hip") else 1.0', "1.0"),),
        "test_joint_mirror_is_a_mirror",
        "become 0.1 and -0.3",
    ),
    Mutant(
        "thighs flipped too",
        NET,
        (('-1.0 if joint.endswith("hip") else 1.0', '1.0 if joint.endswith("calf") else -1.0'),),
        "test_joint_mirror_of_the_robot",
        "from where its mirror image is",
    ),
    Mutant(
        "summed, not averaged",
        NET,
        (("return (weight + p_out @ weight @ p_in) / 2", "return weight + p_out @ weight @ p_in"),),
        "test_symmetric_part_by_hand",
        r"\[\[4.5, 3\], \[3, 4.5\]\]",
    ),
    Mutant(
        "mirrored on one side only",
        NET,
        (("(weight + p_out @ weight @ p_in) / 2", "(weight + p_out @ weight) / 2"),),
        "test_symmetric_part_is_a_projection",
        "not equivariant",
    ),
    Mutant(
        "symmetric at the start only",
        NET,
        (
            ("weight = symmetric_part(self.weight, self.p_in, self.p_out)\n", "weight = self.weight\n"),
            (
                "self.weight = nn.Parameter(torch.randn(len(p_out), len(p_in)) * (2 / len(p_in)) ** 0.5)",
                "self.weight = nn.Parameter(symmetric_part(torch.randn(len(p_out), len(p_in)) / len(p_in) ** 0.5, p_in, p_out))",
            ),
        ),
        "test_layer_is_equivariant",
        "arbitrary parameters",
    ),
    Mutant(
        "a free bias",
        NET,
        (("bias = (self.bias + self.p_out @ self.bias) / 2", "bias = self.bias"),),
        "test_layer_is_equivariant",
        "the bias too",
    ),
    Mutant(
        "no bias at all",
        NET,
        (("return x @ weight.T + bias", "return x @ weight.T"),),
        "test_layer_learns_every_equivariant_map",
        "bias included",
    ),
    Mutant(
        "the output's mirror inside",
        NET,
        (("*map(pair_swap, pairs)", "*(torch.diag(torch.tensor([1.0] * k + [-1.0] * k)) for k in pairs)"),),
        "test_net_is_equivariant",
        "differ by up to",
    ),
    Mutant(
        "no nonlinearity",
        NET,
        (("x = nn.functional.elu(layer(x))", "x = layer(x)"),),
        "test_net_bends",
        "is linear",
    ),
    Mutant(
        "every episode counts",
        FRONTIER,
        (("            if level != self.level:\n                continue\n", ""),),
        "test_frontier_ignores_other_levels",
        "say nothing",
    ),
    Mutant(
        "a sliding window",
        FRONTIER,
        (
            ("if len(self.scores) == self.window:", "if len(self.scores) >= self.window:"),
            ("mean = np.mean(self.scores)", "mean = np.mean(self.scores[-self.window :])"),
            ("                self.scores = []\n", "                self.scores = [] if step else self.scores\n"),
        ),
        "test_frontier_counts_anew",
        "counting starts anew",
    ),
    Mutant(
        "easier includes the frontier",
        FRONTIER,
        (("rng.integers(0, self.level, below.sum())", "rng.integers(0, self.level + 1, below.sum())"),),
        "test_draw_shares",
        "not 0.6[5-9]|1 - easier",
    ),
    Mutant(
        "agility_ref's own functions",
        FRONTIER,
        (("class Frontier:", "from agility_ref.curriculum import Curriculum\n\n\nclass Frontier(Curriculum):"), ("        self.levels, self.window", "        super().__init__(1, levels)\n        self.levels, self.window")),
        "test_frontier_by_hand",
        "agility_ref's own are others",
    ),
)  # fmt: skip

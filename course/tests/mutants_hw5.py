"""Wrong answers to assignment 5."""

from mutants import Mutant

FILE = "hw5/selector.py"

MUTANTS = (
    Mutant(
        "the oracle's order of skills",
        FILE,
        (("np.array([SKILLS.index(name) for name in terrain.SKILLS])", "np.arange(5)"),),
        "test_labels_by_hand",
        "different orders",
    ),
    Mutant(
        "rounded to the nearest cell",
        FILE,
        (("np.floor(x / cell)", "np.round(x / cell)"),),
        "test_labels_of_random_courses",
        "the oracle says",
    ),
    Mutant(
        "not seeded",
        FILE,
        (("        torch.manual_seed(seed)\n", ""),),
        "test_fit_is_quick_and_repeatable",
        "seed everything",
    ),
    Mutant(
        "hardly fitted",
        FILE,
        (("for _ in range(400):", "for _ in range(5):"),),
        "test_held_out_accuracy",
        "at least 0.88 is needed",
    ),
    Mutant(
        "margin against the runner-up",
        FILE,
        (
            (
                "ahead = probabilities[rows, best] - probabilities[rows, held]",
                "ahead = probabilities[rows, best] - np.sort(probabilities, axis=1)[:, -2]",
            ),
        ),
        "test_choose_by_hand",
        "it is above 0.1: take 0",
    ),
    Mutant(
        "precision for recall",
        FILE,
        (
            ("counts = labels.sum(axis=0)", "counts = np.bincount(chosen, minlength=5)"),
        ),
        "test_recall_by_hand",
        "2 are walked",
    ),
    Mutant(
        "labelled by the learner",
        FILE,
        (
            (
                "            right |= rng.random(runners.n) < oracle_share\n",
                "            right |= rng.random(runners.n) < oracle_share\n            wanted = np.eye(5)[chosen]\n",
            ),
        ),
        "test_collect_with_a_learner",
        "the oracle labels",
    ),
    Mutant(
        "a buffer kept, not copied",
        FILE,
        (("runners.observe().copy()", "runners.observe()"),),
        "test_collect_with_the_oracle",
        "copied before",
    ),
    Mutant(
        "label after the step",
        FILE,
        (
            ("        labels.append(wanted)\n        runners.step(right)\n", "        runners.step(right)\n        labels.append(label(runners.regions, runners.cell, runners.course, runners.x))\n"),
        ),
        "test_collect_with_the_oracle",
        "belongs to the state",
    ),
    Mutant(
        "the last round alone",
        FILE,
        (("for part in zip(*data, strict=True)", "for part in zip(*data[-1:], strict=True)"),),
        "test_dagger_collects_where_the_learner_goes",
        "everything so far",
    ),
    Mutant(
        "the oracle always acts",
        FILE,
        (("data.append(collect(runners, steps, selector, rng))", "data.append(collect(runners, steps, None, rng))"),),
        "test_dagger_collects_where_the_learner_goes",
        "with its mistakes",
    ),
    Mutant(
        "agility_ref's own functions",
        FILE,
        (
            ("        torch.set_num_threads(1)\n", "        from agility_ref.training.imitation import SupervisedConfig, fit_selector\n\n        self.arrays = fit_selector(scandots, labels, 5, SupervisedConfig(), seed)\n        torch.set_num_threads(1)\n"),
            ("    seen, labels = [], []\n", "    from agility_ref.training.imitation import collect_labels\n\n    return collect_labels(runners, selector, selector, steps)\n"),
        ),
        "test_collect_with_the_oracle",
        "agility_ref's own are others",
    ),
)  # fmt: skip

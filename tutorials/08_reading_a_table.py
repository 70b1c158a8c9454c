# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # 8. Reading a table: what may be claimed
#
# Table 1 has 43 cells, each a mean with a ± behind it.  This tutorial asks what that ± says, why two policies should
# play the same courses, what a training seed is, and how often an interval of "95 %" is wrong if it rests on few of
# them.  Nothing is trained here: two generalists that ship with the package play, and the rest is chance that we
# simulate, where the truth is known.
#
# It takes about half a minute on two cores.  As a notebook it shows its figures below the cells; `python tutorials/08_reading_a_table.py`
# writes them into the folder `figures/` of the directory you start it from.

# %%
import time

from agility_ref.evaluate import EvaluationConfig, evaluate
from agility_ref.pictures.plots import BLUE, GREEN, GREY, ORANGE, RED, new_figure, show
from agility_ref.results.findings import over_seeds, paired
from agility_ref.stats import bootstrap_interval, paired_difference, t_interval
from agility_ref.training.bank import load_policy
from agility_ref.training.runs import TrainConfig
from agility_ref.training.weights import shipped_seeds

import numpy as np

STARTED = time.perf_counter()
POLICIES, TERRAINS = ("distilled", "gen-5"), ("climb-gap", "gap")
SEEDS = shipped_seeds("full", "distilled")  # those of gen-5 too
COLOURS = dict(zip(POLICIES, (BLUE, ORANGE), strict=True))
settings = EvaluationConfig(episodes=32)

# %% [markdown]
# ## 8.1 What the ± says
#
# Two generalists: `gen-5`, which PPO trained on the courses of five skills, and `distilled`, which imitates a bank of
# five specialists.  Each was trained anew with every one of `SEEDS`, and all of these networks play the same 32 courses of
# two terrains: $x_{s,e}$ is the fraction of the waypoints that the network of seed $s$ reaches in episode $e$.

# %%
scores, difficulty = {}, {}  # (policy, terrain) -> (S, E) waypoint fractions; terrain -> (E,)
for policy in POLICIES:
    for terrain in TERRAINS:
        played = [evaluate(load_policy(policy, TrainConfig(seed=seed)), terrain, settings) for seed in SEEDS]
        scores[policy, terrain] = np.array([evaluation.waypoint_fraction for evaluation in played])
        difficulty[terrain] = played[0].difficulty  # (E,), the same for all

for (policy, terrain), x in scores.items():
    print(f"{policy:10} on {terrain:10} {x[0].mean():.2f} ± {x[0].std():.2f} (seed 0, as Table 1 prints it)")

# %% [markdown]
# **Predict, then run.**  We keep only 8, 16 and 32 of the episodes of one network.  What becomes of the ±, and what of the
# bootstrap interval of the mean?
#
# *What you should see:* on the left, easy courses (small $d$) are mostly finished and hard ones are not.  On the right, the
# grey bars (± one standard deviation) stay about as long, while the coloured intervals of the mean get shorter.

# %%
x, d = scores["gen-5", "climb-gap"][0], difficulty["climb-gap"]
figure, axes = new_figure(1, 2, (10.0, 3.8))
left, right = axes[0]
left.scatter(d, x, color=ORANGE)
left.set(
    xlabel="difficulty d of the course [-]",
    ylabel="waypoint fraction [-]",
    title="gen-5 on climb-gap, one dot per episode",
)
for row, episodes in enumerate((8, 16, 32)):
    part = x[:episodes]
    low, high = bootstrap_interval(part, np.mean)
    right.plot([part.mean() - part.std(), part.mean() + part.std()], [row + 0.12] * 2, color=GREY, linewidth=3)
    right.plot([low, high], [row - 0.12] * 2, color=ORANGE, linewidth=3)
    right.plot(part.mean(), row, "o", color="black", markersize=5)
    print(
        f"{episodes:3} episodes: {part.mean():.2f} ± {part.std():.2f}, 95 % interval of the mean [{low:.2f}, {high:.2f}]"
    )
right.set_yticks(range(3), ["8 episodes", "16 episodes", "32 episodes"])
right.set(xlabel="waypoint fraction [-]", title="grey: ± std of episodes; orange: interval of the mean")
for axis in (left, right):
    axis.grid(alpha=0.3)
show(figure, "08_spread_and_interval")

# %% [markdown]
# <details><summary>Answer</summary>
#
# The ± is the spread **between episodes**, mostly that between easy and hard courses.  It describes the courses, and more
# episodes do not make it smaller.  The interval is about the **mean**, and four times as many episodes halve it:
#
# $$\text{interval of the mean} \approx \bar x \pm 1.96\, \frac{\sigma}{\sqrt{E}}$$
#
# So "0.6 ± 0.3 against 0.5 ± 0.3" says nothing about whether the two differ.  To read the ± as an error bar is the
# commonest mistake with such tables.
#
# </details>

# %% [markdown]
# ## 8.2 Pairs
#
# Both policies play the same courses with the same noise and the same pushes.  Then the difference of an episode is
# free of what both share:
#
# $$\operatorname{Var}(a - b) = \operatorname{Var}(a) + \operatorname{Var}(b) - 2 \operatorname{Cov}(a, b)$$
#
# **Predict, then run.**  Will the interval of the paired difference be narrower than that of two independent sets of
# courses, and what decides by how much?

# %%
print("seed 0, distilled minus gen-5:")
for terrain in TERRAINS:
    a, b = (scores[policy, terrain][0] for policy in POLICIES)
    mean, low, high = paired_difference(a, b)
    # as if b had played other courses: its episodes in another order, so that nothing is shared
    shuffled = [paired_difference(a, np.random.default_rng(k).permutation(b))[1:] for k in range(20)]
    alone = np.diff(shuffled).mean()
    print(
        f"  {terrain:10} {mean:+.2f} [{low:+.2f}, {high:+.2f}], {high - low:.2f} wide in pairs, {alone:.2f} without; "
        f"correlation {np.corrcoef(a, b)[0, 1]:+.2f}"
    )

# %% [markdown]
# <details><summary>Answer</summary>
#
# By as much as the two are correlated.  Where the same courses are hard for both, the correlation is high and the interval
# shrinks; if both fell on the same courses and nowhere else, it would shrink to nothing.  Where each fails for reasons of
# its own, the correlation is near 0 and pairs gain nothing.  They cost nothing either: the same number of episodes is
# played.
#
# </details>

# %% [markdown]
# ## 8.3 Training seeds
#
# All this was about **one** network of each kind.  Whoever asks whether a *recipe* is better must train again, with
# another seed for the initial weights, the courses and the exploration.
#
# *What you should see:* one dot for each network.  Where the dots of one colour lie further apart than the two
# colours, the difference that one pair of networks shows is a matter of luck.

# %%
figure, axes = new_figure(1, 1, (7.0, 3.2))
axis = axes[0, 0]
for column, terrain in enumerate(TERRAINS):
    for shift, policy in ((-0.12, "distilled"), (0.12, "gen-5")):
        means = scores[policy, terrain].mean(axis=1)
        axis.plot(
            [column + shift] * len(SEEDS),
            means,
            "o",
            color=COLOURS[policy],
            markersize=9,
            alpha=0.7,
            label=policy if column == 0 else None,
        )
        print(
            f"{policy:10} on {terrain:10} seeds {np.round(means, 2)}, standard deviation between seeds {means.std(ddof=1):.3f}"
        )
axis.set_xticks(range(len(TERRAINS)), TERRAINS)
axis.set(ylabel="mean waypoint fraction [-]", xlim=(-0.5, len(TERRAINS) - 0.5), ylim=(0, 1))
axis.legend(fontsize=9)
axis.grid(alpha=0.3)
show(figure, "08_seeds")

# %% [markdown]
# ## 8.4 A surprise: a "95 %" interval that is wrong every fourth time
#
# Two intervals for the mean of a recipe are in use.  The **bootstrap** draws seeds with replacement from those that were
# trained, and takes the middle 95 % of the means.  **Student's** assumes that the seeds' means are about normal:
#
# $$\bar x \pm t_{S-1} \frac{s}{\sqrt{S}}, \qquad s^2 = \frac{1}{S-1} \sum_s (x_s - \bar x)^2, \qquad t_1 = 12.7,\; t_2 = 4.30,\; t_9 = 2.26$$
#
# Which of them holds what it promises can be tried out where we know the truth: invent a recipe whose seeds scatter around
# 0.7 with a standard deviation of 0.05, "train" it $S$ times, and ask whether the interval contains 0.7.  Do that 500 times.
#
# **Predict, then run.**  How often is the bootstrap's interval right with three seeds?

# %%
TRUTH, BETWEEN_SEEDS = 0.7, 0.05
rng = np.random.default_rng(0)
counts = (2, 3, 5, 10, 20)


def covers(interval, value=TRUTH):
    """Whether an interval contains a value."""
    return interval[0] <= value <= interval[1]


def invented(seeds, repetitions):
    """Means of the seeds of an invented recipe, (repetitions, seeds)."""
    return rng.normal(TRUTH, BETWEEN_SEEDS, (repetitions, seeds))


coverage = {"bootstrap": [], "Student": []}
for seeds in counts:
    trials = invented(seeds, 500)
    coverage["bootstrap"].append(
        np.mean([covers(bootstrap_interval(x[:, None], np.mean, resamples=500)) for x in trials])
    )
    coverage["Student"].append(np.mean([covers(t_interval(x)) for x in trials]))
    print(
        f"{seeds:3} seeds: the bootstrap covers the truth {coverage['bootstrap'][-1]:.0%}, Student {coverage['Student'][-1]:.0%}"
    )

figure, axes = new_figure(1, 2, (10.0, 3.8))
left, right = axes[0]
for (name, values), colour in zip(coverage.items(), (RED, GREEN), strict=True):
    left.plot(counts, values, "o-", color=colour, label=name)
left.axhline(0.95, color="black", linewidth=0.8, linestyle=":", label="promised")
left.set(xlabel="training seeds S [-]", ylabel="share of intervals that cover the truth [-]", ylim=(0.4, 1.02))
left.set_xticks(counts)
left.legend(fontsize=9, loc="lower right")
half = [np.mean([np.ptp(t_interval(x)) / 2 for x in invented(seeds, 500)]) for seeds in counts]
right.semilogy(counts, half, "o-", color=GREEN)
right.set_xticks(counts)
right.set(
    xlabel="training seeds S [-]",
    ylabel="half width of Student's interval [-]",
    title=f"seeds scatter by {BETWEEN_SEEDS}",
)
for axis in (left, right):
    axis.grid(alpha=0.3, which="both")
show(figure, "08_coverage")

# %% [markdown]
# <details><summary>Answer</summary>
#
# About three times in four.  Three numbers know little of their own spread: if they happen to lie close together, the
# bootstrap, which can only draw what is there, believes that all seeds do.  Student's interval knows about this, and pays:
# its factor for three seeds is 4.3 instead of 1.96, and the right picture shows what is left.  With seeds that scatter by
# 0.05, three of them leave $\pm 0.12$ or so, and no difference below that can be told from luck.  Ten seeds leave a
# third of it.  That is why this project writes "three seeds are too few to settle this" where a paper might print bold
# figures.
#
# </details>

# %% [markdown]
# ## 8.5 Forty-three cells
#
# One more way to fool oneself.  An honest 95 % interval is wrong once in twenty times, and a table has many cells.
#
# **Predict, then run.**  Two recipes are **identical**.  We compare them in 43 cells, three seeds each, and call a cell a
# finding where the interval of the difference lies on one side of 0.  How many findings?

# %%
found = {"bootstrap": [], "Student": []}
for _ in range(20):  # twenty invented tables
    differences = invented(3, 43) - invented(3, 43)
    found["bootstrap"].append(
        sum(not covers(bootstrap_interval(x[:, None], np.mean, resamples=500), 0.0) for x in differences)
    )
    found["Student"].append(sum(not covers(t_interval(x), 0.0) for x in differences))
for name, numbers in found.items():
    print(f"{name:9}: {np.mean(numbers):.1f} findings per table on average, where there is nothing to find")

# %% [markdown]
# <details><summary>Answer</summary>
#
# About two with Student's interval ($43 \cdot 0.05 = 2.2$) and about a quarter of all cells with the bootstrap.  None of
# them exists.  Whoever looks for the best cell of a large table finds one.  The remedy is to say before looking which
# comparisons make up a claim, and how many there are; `agility_ref/results/findings.py` does that for the paper's claims.
#
# </details>

# %% [markdown]
# ## 8.6 What may be claimed
#
# Now back to the two generalists.  The rule of `findings.py`: a claim "A is better than B" is *reproduced* if the interval
# lies above 0, *not reproduced* if it lies below, and else *undecided*, which is a result and not a failure.
#
# *What you should see:* three intervals for each terrain.  The first is about the two networks of seed 0, the second
# resamples seeds and courses together and is too short, as 8.4 has shown, and the third, about recipes, is Student's over
# one difference per seed; with fewer than three seeds `findings.py` gives none, and leaves the claim undecided.

# %%
figure, axes = new_figure(1, 1, (8.0, 3.6))
axis, row, labels = axes[0, 0], 0, []
for terrain in TERRAINS:
    a, b = (scores[policy, terrain] for policy in POLICIES)
    for text, colour, comparison in (
        ("networks of seed 0", GREY, paired("distilled - gen-5", a[:1], b[:1])),
        ("bootstrap, seeds and courses", RED, paired("distilled - gen-5", a, b)),
        (f"Student, {len(SEEDS)} seeds", GREEN, over_seeds("distilled - gen-5", (a - b).mean(axis=1))),
    ):
        axis.plot([comparison.low, comparison.high], [row, row], color=colour, linewidth=4)
        axis.plot(comparison.difference, row, "o", color="black", markersize=6)
        labels.append(f"{terrain}: {text}")
        print(f"{terrain:10} {text:29} {comparison}: {comparison.verdict}")
        row += 1
axis.axvline(0.0, color="black", linewidth=0.8)
axis.set_yticks(range(row), labels)
axis.invert_yaxis()
axis.set(xlabel="waypoint fraction, distilled minus gen-5 [-]")
axis.grid(alpha=0.3)
show(figure, "08_claims")
print(f"time: {time.perf_counter() - STARTED:.0f} s")

# %% [markdown]
# **Write it down.**  Put the result for `climb-gap` into one sentence that stays true if somebody trains both recipes again.
#
# <details><summary>Answer</summary>
#
# Take the last line of `climb-gap`, for only that one is about recipes.  If its verdict is *undecided*: "Over so many training
# seeds the difference was (the number), with a 95 % interval of (the two ends); they are too few to settle which of
# the two is better."  If it is *reproduced* or *not reproduced*, name the interval all the same, and say that this
# comparison was one of two.  What no line here carries is "distilled is better": that would be about all courses and all
# seeds, without an interval.
#
# </details>

# %% [markdown]
# # 4. One generalist, or a bank of specialists and a choice?
#
# The question of the paper, on shipped weights: what each specialist can do alone, what an
# oracle makes of them, how the oracle's choice is learned from the terrain scan, why a
# learner's own mistakes belong into its data, and whether all that beats one policy that was
# trained on everything.
#
# Run it with `python tutorials/04_selectors.py`; it trains two small classifiers and prints how
# long everything took.

# %%
import time
from dataclasses import replace
from pathlib import Path

from agility_ref.evaluate import EvaluationConfig, evaluate, evaluation_env, oracle_accuracy
from agility_ref.pictures.plots import BLUE, ORANGE, new_figure
from agility_ref.policy import Policy
from agility_ref.selector import SupervisedConfig, collect_labels, fit_selector, oracle_hierarchy, selector_hierarchy
from agility_ref.stats import paired_difference
from agility_ref.training.bank import load_bank, load_policy, weights_path
from agility_ref.training.policies import find_policy
from agility_ref.training.runs import TrainConfig, make_env

import numpy as np

FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)
STARTED = time.perf_counter()


def save(figure, name):
    """Write a figure and say where it went."""
    figure.savefig(FIGURES / name, dpi=110)
    print("figure:", (FIGURES / name).resolve())


config = TrainConfig(preset="full", seed=0)
settings = EvaluationConfig(episodes=24)
BANK = ("walk", "climb-up", "climb-down", "leap", "beam")
TERRAINS = ("climb", "gap", "beam", "climb-gap")

# %% [markdown]
# ## 4.1 What a specialist is worth away from home
#
# Five specialists, four terrains, the same 24 courses for everybody, d ~ U(0, 1).  A waypoint fraction
# of 1/8 is what a policy gets that only walks to the first obstacle.
#
# *A right figure:* `leap` is bright at `gap` and `beam` at `beam`; `climb-up` is half bright at `climb`, whose courses
# go up and then down; `climb-down` never gets up.  The column `climb-gap` has no bright cell: **no specialist
# finishes more than a few of the easiest courses that need three skills**.

# %%
fractions = {}
for name in BANK:
    for terrain in TERRAINS:
        fractions[name, terrain] = evaluate(load_policy(name, config), terrain, settings).waypoint_fraction
table = np.array([[fractions[name, terrain].mean() for terrain in TERRAINS] for name in BANK])  # (5, 4)


def heat_map(values, rows, title):
    """Draw a table of waypoint fractions, numbers included."""
    figure, axes = new_figure(1, 1, (5.6, 0.5 * len(rows) + 1.3))
    axis = axes[0, 0]
    axis.imshow(values, cmap="Blues", vmin=0, vmax=1.2, aspect="auto")
    axis.set_xticks(range(len(TERRAINS)), TERRAINS)
    axis.set_yticks(range(len(rows)), rows)
    for (i, j), value in np.ndenumerate(values):
        axis.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=10)
    axis.set_title(title, fontsize=10)
    return figure


print("waypoint fraction of every specialist alone:")
for name, row in zip(BANK, table, strict=True):
    print(f"  {name:11}", *(f"{terrain} {value:.2f}  " for terrain, value in zip(TERRAINS, row, strict=True)))
save(heat_map(table, BANK, "specialists alone: waypoint fraction"), "04_specialists.png")

# %% [markdown]
# ## 4.2 The oracle: somebody who knows the map
#
# A course is a list of boxes, so the right skill can be read off it (tutorial 1 draws the regions):
# `climb-up` from a little before a step up to a little behind it, and so on; everywhere else `walk`.  The **oracle**
# executes the skill of the region its robot stands in.  It learns nothing, so what it cannot
# do is the specialists' fault, or the map's.
#
#     skill(t) = region map at x of the trunk at time t
#
# **Predict, then run.**  Is the oracle on `climb` as good as the better of `climb-up` and `climb-down` there?

# %%
spec = find_policy("ps-sl-5")
skills = load_bank(spec.skills, config)  # the five specialists, frozen
oracle = oracle_hierarchy("oracle", skills)
for terrain in TERRAINS:
    fractions["oracle", terrain] = evaluate(oracle, terrain, settings).waypoint_fraction
    best = max(BANK, key=lambda name: fractions[name, terrain].mean())
    print(
        f"{terrain:10} oracle {fractions['oracle', terrain].mean():.2f}, "
        f"best specialist {fractions[best, terrain].mean():.2f} ({best})"
    )

# %% [markdown]
# ## 4.3 Learning the choice
#
# The map is not available outside of a simulator.  The scandots are: 132 heights around the robot.  So let
# the oracle drive, write down what it saw and what it chose, and fit a classifier (paper section 3.2.3):
#
#     minimise  - mean over states s of  log softmax( f(scandots(s)) )[oracle's skill in s]
#
# 64 robots play training courses of all kinds and levels: some 50,000 states.  The shipped
# `ps-sl-5` had a million.

# %%
training = replace(config, ppo=replace(config.ppo, num_envs=64), curriculum=replace(config.curriculum, enabled=False))
robots, _ = make_env(spec, training)
STATES = 50_000


def fit(scandots, labels):
    """Fit a classifier to labelled states (M, 132), (M,)."""
    arrays, losses = fit_selector(scandots, labels, len(skills), SupervisedConfig(), seed=0)
    print(f"  {len(labels)} states, cross-entropy {losses[0]:.3f} in the first pass, {losses[-1]:.3f} in the last")
    return Policy.from_arrays(arrays, {"policy": "selector", "act_dim": len(skills)})


seen, wanted = collect_labels(robots, oracle, oracle, STATES)
shares = np.bincount(wanted, minlength=len(skills)) / len(wanted)
print("the oracle's choices:", ", ".join(f"{name} {share:.0%}" for name, share in zip(skills, shares, strict=True)))
classifier = fit(seen, wanted)
cloned = selector_hierarchy("cloned", skills, classifier)

# %% [markdown]
# Somebody who always says `walk` is already right in the first of those shares.  So look at the accuracy on courses
# that training has not seen, and on **two** kinds of states: those that the oracle visits, and those into which the
# classifier brings the robots itself.

# %%
robots_there = evaluation_env("climb-gap", settings)
scandots, labels = collect_labels(robots_there, oracle, oracle, 10_000)
on_oracles_path = (classifier(scandots).argmax(axis=1) == labels).mean()
played = evaluate(cloned, "climb-gap", settings)
on_own_path = oracle_accuracy(played.skill, played.oracle).mean()
print(f"accuracy on climb-gap: {on_oracles_path:.3f} on the oracle's path, {on_own_path:.3f} on its own")

# %% [markdown]
# ## 4.4 Its own mistakes
#
# The data are where a *perfect* chooser goes.  A wrong choice brings the robot somewhere else, and there the next
# choice is a guess.  DAgger (Ross, Gordon and Bagnell 2011) lets the learner drive, asks the oracle what would have
# been right, and fits again to both.  Whether that helps here depends on how far a mistake leads away: measure it.

# %%
own_states, own_labels = collect_labels(robots, cloned, oracle, STATES)
corrected = selector_hierarchy("corrected", skills, fit(np.vstack([seen, own_states]), np.hstack([wanted, own_labels])))
for learner in (cloned, corrected):
    for terrain in TERRAINS:
        played = evaluate(learner, terrain, settings)
        fractions[learner.name, terrain] = played.waypoint_fraction
        accuracy = oracle_accuracy(played.skill, played.oracle).mean()
        print(
            f"{learner.name:9} on {terrain:10} accuracy {accuracy:.3f}, waypoints {played.waypoint_fraction.mean():.2f}"
        )

# %% [markdown]
# **Try.**  Halve `STATES`, and halve it again.  Which goes down first, the accuracy or the waypoints?  Near the border of
# a region both skills often work, and a choice that differs from the oracle's is then no mistake.

# %% [markdown]
# ## 4.5 And one generalist?
#
# GEN-5 is one network for the courses of all five specialists, trained with PPO on the steps of all of them
# together.  All policies play the same courses with the same noise and pushes, so we compare **episode by episode**:
#
#     difference = mean over courses of ( selector's waypoint fraction - generalist's ),  95 % bootstrap interval
#
# An interval that contains 0 is not evidence for either.  With 24 courses it is wide; Table 1 plays 64.
#
# *A right figure:* points right of the line are terrains where the bank with its learned choice is ahead.

# %%
generalist = load_policy("gen-5", config)
differences = {}
for terrain in TERRAINS:
    fractions["gen-5", terrain] = evaluate(generalist, terrain, settings).waypoint_fraction
    differences[terrain] = paired_difference(fractions["corrected", terrain], fractions["gen-5", terrain])
    mean, low, high = differences[terrain]
    print(f"{terrain:10} selector minus GEN-5 {mean:+.2f} [{low:+.2f}, {high:+.2f}]")


def steps(name):
    """Environment steps spent on a policy of its own [million]."""
    return Policy.load(weights_path(name, config)).meta["steps"] / 1e6


own_steps = [steps(name) for name in BANK]  # walk's are in each of the others
bank_steps = sum(own_steps) - (len(BANK) - 1) * steps("walk")
print(f"steps spent: bank {bank_steps:.0f} million, GEN-5 {steps('gen-5'):.0f} million")

figure, axes = new_figure(1, 1, (6.0, 2.6))
axis = axes[0, 0]
for row, (mean, low, high) in enumerate(differences.values()):
    axis.plot([low, high], [row, row], color=BLUE, linewidth=3)
    axis.plot(mean, row, "o", color=ORANGE, markersize=8)
axis.axvline(0.0, color="black", linewidth=0.8)
axis.set_yticks(range(len(differences)), list(differences))
axis.set_ylim(len(differences) - 0.5, -0.5)
axis.set(xlabel="waypoint fraction, selector minus GEN-5 [-]")
axis.grid(alpha=0.3)
save(figure, "04_bank_or_generalist.png")

names = (*BANK, "oracle", "cloned", "corrected", "gen-5")
everything = np.array([[fractions[name, terrain].mean() for terrain in TERRAINS] for name in names])
save(heat_map(everything, names, "everybody: waypoint fraction, the same 24 courses a column"), "04_everybody.png")
print(f"that took {time.perf_counter() - STARTED:.0f} s")

# %% [markdown]
# **Predict, then run.**  Give the bank one specialist less, before the oracle is made: `skills.pop("climb-down")`, with
# `climb-up` in its place: `selector.SUBSTITUTE["climb-down"] = "climb-up"`, after `from agility_ref import selector`.
# On which terrains does the bank lose, and does the generalist notice?
#
# `make table1` is this comparison for 11 policies, with every number's interval, beside the paper's.

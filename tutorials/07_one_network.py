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
# # 7. One network for everything: the paper's question
#
# Breadth or depth: should a robot learn one policy for all terrains, or a bank of specialists and a choice among them?  This
# tutorial lets both play, asks why one network has a hard time with five tasks, and then sees how far one gets that is taught
# for a minute what the bank does (paper sections 4 and 5).
#
# It takes about 45 seconds on two cores.  As a notebook it shows its figures below the cells; `python tutorials/07_one_network.py` writes
# them into the folder `figures/` of the directory you start it from.

# %%
import time
from dataclasses import replace

from agility_ref.evaluate import EvaluationConfig, evaluate
from agility_ref.pictures.plots import BLUE, GREEN, ORANGE, SKILL_COLOURS, new_figure, show
from agility_ref.policy import Policy
from agility_ref.ppo import normalize_advantages
from agility_ref.selector import Single, oracle_hierarchy
from agility_ref.stats import paired_difference
from agility_ref.training.bank import bank_steps, load_bank, load_policy
from agility_ref.training.imitation import collect_actions, fit_student
from agility_ref.training.policies import find_policy
from agility_ref.training.runs import TrainConfig, make_env

import numpy as np

STARTED = time.perf_counter()
config = TrainConfig(preset="full", seed=0)
settings = EvaluationConfig(episodes=16)
TERRAINS = ("climb", "gap", "beam", "climb-gap")
BANK = find_policy("distilled").teachers

# %% [markdown]
# ## 7.1 What a fair comparison needs
#
# The bank is five networks, each trained on one kind of course.  GEN-5 is one network, trained on all five kinds.  If it got
# the steps of one specialist, it would lose because it had to divide them by five.  So it gets as many as all specialists
# together, their common start, `walk`, counted once:
#
# $$\text{steps}_\text{GEN-5} \le \text{steps}_\text{walk} + \sum_{k \ne \text{walk}} \bigl(\text{steps}_k - \text{steps}_\text{walk}\bigr)$$
#
# **Predict, then run.**  The bank has five networks.  How many more weights is that than GEN-5 has, and does it matter?

# %%
bank = load_bank(BANK, config)
generalist = load_policy("gen-5", config)
weights = {
    "bank": sum(w.size + b.size for policy in bank.values() for w, b in policy.layers),
    "gen-5": sum(w.size + b.size for w, b in generalist.policy.layers),
}
print(
    f"steps: bank {bank_steps(BANK, config) / 1e6:.1f} million, GEN-5 {generalist.policy.meta['steps'] / 1e6:.1f} million"
)
print(f"weights: bank {weights['bank']:,}, GEN-5 {weights['gen-5']:,}")

# %% [markdown]
# <details><summary>Answer</summary>
#
# Five times as many, so "one network cannot hold it" is a possible explanation if GEN-5 is behind.  Section 7.4 tests it:
# there, a network of GEN-5's size is taught what the whole bank does.
#
# </details>

# %% [markdown]
# ## 7.2 They play
#
# The bank's choice is the oracle's, so that we compare the skills and not the selector (tutorial 6 does that).
# `distilled` is one network again, which ships with the package: it has learned to do what the bank does.
#
# *What you should see:* differences, course by course, with their 95 % bootstrap intervals.  Right of 0 the bank is ahead.

# %%
oracle = oracle_hierarchy("oracle", bank)
players = {"bank": oracle, "gen-5": generalist, "distilled": load_policy("distilled", config)}
fractions = {
    (name, terrain): evaluate(player, terrain, settings).waypoint_fraction
    for terrain in TERRAINS
    for name, player in players.items()
}  # each (16,)
figure, axes = new_figure(1, 1, (7.5, 3.4))
axis = axes[0, 0]
for row, terrain in enumerate(TERRAINS):
    print(f"{terrain:10}", ", ".join(f"{name} {fractions[name, terrain].mean():.2f}" for name in players))
    for shift, name, colour in ((-0.13, "gen-5", ORANGE), (0.13, "distilled", GREEN)):
        mean, low, high = paired_difference(fractions["bank", terrain], fractions[name, terrain])
        axis.plot(
            [low, high], [row + shift] * 2, color=colour, linewidth=3, label=f"bank minus {name}" if row == 0 else None
        )
        axis.plot(mean, row + shift, "o", color="black", markersize=5)
        print(f"  bank minus {name:9} {mean:+.2f} [{low:+.2f}, {high:+.2f}]")
axis.axvline(0.0, color="black", linewidth=0.8)
axis.set_yticks(range(len(TERRAINS)), TERRAINS)
axis.invert_yaxis()
axis.set(xlabel="waypoint fraction, bank minus one network [-]")
axis.legend(fontsize=9)
axis.grid(alpha=0.3)
show(figure, "07_bank_or_one")

# %% [markdown]
# An interval that contains 0 is evidence for neither side, and all of them are about one training of everything
# (tutorial 8).

# %% [markdown]
# ## 7.3 Why one network has a hard time: who shouts loudest
#
# PPO scales the advantages of a batch to variance 1 before it uses them.  Suppose a batch holds robots on level ground, whose
# advantages scatter by 1, and robots before a gap, most of which never get across, and whose advantages scatter by 0.1.
#
# **Predict, then run.**  By how much do the two scatter after the usual scaling, over the whole batch?  Which of the two
# decides where the policy goes?

# %%
rng = np.random.default_rng(0)
kinds = np.repeat([0, 1], 2000).reshape(1, -1)  # (T, N): 0 walks, 1 is before a gap
advantages = rng.normal(0.0, np.where(kinds == 0, 1.0, 0.1))
scalings = {
    "as they are": advantages,
    "over the batch": normalize_advantages(advantages, np.zeros_like(kinds)),
    "within each kind": normalize_advantages(advantages, kinds),
}
figure, axes = new_figure(1, 3, (11.0, 3.0))
for axis, (label, values) in zip(axes[0], scalings.items(), strict=True):
    spread = [values[kinds == kind].std() for kind in (0, 1)]
    for kind, name, colour in ((0, "walk", SKILL_COLOURS["walk"]), (1, "gap", SKILL_COLOURS["leap"])):
        axis.hist(values[kinds == kind], bins=np.linspace(-4, 4, 81), color=colour, alpha=0.6, label=name)
    axis.set(title=label, xlabel="advantage [-]", yticks=[])
    print(f"{label:17} walk scatters by {spread[0]:.2f}, gap by {spread[1]:.2f}")
axes[0, 0].legend(fontsize=9)
show(figure, "07_advantages")

# %% [markdown]
# <details><summary>Answer</summary>
#
# By 1.4 and 0.14: scaling everything by one number leaves the ratio of ten to one as it was.  The gradient comes nearly all from
# the robots that walk: the network learns to walk still better, and what the robots before the gap have found out is drowned.  Scaled **within each
# kind of course**, every task has the same weight.  `normalize_advantages` in `ppo.py` does that; for a specialist, with its
# one kind, it is the usual scaling.
#
# </details>

# %% [markdown]
# ## 7.4 Teaching instead of reinforcing
#
# Does one network fail to *hold* five skills, or does it fail to *find* them by trial and error?  Let the bank drive with the
# oracle's choice, write down each observation $s$ and the action $a^*(s)$ of the specialist that acts, and fit one network of
# GEN-5's size by least squares:
#
# $$\min_\theta \; \mathbb{E}_s \bigl\| \pi_\theta(s) - a^*(s) \bigr\|^2$$
#
# Then let this student drive while the bank says what it would have done (DAgger), and fit again.  It is never told which
# specialist acts, or that there are five.
#
# **Predict, then run.**  25,000 states are seventeen minutes of one robot's life.  How far does the student get on `climb-gap`,
# with the bank's states alone and with its own as well?

# %%
STATES = 25_000
fitting = replace(config.distill, epochs=32)  # few states, so many passes over them
spec = find_policy("distilled")
training = replace(config, ppo=replace(config.ppo, num_envs=64), curriculum=replace(config.curriculum, enabled=False))
robots, _ = make_env(spec, training)
actor, data, students = oracle, [], {}
for label in ("the bank's states", "and its own"):
    data.append(collect_actions(robots, actor, oracle, STATES, config.distill.action_noise))
    observations, wanted = (np.concatenate(part) for part in zip(*data, strict=True))
    arrays, losses = fit_student(observations, wanted, config.ppo.hidden, fitting, seed=0)
    actor = Single("student", Policy.from_arrays(arrays, {"policy": "student"}))
    students[label] = evaluate(actor, "climb-gap", settings).waypoint_fraction
    print(f"{label:18} {len(wanted)} states, squared error {losses[-1]:.3f}, waypoints {students[label].mean():.2f}")

figure, axes = new_figure(1, 1, (7.0, 3.2))
axis = axes[0, 0]
bars = {**{name: fractions[name, "climb-gap"] for name in players}, **{f"student: {k}": v for k, v in students.items()}}
for row, (label, values) in enumerate(bars.items()):
    axis.barh(row, values.mean(), color=GREEN if label.startswith("student") else BLUE)
    axis.plot(values, row + np.linspace(-0.3, 0.3, len(values)), ".", color="black", markersize=4)
axis.set_yticks(range(len(bars)), bars)
axis.invert_yaxis()
axis.set(xlabel="waypoint fraction on climb-gap: mean, and the 16 courses [-]", xlim=(0, 1.02))
show(figure, "07_student")
print("students minus GEN-5 on climb-gap:")
for label, values in students.items():
    mean, low, high = paired_difference(values, fractions["gen-5", "climb-gap"])
    print(f"  {label:18} {mean:+.2f} [{low:+.2f}, {high:+.2f}]")
print(f"time: {time.perf_counter() - STARTED:.0f} s")

# %% [markdown]
# <details><summary>How to read it, and a surprise</summary>
#
# If a student of GEN-5's size does what the bank does, the size of the network was not what held GEN-5 back.  Before you
# decide, look at `distilled` in 7.2 as well: it saw forty times as many states as the first student here.  On which terrains
# does its interval hold 0?  What makes this surprising is where the effort goes: millions of steps to find five skills, and
# minutes to move most of what they can do into one network.  Where it is still behind, look at the terrain on which one skill
# follows closely upon another: the student has to know not only five skills, but also which of them is at work.  So "one
# network or five?" and "one training or five?" are two questions, and the paper's
# comparison of generalists with specialists asks both at once.  Its section 5 hopes for this "post-generalist"; but it needs
# the bank first, so whoever compares its steps must count the bank's as well.
#
# </details>
#
# Next: `08_reading_a_table.py` asks what of all this may be claimed.

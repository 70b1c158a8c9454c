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
# # 6. Selectors: a bank of specialists, and who chooses
#
# Five specialists, each good at one thing.  Something has to name the one that acts, 25 times a second.  This tutorial
# starts with somebody who knows the map (the oracle), learns the choice from what the robot sees (supervised, then
# DAgger), and ends with a selector that learns by trial and error, and with the way in which those go wrong: they forget
# skills (paper section 3.2).
#
# It takes about 50 seconds on two cores.  As a notebook it shows its figures below the cells; `python tutorials/06_selectors.py` writes
# them into the folder `figures/` of the directory you start it from.

# %%
import time
from dataclasses import replace

from agility_ref.evaluate import EvaluationConfig, evaluate, evaluation_env
from agility_ref.pictures.plots import BLUE, ORANGE, SKILL_COLOURS, new_figure, show
from agility_ref.policy import Policy
from agility_ref.results.cells import oracle_accuracy
from agility_ref.selector import oracle_hierarchy, selector_hierarchy
from agility_ref.stats import paired_difference
from agility_ref.training.bank import load_bank, load_policy
from agility_ref.training.imitation import SupervisedConfig, collect_labels, fit_selector
from agility_ref.training.policies import find_policy
from agility_ref.training.runs import TrainConfig, make_env
from agility_ref.training.weights import shipped_seeds

import numpy as np

STARTED = time.perf_counter()
config = TrainConfig(preset="full", seed=0)
settings = EvaluationConfig(episodes=16)
BANK = ("walk", "climb-up", "climb-down", "leap", "beam")
TERRAINS = ("climb", "gap", "beam", "climb-gap")

# %% [markdown]
# ## 6.1 What a specialist is worth away from home
#
# Five specialists, four terrains, the same 16 courses of a terrain for everybody, $d \sim U(0, 1)$.  A waypoint fraction of
# 1/8 is what a policy gets that only walks to the first obstacle.
#
# **Predict, then run.**  `climb` goes up three steps and down three.  How far does `climb-up` get there, and how far
# `climb-down`?  Which specialist is best on `climb-gap`, which needs three skills?

# %%
fractions = {}  # (policy, terrain) -> (16,)
for name in BANK:
    for terrain in TERRAINS:
        fractions[name, terrain] = evaluate(load_policy(name, config), terrain, settings).waypoint_fraction
table = np.array([[fractions[name, terrain].mean() for terrain in TERRAINS] for name in BANK])  # (5, 4)

figure, axes = new_figure(1, 1, (5.6, 3.6))
axis = axes[0, 0]
axis.imshow(table, cmap="Blues", vmin=0, vmax=1.2, aspect="auto")
axis.set_xticks(range(len(TERRAINS)), TERRAINS)
axis.set_yticks(range(len(BANK)), BANK)
for (i, j), value in np.ndenumerate(table):
    axis.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=10)
axis.set_title("specialists alone: waypoint fraction", fontsize=10)
show(figure, "06_specialists")

# %% [markdown]
# <details><summary>Answer</summary>
#
# `climb-up` climbs to the top of `climb`, which is half of the course, and there meets its first step down, which it has never
# practised.  `climb-down` meets its first step up at the start.  On `climb-gap` nobody is at home: the best of them does the
# part of the course that looks like its own.
#
# </details>

# %% [markdown]
# ## 6.2 The oracle: somebody who knows the map
#
# A course is a list of boxes, so the right skill can be read off it (tutorial 1 draws the regions).  The **oracle** executes
# the skill of the region in which its robot stands:
#
# $$k(t) = \text{region map}\bigl(x(t)\bigr)$$
#
# It learns nothing, so what it cannot do is the specialists' fault, or the map's.

# %%
spec = find_policy("ps-sl-5")
skills = load_bank(spec.skills, config)  # the five specialists, frozen
oracle = oracle_hierarchy("oracle", skills)
best = max(BANK, key=lambda name: fractions[name, "climb-gap"].mean())
played = evaluate(oracle, "climb-gap", settings)
fractions["oracle", "climb-gap"] = played.waypoint_fraction
mean, low, high = paired_difference(played.waypoint_fraction, fractions[best, "climb-gap"])
print(
    f"climb-gap: oracle {played.waypoint_fraction.mean():.2f}, best specialist alone {table[BANK.index(best), -1]:.2f} ({best})"
)
print(f"oracle minus {best}, the same courses: {mean:+.2f} [{low:+.2f}, {high:+.2f}]")

# %% [markdown]
# ## 6.3 Learning the choice
#
# The map is not available outside of a simulator.  The scandots are: 132 heights around the robot.  So let the oracle
# drive, write down what it saw and what it chose, and fit a classifier $f$ (paper section 3.2.3):
#
# $$\min_f \; -\frac{1}{M} \sum_{s} \log \operatorname{softmax}\bigl(f(\text{scandots}(s))\bigr)_{k(s)}$$
#
# 64 robots play training courses of all kinds and levels: some 25,000 states.  The shipped `ps-sl-5` had a million.

# %%
training = replace(config, ppo=replace(config.ppo, num_envs=64), curriculum=replace(config.curriculum, enabled=False))
robots, _ = make_env(spec, training)
STATES = 25_000


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
# A chooser that always says `walk` is already right as often as the first of those shares says.  So look at the accuracy on courses that
# training has not seen, and on **two** kinds of states: those that the oracle visits, and those into which the classifier
# brings the robots itself.
#
# **Predict, then run.**  On which of the two is the classifier better?

# %%
scandots, labels = collect_labels(evaluation_env("climb-gap", settings), oracle, oracle, 8_000)
on_oracles_path = (classifier(scandots).argmax(axis=1) == labels).mean()
played = evaluate(cloned, "climb-gap", settings)
fractions["cloned", "climb-gap"] = played.waypoint_fraction
on_own_path = oracle_accuracy(played.skill, played.oracle)  # (16,)
print(f"accuracy on climb-gap: {on_oracles_path:.3f} on the oracle's path, {on_own_path.mean():.3f} on its own")

# %% [markdown]
# <details><summary>Answer</summary>
#
# Usually on the oracle's path, for from there its data come.  A wrong choice brings the robot to where a perfect chooser
# never is, say with the front feet already down the step that it should still be climbing, and there the next choice is a
# guess.  Errors of a classifier that acts on its own predictions are not independent of each other.
#
# </details>

# %% [markdown]
# ## 6.4 Its own mistakes
#
# DAgger (Ross, Gordon and Bagnell 2011) lets the learner drive, asks the oracle what would have been right, and fits again to
# both:
#
# $$D \leftarrow D \cup \{\, (s, k(s)) : s \text{ visited by the learner} \,\}$$
#
# Whether that helps depends on how far a mistake leads away, so measure it.

# %%
own_states, own_labels = collect_labels(robots, cloned, oracle, STATES)
corrected = selector_hierarchy("corrected", skills, fit(np.vstack([seen, own_states]), np.hstack([wanted, own_labels])))
played = evaluate(corrected, "climb-gap", settings)
fractions["corrected", "climb-gap"] = played.waypoint_fraction
accuracy = oracle_accuracy(played.skill, played.oracle)
for what, after, before in (
    ("accuracy on its own path", accuracy, on_own_path),
    ("waypoint fraction", played.waypoint_fraction, fractions["cloned", "climb-gap"]),
):
    mean, low, high = paired_difference(after, before)
    print(f"{what}: {after.mean():.3f}, corrected minus cloned {mean:+.3f} [{low:+.3f}, {high:+.3f}]")

# %% [markdown]
# Read the two intervals before you say that DAgger helped: an interval that contains 0 is evidence for neither side.  And
# the two can disagree, for near the border of a region both skills often work, and a choice that differs from the oracle's
# is then no mistake.

# %% [markdown]
# ## 6.5 Trial and error: PPO as a selector
#
# Section 3.2.2 of the paper lets PPO choose among three skills, `walk`, `climb` and `leap`.  It tries two rewards: the
# robots' own (`ps-rl-3-env`), and agreement with the oracle (`ps-rl-3-oracle`).  Training takes too long for here, so
# shipped weights play.
#
# *What you should see:* one bar for each selector: how its time is divided among the skills.  Compare each bar of the first
# reward with the oracle's own bar.

# %%
three = load_bank(find_policy("ps-rl-3").skills, config)
NAMES = tuple(three)
rows = {"oracle": evaluate(oracle_hierarchy("oracle", three), "climb-gap", settings)}
for reward, seeds in (("env", shipped_seeds("full", "ps-rl-3-env")), ("oracle", [0])):
    for seed in seeds:
        chosen = evaluate(load_policy(f"ps-rl-3-{reward}", replace(config, seed=seed)), "climb-gap", settings)
        rows[f"rewarded by {'the environment' if reward == 'env' else 'the oracle'}, seed {seed}"] = chosen

figure, axes = new_figure(1, 1, (8.5, 3.6))
axis = axes[0, 0]
for row, (label, result) in enumerate(rows.items()):
    share = np.bincount(result.skill[result.skill >= 0], minlength=len(NAMES)) / (result.skill >= 0).sum()
    axis.barh(row, share, left=np.cumsum(share) - share, color=[SKILL_COLOURS[name] for name in NAMES])
    agreement = oracle_accuracy(result.skill, result.oracle).mean()
    text = ", ".join(f"{name} {s:.0%}" for name, s in zip(NAMES, share, strict=True))
    print(f"{label:34} {text}; agrees with the oracle {agreement:.0%}, waypoints {result.waypoint_fraction.mean():.2f}")
axis.set_yticks(range(len(rows)), rows)
axis.invert_yaxis()
axis.set(xlabel="share of the time [-]", xlim=(0, 1))
handles = [axis.barh(0, 0, color=SKILL_COLOURS[name], label=name) for name in NAMES]
figure.legend(handles=handles, loc="outside upper center", ncols=len(NAMES), fontsize=9)
show(figure, "06_shares")

# %% [markdown]
# ## 6.6 A surprise: skills are forgotten even where all are equally good
#
# A selector that uses a skill less and less until it never does has **collapsed**.  The paper meets this (section 4.3), and
# the obvious explanation is that the forgotten skill was worse.  It need not be.  Take the smallest selector there is: no
# terrain, three skills, and **the same reward from each**, plus noise.  The policy is $\pi = \operatorname{softmax}(\theta)$,
# and one update of the policy gradient over a batch of actions $a_i$ with rewards $r_i$ is
#
# $$\theta \leftarrow \theta + \eta\, \frac{1}{B} \sum_i (r_i - \bar r)\, (e_{a_i} - \pi)
# \; + \; \eta\, c_e\, \nabla_\theta H(\pi)$$
#
# where $e_a$ has a 1 at $a$ and 0 elsewhere, and the last term is the entropy bonus.
#
# **Predict, then run.**  What are the probabilities of the three skills after 4000 updates without the bonus
# ($c_e = 0$)?  Will another seed give the same?


# %%
def learn_to_choose(entropy_bonus, seed, updates=4000, batch=16, rate=1.0):
    """Policy gradient on three skills of the same worth; returns the probabilities (updates, 3)."""
    rng = np.random.default_rng(seed)
    theta, history = np.zeros(3), []
    for _ in range(updates):
        pi = np.exp(theta - theta.max())
        pi /= pi.sum()
        history.append(pi)
        counts = rng.multinomial(batch, pi)  # how often each skill is tried
        rewards = [rng.normal(1.0, 1.0, n) for n in counts]  # the same distribution for all
        mean = np.concatenate(rewards).mean()
        surplus = np.array([(r - mean).sum() for r in rewards])  # sum of advantages of each skill
        theta = theta + rate * (surplus - pi * surplus.sum()) / batch
        log_pi = np.log(pi + 1e-12)
        theta += rate * entropy_bonus * pi * ((pi * log_pi).sum() - log_pi)  # dH / dtheta
    return np.array(history)


BONUSES = (0.0, 0.1)
figure, axes = new_figure(2, 4, (11.0, 4.6))
for line, bonus in enumerate(BONUSES):
    ends = []
    for seed in range(4):
        history = learn_to_choose(bonus, seed)
        ends.append(history[-1].max())
        axes[line, seed].stackplot(
            np.arange(len(history)), history.T, colors=[SKILL_COLOURS[n] for n in NAMES], labels=NAMES
        )
        axes[line, seed].set(ylim=(0, 1), xlim=(0, len(history)), title=f"bonus {bonus}, seed {seed}")
    print(f"entropy bonus {bonus}: the commonest skill ends at {', '.join(f'{e:.0%}' for e in ends)}")
for axis in axes[:, 0]:
    axis.set_ylabel("probability [-]")
for axis in axes[1]:
    axis.set_xlabel("update")
show(figure, "06_collapse")

# %% [markdown]
# <details><summary>Answer</summary>
#
# One skill takes nearly all, and **which** one depends on the seed.  Nothing was learned: there was nothing to learn.  The
# gradient of a skill's logit is proportional to its probability, $\partial J / \partial \theta_k = \pi_k\, (Q_k - V)$.  A
# skill that lost some probability by chance is tried less often, so whatever would bring it back becomes weaker as well:
# chance goes up and down, but near zero it stays.  Biologists call the same thing genetic drift.  The entropy bonus is a
# restoring force: small where it matters little, and just enough to keep every skill in play.
#
# Between obstacles all skills of a bank walk, so to the robots' own reward most choices are worth nearly the same.  That is
# where a selector can lose a skill without losing reward, and be without it where it counts.
#
# </details>

# %% [markdown]
# ## 6.7 Everybody, on the same courses
#
# *What you should see:* the difference to the oracle with the same bank of five, course by course, with its 95 % bootstrap
# interval.  Left of 0 is behind the oracle.  The bars of the two PPO selectors are about a bank of three.

# %%
for reward in ("env", "oracle"):
    label = f"rewarded by {'the environment' if reward == 'env' else 'the oracle'}, seed 0"
    fractions[f"ps-rl-3-{reward}", "climb-gap"] = rows[label].waypoint_fraction
names = (best, "cloned", "corrected", "ps-rl-3-env", "ps-rl-3-oracle")
figure, axes = new_figure(1, 1, (7.5, 3.0))
axis = axes[0, 0]
for row, name in enumerate(names):
    mean, low, high = paired_difference(fractions[name, "climb-gap"], fractions["oracle", "climb-gap"])
    axis.plot([low, high], [row, row], color=BLUE, linewidth=3)
    axis.plot(mean, row, "o", color=ORANGE, markersize=8)
    print(f"{name:15} minus oracle {mean:+.2f} [{low:+.2f}, {high:+.2f}]")
axis.axvline(0.0, color="black", linewidth=0.8)
axis.set_yticks(range(len(names)), [f"{best}, alone", *names[1:]])
axis.invert_yaxis()
axis.set(xlabel="waypoint fraction on climb-gap, minus the oracle's [-]")
axis.grid(alpha=0.3)
show(figure, "06_everybody")
print(f"time: {time.perf_counter() - STARTED:.0f} s")

# %% [markdown]
# These are intervals over 16 courses for **one** training of everything.  They say how these networks compare, and nothing
# about another training (tutorial 8).
#
# **Try.**  Halve `STATES`, and halve it again.  Which goes down first, the accuracy or the waypoints?
#
# <details><summary>Answer</summary>
#
# Usually the accuracy.  Most of the classifier's errors stand at the borders of regions, a few steps early or late, where
# either skill gets the robot across.
#
# </details>
#
# Next: `07_one_network.py` asks whether all this choosing is worth it.

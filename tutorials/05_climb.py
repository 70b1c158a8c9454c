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
# # 5. A Go1 learns to climb: curriculum and learning curve
#
# PPO (tutorial 3) with a network that knows left from right (tutorial 4) gets a robot that can walk, and courses that go up
# three steps and down three.  What it is shown next decides whether it learns anything: that is the curriculum.  At the end
# the robot climbs, on courses that it has never seen (paper sections 3.1.1 and 4.2).
#
# It takes about a minute and a half on two cores, nearly all of them training.  As a notebook it shows its figures below the cells;
# `python tutorials/05_climb.py` writes them into the folder `figures/` of the directory you start it from.

# %%
import time

from agility_ref.curriculum import Curriculum, CurriculumConfig, level_difficulties
from agility_ref.evaluate import EvaluationConfig, evaluate
from agility_ref.files import read_npz
from agility_ref.observation import ACTION_MIRROR, OBS_MIRROR, SCANDOTS
from agility_ref.pictures.pictures import strobe
from agility_ref.pictures.plots import BLUE, GREEN, GREY, ORANGE, SKILL_COLOURS, new_figure, show
from agility_ref.pictures.record import record
from agility_ref.policy import Policy
from agility_ref.ppo import Learner, train
from agility_ref.selector import Single
from agility_ref.stats import paired_difference
from agility_ref.terrain import step_height
from agility_ref.training.bank import load_policy, weights_path
from agility_ref.training.policies import find_policy
from agility_ref.training.runs import TrainConfig, make_env
from agility_ref.training.state import policy_arrays, warm_start

import numpy as np

STARTED = time.perf_counter()
STEPS = 1_200_000  # environment steps of training, 13 hours of one robot's life
config = TrainConfig(preset="quick", seed=0)
settings = EvaluationConfig(episodes=24, preset="quick")

# %% [markdown]
# ## 5.1 What comes next?
#
# Ten levels of difficulty lie between a step of 3 cm and the hardest of the preset.  The *frontier* $\ell$ is the level at
# which the robots work; all of them share it.  Every episode that was played on it moves a *score* $q$ towards the fraction $f$ of its
# waypoints:
#
# $$q \leftarrow q + 0.04\,(f - q), \qquad q \ge 0.75:\; \ell \leftarrow \ell + 1, \qquad q < 0.25:\; \ell \leftarrow \ell - 1$$
#
# and a new frontier starts with $q = 0.4$.  Some episodes are played on easier levels, against forgetting; they do not count.
#
# **Predict, then run.**  Forget the robot for a moment and invent one that always reaches 93 % of the waypoints on level 0,
# and 10 percentage points fewer on each further level.  At which level does the frontier come to rest?

# %%
rules = CurriculumConfig()
d = level_difficulties("climb", 0.4, rules.num_levels)
print("steps of the ten levels [cm]:", ", ".join(f"{100 * step_height(v):.0f}" for v in d))
curriculum = Curriculum(num_kinds=1, num_envs=64, config=rules, seed=0)
robots = np.arange(64)
curriculum.next_course(robots, None)
frontier, score = [], []
for _ in range(60):  # each robot plays 60 episodes
    curriculum.next_course(robots, 0.93 - 0.1 * curriculum.level)
    frontier.append(curriculum.frontier[0])
    score.append(curriculum.score[0])
print(f"the invented robot comes to rest at level {frontier[-1]}, with a score of {score[-1]:.2f}")

# %% [markdown]
# <details><summary>Answer</summary>
#
# Level 2.  There it reaches $0.93 - 0.2 = 0.73$, not enough to be promoted; on level 1 it reached 0.83, so the score had to cross
# 0.75 sooner or later.  A frontier comes to rest where the robot succeeds **most of the time but not always**, and that is
# the level with most to learn from: a robot that always succeeds sees no difference between good and better actions, and one
# that always fails sees none either.
#
# </details>

# %% [markdown]
# ## 5.2 Before
#
# The walking specialist of the preset `quick` ships with the package.  How far does it get on `climb`?

# %%
walk = load_policy("walk", config)
before = evaluate(walk, "climb", settings)
print(
    f"walk on climb: waypoint fraction {before.waypoint_fraction.mean():.2f}, {before.fell.mean():.0%} of the episodes end in a fall"
)

# %% [markdown]
# ## 5.3 Training
#
# This is the whole of it: courses and robots, a learner, the walker's weights to start from, and a loop.  `agility-ref train
# climb --preset quick` does the same, with files.
#
# **Predict, then run.**  We watch two curves: the fraction of the waypoints that the robots reach while they train, and the
# frontier.  What will each look like if learning goes well?

# %%
spec = find_policy("climb")
env, curriculum = make_env(spec, config)
learner = Learner.create(OBS_MIRROR, ACTION_MIRROR, config.ppo, config.seed, fixed=SCANDOTS)
arrays, meta = read_npz(weights_path("walk", config))
warm_start(learner, arrays, meta["steps"], config.warm_std)

progress = []
for iteration in train(env, learner, learner.steps + STEPS):
    fractions = [episode["waypoints"] / 8 for episode in iteration["episodes"]]
    progress.append(
        (learner.steps - learner.start, np.mean(fractions or np.nan), curriculum.frontier[0], curriculum.score[0])
    )
steps, exploring, frontier, score = np.array(progress).T
print(
    f"{steps[-1] / 1e6:.1f} million steps, {len(progress)} updates; the frontier ends at level {frontier[-1]:.0f} of 9"
)

# %% [markdown]
# *What you should see:* once the robots are used to the lowest steps, the thick line on the left hardly rises, while the frontier
# on the right climbs like a staircase.  The score is a saw: it rises to 0.75, the frontier moves, and it starts again at 0.4.  Only
# on the top level, where nothing harder follows, does it stay up.

# %%
figure, axes = new_figure(1, 2, (11.0, 3.8))
left, right = axes[0]
window = 15  # updates
known = np.nan_to_num(exploring, nan=np.nanmean(exploring))
smooth = np.convolve(known, np.ones(window) / window, "valid")
left.plot(steps / 1e6, exploring, color=GREY, linewidth=0.6)
left.plot(steps[window // 2 : window // 2 + len(smooth)] / 1e6, smooth, color=BLUE, linewidth=2.5)
left.set(xlabel="environment steps [million]", ylabel="waypoint fraction, exploring [-]", ylim=(0, 1))
right.plot(steps / 1e6, frontier / 9, color=ORANGE, label="frontier / top level")
right.plot(steps / 1e6, score, color=GREEN, linewidth=0.8, label="score")
right.set(xlabel="environment steps [million]", ylim=(0, 1.02))
right.legend(fontsize=9)
for axis in (left, right):
    axis.grid(alpha=0.3)
show(figure, "05_learning_curve")

# %% [markdown]
# <details><summary>Answer, and the surprise</summary>
#
# A learning curve that does not rise, of a robot that learns.  The curriculum makes the task harder exactly as fast as the robot
# gets better, so the fraction of the waypoints stays where it is for as long as there are harder levels.  Whoever
# looks at the left picture alone stops the training: "it has converged".  With a curriculum, progress is where the
# **frontier** is; success on the levels of the moment says nothing, and neither does the reward.
#
# </details>

# %% [markdown]
# ## 5.4 After
#
# The same courses as before training, which were never seen in training, with the mean action and without exploration.
#
# *What you should see:* every dot is one course; grey before, dark after.

# %%
climb = Single("climb", Policy.from_arrays(policy_arrays(learner), {"policy": "climb"}))
after = evaluate(climb, "climb", settings)
mean, low, high = paired_difference(after.waypoint_fraction, before.waypoint_fraction)
print(
    f"after training: waypoint fraction {after.waypoint_fraction.mean():.2f}, {after.fell.mean():.0%} of the episodes end in a fall"
)
print(f"after minus before, the same 24 courses: {mean:+.2f} [{low:+.2f}, {high:+.2f}]")

figure, axes = new_figure(1, 1, (7.0, 3.6))
axis = axes[0, 0]
heights = [100 * step_height(d) for d in before.difficulty]
axis.scatter(heights, before.waypoint_fraction, color=SKILL_COLOURS["walk"], label="before (walk)")
axis.scatter(heights, after.waypoint_fraction, color=SKILL_COLOURS["climb"], label="after (climb)", alpha=0.8)
axis.set(xlabel="height of a step [cm]", ylabel="waypoint fraction [-]", ylim=(-0.03, 1.06))
axis.legend(fontsize=9)
axis.grid(alpha=0.3)
show(figure, "05_before_and_after")

# %% [markdown]
# And one episode from the side, with the robot drawn to scale every 0.7 s.  It plays the same courses without noise and
# pushes, and of those that it finishes we take the one in the middle, sorted by difficulty.

# %%
episodes = record(climb, "climb", EvaluationConfig(preset="quick", clean=True), courses=tuple(range(24)))
finished = sorted((e for e in episodes if e.reached == 8), key=lambda e: e.course.difficulty)
episode = finished[len(finished) // 2]
print(
    f"without noise it finishes {len(finished)} of {len(episodes)}; the middle one, steps of {100 * step_height(episode.course.difficulty):.0f} cm:"
)
print(episode.summary())
show(strobe(episode), "05_strobe")
print(f"time: {time.perf_counter() - STARTED:.0f} s")

# %% [markdown]
# The interval above is about **this** network on 24 courses.  Another seed gives another network; tutorial 8 asks how many of
# them it takes before one may speak of the recipe.
#
# **Try.**  Train once more with `curriculum=CurriculumConfig(enabled=False)` in `config`: all levels from the start.
#
# <details><summary>What to look at</summary>
#
# The left curve now **does** rise, for the courses stay the same.  That makes the two left curves impossible to compare: one
# is about courses that got harder.  Only 5.4, the same courses for both, is a comparison.
#
# </details>
#
# Next: `06_selectors.py`.

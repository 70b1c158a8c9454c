# %% [markdown]
# # 3. PPO: from three numbers to a robot that walks
#
# PPO needs three ideas: how much better an action was than expected (2 lines of numpy), what
# to do when an episode ends (where many implementations are wrong), and how far one update
# may go (1 line of torch).  After them a Go1 learns to walk on your machine.
#
# Run it with `python tutorials/03_ppo.py`.  Everything up to 3.4 takes seconds.  Training takes
# minutes, and the script prints how many it took; it is saved in `runs/tutorial/walk/seed0`
# of the directory you start from.  Stop it with Ctrl-C when you like: the next start goes
# on from there, and a finished run is not trained again.

# %%
from pathlib import Path

from agility_ref.curriculum import PRESETS
from agility_ref.evaluate import EvaluationConfig, evaluate, evaluation_env
from agility_ref.pictures.plots import BLUE, GREEN, ORANGE, RED, learning_curve, new_figure
from agility_ref.policy import read_npz
from agility_ref.ppo import gae, policy_loss
from agility_ref.terrain import LANE_LENGTH, LANE_WIDTH
from agility_ref.training.bank import load_policy, run_folder
from agility_ref.training.policies import find_policy
from agility_ref.training.progress import read_progress
from agility_ref.training.runs import TrainConfig, train_policy

import numpy as np
import torch

FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)


def save(figure, name):
    """Write a figure and say where it went."""
    figure.savefig(FIGURES / name, dpi=110)
    print("figure:", (FIGURES / name).resolve())


# %% [markdown]
# ## 3.1 How much better than expected?
#
# The critic predicts V(s), the discounted reward from state s on.  One step later we know more:
#
#     delta_t = r_t + gamma V(s_t+1) - V(s_t)                       (surprise of one step)
#     A_t     = delta_t + gamma lambda A_t+1                        (surprises that follow count too)
#
# Three steps by hand, with gamma = 0.9 and lambda = 0.8, so gamma lambda = 0.72:
#
#     r = 1, 2, 3        V(s_0..s_2) = 4, 5, 6        V(s_3) = 7
#
#     delta_2 = 3 + 0.9 * 7 - 6 = 3.3          A_2 = 3.3
#     delta_1 = 2 + 0.9 * 6 - 5 = 2.4          A_1 = 2.4 + 0.72 * 3.3   = 4.776
#     delta_0 = 1 + 0.9 * 5 - 4 = 1.5          A_0 = 1.5 + 0.72 * 4.776 = 4.93872

# %%
rewards = np.array([[1.0], [2.0], [3.0]])  # (T, N) = (3, 1): three steps of one robot
values = np.array([[4.0], [5.0], [6.0]])
next_values = np.array([[5.0], [6.0], [7.0]])  # V(s_t+1)
no, at_1 = np.zeros((3, 1), bool), np.array([[False], [True], [False]])

running = gae(rewards, values, next_values, no, no, gamma=0.9, gae_lambda=0.8)
print("episode goes on        A =", running[:, 0].round(5))
assert np.allclose(running[:, 0], [4.93872, 4.776, 3.3])

# %% [markdown]
# Now let the episode end at step 1.  It matters **how**.
#
# *Terminated*: the robot fell.  Nothing follows, so the value of what follows is 0:
#
#     delta_1 = 2 + 0 - 5 = -3                 A_1 = -3               A_0 = 1.5 - 0.72 * 3 = -0.66
#
# *Truncated*: the clock ran out.  The robot was fine and would have gone on, so the value of
# its last state counts; but step 2 belongs to another episode and adds nothing:
#
#     delta_1 = 2 + 0.9 * 6 - 5 = 2.4          A_1 = 2.4              A_0 = 1.5 + 0.72 * 2.4 = 3.228
#
# A trap: after an automatic reset the next observation in the buffer is the *new* episode's
# first.  V(s_t+1) has to come from the true last observation, `info["final_obs"]`.

# %%
fell = gae(rewards, values, next_values, at_1, no, 0.9, 0.8)
timed_out = gae(rewards, values, next_values, no, at_1, 0.9, 0.8)
print("terminated at step 1   A =", fell[:, 0].round(5))
print("truncated at step 1    A =", timed_out[:, 0].round(5))
assert np.allclose(fell[:, 0], [-0.66, -3.0, 3.3])
assert np.allclose(timed_out[:, 0], [3.228, 2.4, 3.3])

# %% [markdown]
# **Predict, then run.**  What are the advantages for lambda = 0 and for lambda = 1?  For which of
# the two does the critic's opinion of s_1 and s_2 not matter in A_0 of the running episode?

# %% [markdown]
# ## 3.2 The silent bug: bootstrapping on death
#
# Suppose someone merges the two flags and treats every end as a time-out.  Nothing crashes.
# Take the smallest world that shows what happens: one state, reward 1 a step, and at every step
# the robot dies with probability p.  Then
#
#     true value       V = 1 + gamma (1 - p) V      so      V = 1 / (1 - gamma (1 - p))
#     with the bug     V = 1 + gamma V              so      V = 1 / (1 - gamma)
#
# The second line does not contain p.  To the buggy learner **dying costs nothing**, however
# often it happens.  We let both learn from the same experience with `gae`; advantage plus value is
# the critic's target.
#
# *A right figure:* each curve climbs to its dashed line; the orange one stays five times too
# high.

# %%
GAMMA, LAMBDA, DEATH = 0.99, 0.95, 0.04
true_value, buggy_value = 1 / (1 - GAMMA * (1 - DEATH)), 1 / (1 - GAMMA)


def learn_value(bug, rounds=250):
    """Fit the value of the only state; return it after every round."""
    rng = np.random.default_rng(0)
    value, history = 0.0, []
    for _ in range(rounds):
        died = rng.random((32, 256)) < DEATH  # (T, N)
        never = np.zeros_like(died)
        v = np.full(died.shape, value)
        terminated, truncated = (never, died) if bug else (died, never)
        advantages = gae(np.ones(died.shape), v, v, terminated, truncated, GAMMA, LAMBDA)
        value += 0.3 * advantages.mean()  # target = advantage + value; move 30 % of the way
        history.append(value)
    return np.array(history)


right, wrong = learn_value(bug=False), learn_value(bug=True)
print(f"right: V = {right[-1]:6.2f}, true value {true_value:.2f}")
print(f"bug:   V = {wrong[-1]:6.2f}, fixed point {buggy_value:.2f}, {buggy_value / true_value:.1f} times the truth")
print(
    f"advantage of the step that kills: right {1 - right[-1]:+.2f}, with the bug {1 + GAMMA * wrong[-1] - wrong[-1]:+.2f}"
)

figure, axes = new_figure(1, 1, (7.0, 3.8))
axis = axes[0, 0]
axis.plot(right, color=BLUE, label="terminated kept apart from truncated")
axis.plot(wrong, color=ORANGE, label="bug: bootstraps on death")
axis.axhline(true_value, color=BLUE, linewidth=0.8, linestyle="--")
axis.axhline(buggy_value, color=ORANGE, linewidth=0.8, linestyle="--")
axis.set(xlabel="update", ylabel="learned value [sum of discounted rewards]", ylim=(0, None))
axis.set_title(f"one state, reward 1, death with probability {DEATH} a step", fontsize=10)
axis.legend(fontsize=8, loc="center right")
axis.grid(alpha=0.3)
save(figure, "03_bootstrap_bug.png")

# %% [markdown]
# **Try.**  The opposite bug treats a time-out as death.  Let `died` mean "time-out", in a world
# where nobody dies: which value does it find, and would a walking robot get the
# blame for running out of time?

# %% [markdown]
# ## 3.3 How far may one update go?
#
# PPO raises the probability of actions with A > 0 and lowers it for A < 0, but stops
# caring once the ratio r = pi(a|s) / pi_old(a|s) has moved by eps:
#
#     L = - mean( min( r A,  clip(r, 1 - eps, 1 + eps) A ) )
#
# *A right figure:* for A = +1 the objective (minus the loss) grows with r and is flat beyond
# 1 + eps: no more gain from going further.  For A = -1 it is flat below 1 - eps, but **not**
# flat above 1: a bad action that has become likelier is always corrected.  The dashed gradient
# is r A, the objective itself, until it drops to zero.

# %%
EPS = 0.2
ratios = np.linspace(0.4, 1.6, 241)
figure, axes = new_figure(1, 2, (9.0, 3.6))
for axis, advantage in zip(axes[0], (1.0, -1.0), strict=True):
    log_ratio = torch.tensor(np.log(ratios), requires_grad=True)
    a = torch.full(log_ratio.shape, advantage, dtype=log_ratio.dtype)
    # One sample at a time, so that the mean inside the loss is over one number.
    losses = torch.stack([policy_loss(log_ratio[k : k + 1], torch.zeros(1), a[k : k + 1], EPS) for k in range(len(a))])
    (slope,) = torch.autograd.grad(-losses.sum(), log_ratio)
    axis.plot(ratios, -losses.detach(), color=BLUE, label="objective")
    axis.plot(ratios, slope, color=RED, linestyle="--", label="its gradient by log pi")
    for edge in (1 - EPS, 1 + EPS):
        axis.axvline(edge, color="black", linewidth=0.8, linestyle=":")
    axis.set(xlabel="ratio r [-]", title=f"A = {advantage:+.0f}")
    axis.grid(alpha=0.3)
axes[0, 0].set_ylabel("objective of one action [-]")
axes[0, 0].legend(fontsize=8)
save(figure, "03_clipped_objective.png")

# %% [markdown]
# ## 3.4 Train it
#
# One iteration is: play `num_steps` steps with `num_envs` robots, compute the advantages, pass over
# the batch `update_epochs` times in `num_minibatches` pieces.  `train_policy` repeats that until the
# budget of the policy table is spent.  The same run from the command line is
# `agility-ref train walk --preset quick --out runs/tutorial`.

# %%
# Not in runs/quick, where the shipped selectors would find another walk than theirs.
config = TrainConfig(preset="quick", seed=0, out="runs/tutorial")
ppo = config.ppo
print(
    f"one iteration: {ppo.num_envs} robots x {ppo.num_steps} steps = {ppo.batch_size} steps, "
    f"then {ppo.update_epochs * ppo.num_minibatches} gradient steps"
)
folder = run_folder(config.root, "walk", config.seed)
if (folder / "DONE").exists():
    print(f"{folder} is finished; delete the folder to train again")
else:
    budget = find_policy("walk").steps(config.preset)
    print(
        f"training walk for {budget / 1e6:.1f} million steps = {budget * config.env.dt / 3600:.1f} hours of one robot's life"
    )
    train_policy("walk", config, draw=learning_curve)

progress = read_progress(folder / "progress.csv")
_, record = read_npz(folder / "policy.npz")
print(
    f"{progress['steps'][-1] / 1e6:.2f} million steps took {progress['wall_seconds'][-1] / 60:.1f} min "
    f"({np.median(progress['steps_per_second']):.0f} steps/s) on {record['versions']['machine']}"
)

# %% [markdown]
# ## 3.5 The learning curve
#
# *A right figure:* the waypoint fraction (left) stays near zero while the robots learn to stand, and
# rises steeply when they discover walking; the level of the curriculum follows it.  The return
# (right) rises with it.  These curves include exploration noise; 3.6 does not.

# %%
figure, axes = new_figure(1, 2, (9.0, 3.6))
steps = progress["steps"] / 1e6
left, right_axis = axes[0]
left.plot(steps, progress["waypoint_fraction"], color=BLUE, label="waypoint fraction")
left.plot(steps, progress["level"], color=ORANGE, label="level / top level")
left.set(xlabel="environment steps [million]", ylabel="fraction [-]", ylim=(0, 1.02))
left.legend(fontsize=8)
right_axis.plot(steps, progress["reward"], color=GREEN)
right_axis.set(xlabel="environment steps [million]", ylabel="return per episode [reward]")
for axis in axes[0]:
    axis.grid(alpha=0.3)
save(figure, "03_learning_curve.png")

# %% [markdown]
# ## 3.6 Does it walk?
#
# Evaluation plays whole episodes with the mean action, on courses that training never saw, with
# noise and pushes on as in the paper:
#
#     waypoint fraction = waypoints reached / 8

# %%
policy = load_policy("walk", config)
settings = EvaluationConfig(episodes=32, preset="quick")
summary = evaluate(policy, "walk", settings).summary()
print(f"walk on walk, {summary['episodes']} episodes, d ~ U(0, {PRESETS['quick'].max_difficulty}):")
for metric in ("waypoint_fraction", "reward", "episode_length", "edge_violation"):
    print(f"  {metric:18} {summary[metric]['mean']:8.2f} ± {summary[metric]['std']:.2f}")
print(f"  falls              {summary['falls']:8.2f}")

# %% [markdown]
# And one robot from above.
#
# *A right figure:* the line starts at x = 1 m and passes through one circle after another;
# the circles have the radius (0.2 m) within which a waypoint counts.  A kink is a push.

# %%
env = evaluation_env("walk", settings)
observation, _ = env.reset(settings.seed)
policy.reset()
path, done = [env.base_pos[0]], False
while not done:
    action, _ = policy.act(observation, env)
    observation, _, terminated, truncated, info = env.step(action)
    done = terminated[0] or truncated[0]
    if not done:  # after the last step the robot has been reset already
        path.append(env.base_pos[0])
path = np.array(path)  # (T, 3) [m]
reached, seconds = info["totals"]["waypoints"][0], info["totals"]["length"][0] * env.config.dt

figure, axes = new_figure(2, 1, (9.0, 4.2))
top, bottom = axes[:, 0]
ground = env.world.heights[0]  # (900, 200) [m]
top.imshow(
    ground.T, origin="lower", extent=(0, LANE_LENGTH, -LANE_WIDTH / 2, LANE_WIDTH / 2),
    cmap="Greys_r", interpolation="nearest", alpha=0.5,
)  # fmt: skip
angle = np.linspace(0, 2 * np.pi, 60)
for k, (wx, wy) in enumerate(env.world.waypoints[0]):
    radius = env.config.waypoint_radius
    top.plot(
        wx + radius * np.cos(angle), wy + radius * np.sin(angle), color=GREEN if k < reached else RED, linewidth=1.5
    )
top.plot(path[:, 0], path[:, 1], color=BLUE, linewidth=2)
top.set(ylabel="y [m]", ylim=(-1.2, 1.2), xlim=(0, 16))
top.set_title(
    f"{reached} of 8 waypoints in {seconds:.1f} s (green: reached); bumps of {100 * np.ptp(ground):.0f} cm in grey",
    fontsize=10,
)
bottom.plot(path[:, 0], path[:, 2], color=BLUE, linewidth=1)
bottom.set(xlabel="x [m]", ylabel="trunk height [m]", ylim=(0, 0.5), xlim=(0, 16))
bottom.grid(alpha=0.3)
save(figure, "03_path.png")
print(f"{reached} of 8 waypoints in {seconds:.1f} s, mean forward speed {np.ptp(path[:, 0]) / seconds:.2f} m/s")

# %% [markdown]
# **Predict, then run.**  Evaluate the walker where it was never trained:
# `evaluate(policy, "gap", settings).summary()`.  How many waypoints of a gap course come before
# the first gap?  That number is what a policy gets for free in Table 1.

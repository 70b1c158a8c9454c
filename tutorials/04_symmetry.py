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
# # 4. Symmetry: why half of a robot is enough
#
# Hold a mirror beside a Go1 that turns left, and you see a Go1 that turns right.  Whoever has learned the one should not have
# to learn the other.  This tutorial writes the mirror down as a matrix, checks that the physics respects it, builds a
# network that cannot help respecting it, measures what that is worth, and ends with a donkey that starves.
#
# It takes about 40 seconds on two cores.  As a notebook it shows its figures below the cells; `python tutorials/04_symmetry.py` writes
# them into the folder `figures/` of the directory you start it from.

# %%
import time

from agility_ref.env import ACTION_DIM, EnvConfig, Go1Env
from agility_ref.evaluate import EvaluationConfig, evaluation_env
from agility_ref.networks import EquivariantMLP
from agility_ref.observation import ACTION_MIRROR, OBS_MIRROR, observation_slices
from agility_ref.pictures.plots import BLUE, GREEN, GREY, ORANGE, RED, new_figure, show
from agility_ref.terrain import LANE_LENGTH, LANE_WIDTH, Box, Course
from agility_ref.training.bank import load_policy
from agility_ref.training.imitation import visit
from agility_ref.training.runs import TrainConfig
from agility_ref.world import World

import numpy as np
import torch
from torch import nn

STARTED = time.perf_counter()
torch.set_num_threads(1)

# %% [markdown]
# ## 4.1 The mirror
#
# In the mirror left and right legs change places, and whatever points sideways changes its sign.  For a vector of numbers
# that is a permutation with signs:
#
# $$(M x)_i = s_i\, x_{\pi(i)}, \qquad s_i = \pm 1, \qquad M^2 = 1$$
#
# `OBS_MIRROR` does this to the 184 numbers of an observation, `ACTION_MIRROR` to the 12 of an action.
#
# **Predict, then run.**  Which of the three components of a velocity $(v_x, v_y, v_z)$ change their signs in the mirror?
# And of an angular velocity $(\omega_x, \omega_y, \omega_z)$, that is of rolling, pitching and yawing?

# %%
for name, part in observation_slices().items():
    index, sign = OBS_MIRROR.index[part] - part.start, OBS_MIRROR.sign[part].astype(int)
    if name != "scandots":
        print(f"{name:18}", " ".join(f"{'+' if s > 0 else '-'}{i}" for i, s in zip(index, sign, strict=True)))
x = np.random.default_rng(0).normal(size=(5, len(OBS_MIRROR.index)))
print("twice in the mirror is no mirror:", np.array_equal(OBS_MIRROR(OBS_MIRROR(x)), x))

# %% [markdown]
# <details><summary>Answer</summary>
#
# Of the velocity only $v_y$, as one expects.  Of the angular velocity the **other** two, roll and yaw, while pitch keeps its
# sign: a nodding robot nods in the mirror too, but one that turns left turns right.  (Angular velocity is a cross product,
# and a cross product of mirrored vectors is minus the mirrored cross product.)  Of the joints only the hips change their
# signs, for thighs and calves move forwards and backwards; but all joints change legs.
#
# </details>

# %% [markdown]
# ## 4.2 Is the robot symmetric?
#
# Two robots on level ground.  One gets random actions $a_t$, the other their mirror images $M' a_t$, from the same straight
# start.  If robot and physics are symmetric, the second observes the mirror image of what the first observes.
#
# **Predict, then run.**  For how long will they be mirror images of each other: to the last digit, to three digits, not at
# all?
#
# *What you should see:* on the left, two trunks that move sideways in opposite directions, at least for a while.  On the
# right, how far their joint angles are from being mirror images, on a logarithmic axis.

# %%
flat = Course(
    "walk", 0.0, (Box(0.0, LANE_LENGTH, -LANE_WIDTH / 2, LANE_WIDTH / 2, 0.0),), (),
    np.column_stack([2.0 + 1.6 * np.arange(8), np.zeros(8)]),
)  # fmt: skip
ideal = EnvConfig(start_noise=0.0).clean()  # exactly in the middle, looking straight ahead; no noise, no pushes
env = Go1Env(World([flat]), num_envs=2, config=ideal)
observation, _ = env.reset(seed=0)
env.command[:] = 0.8  # [m/s] both asked for the same
rng = np.random.default_rng(0)
sideways, error, joints = [], [], observation_slices()["dof_pos"]
for _ in range(round(2.0 / ideal.dt)):
    action = rng.normal(0.0, 0.5, ACTION_DIM)
    observation, *_ = env.step(np.stack([action, ACTION_MIRROR(action)]))
    sideways.append(env.base_pos[:, 1])
    error.append(np.abs(observation[1] - OBS_MIRROR(observation[0]))[joints].max())
t = ideal.dt * (1 + np.arange(len(error)))

figure, axes = new_figure(1, 2, (10.0, 3.6))
left, right = axes[0]
for robot, colour in ((0, BLUE), (1, ORANGE)):
    left.plot(t, [100 * y[robot] for y in sideways], color=colour, label=("robot", "its mirror image")[robot])
left.set(xlabel="time [s]", ylabel="trunk's y [cm]")
left.legend(fontsize=9)
right.semilogy(t, error, color=GREY)
right.set(xlabel="time [s]", ylabel="largest difference of joint angles [rad]")
for axis in (left, right):
    axis.grid(alpha=0.3)
show(figure, "04_two_robots")
print(
    f"joint angles differ from the mirror image by {error[0]:.0e} rad after the first step, "
    f"by up to {max(error[: round(0.5 / ideal.dt)]):.0e} rad in the first half second, by up to {max(error):.2f} rad in two"
)
trunk = env.simulation.models[0].body("trunk")
print(f"the trunk's centre of mass is {1000 * trunk.ipos[1]:+.0f} mm to the left of its middle")

# %% [markdown]
# <details><summary>Answer</summary>
#
# Not to the last digit, because the robot is only **nearly** symmetric.  Unitree put the battery and the computer where there
# was room, and the trunk's centre of mass lies 2 mm to the left.  At first that hardly moves a joint; then a foot slips or
# lands a step earlier on one side, and the two go their own ways: contacts make small differences large.  But for the next
# few steps, which is what an action decides, left and right are the same robot.
#
# </details>

# %% [markdown]
# ## 4.3 A network that cannot help it
#
# We want a policy with $f(M x) = M' f(x)$ for **every** $x$, not only for those it was trained on.  Split the input into what
# the mirror keeps and what it flips, with orthonormal bases $E$ and $O$:
#
# $$e = E x, \quad o = O x \qquad\Rightarrow\qquad M:\; e \mapsto e,\;\; o \mapsto -o$$
#
# A linear layer may mix even numbers with even ones and odd with odd, but not the two.  A nonlinearity would break that:
# $\operatorname{elu}(-o) \ne -\operatorname{elu}(o)$.  So hidden units come in pairs that swap in the mirror:
#
# $$e' = W_e e + b, \quad o' = W_o o, \qquad u = \operatorname{elu}(e' + o'), \quad v = \operatorname{elu}(e' - o')$$
#
# In the mirror $o' \to -o'$, so $u \leftrightarrow v$, and $(u+v)/\sqrt 2$ is even again and $(u-v)/\sqrt 2$ odd.
#
# **Predict, then run.**  An ordinary network has 184 x 256 weights in its first layer.  How many has this one?

# %%
even, odd = OBS_MIRROR.bases()
print(f"of {len(OBS_MIRROR.index)} numbers {len(even)} are even and {len(odd)} odd")
torch.manual_seed(0)
net = EquivariantMLP(OBS_MIRROR, (256, 128), ACTION_MIRROR, 1.0)
x = torch.from_numpy(rng.normal(size=(1000, len(OBS_MIRROR.index))).astype(np.float32))
with torch.no_grad():
    f, f_mirrored = (net(net.parts(z)).numpy() for z in (x, torch.from_numpy(OBS_MIRROR(x.numpy()))))
print(
    f"largest |f(Mx) - M'f(x)|: {np.abs(f_mirrored - ACTION_MIRROR(f)).max():.0e}, where |f| is up to {np.abs(f).max():.1f}"
)
own = sum(p.numel() for p in net.parameters())
first = net.own[0].weight.numel() + net.other[0].weight.numel()
ordinary = sum(array.size for array in net.dense().values())
print(f"first layer: {first} weights instead of {184 * 256}; all layers: {own} numbers instead of {ordinary}")

# %% [markdown]
# <details><summary>Answer</summary>
#
# 128 pairs, each with a row for the 98 even numbers and one for the 86 odd ones: $128 \cdot (98 + 86) = 23552$, half of
# $184 \cdot 256 = 47104$.  Half of the numbers, half of the multiplications, and the network can still be multiplied out into
# ordinary layers (`dense`), which is what a checkpoint holds: the symmetry is in the values of its weights.
#
# </details>
#
# One more thing is hidden in `EquivariantMLP`.  For inputs that come in pairs, left and right, its hidden layers do not learn $W_e$ and
# $W_o$ but $P = (W_e + W_o)/\sqrt 2$ and $Q = (W_e - W_o)/\sqrt 2$, the weights of the dense layer that they make.  For the function
# this makes no difference.  For Adam it does, because Adam gives even the smallest gradient a full step.  On ground that is nearly
# the same on both sides the gradient of $W_o$ is almost pure noise, and $W_o$ would grow on that noise alone.  `climb` reached
# 0.79 of its waypoints that way, and 0.93 this way (docs/training.md).

# %% [markdown]
# ## 4.4 What it is worth
#
# A network that knows the mirror has seen the mirror image of everything it has seen.  So it should need about half of the
# examples.  To measure that without an hour of training, let networks **imitate** a policy that ships with the package:
# the walking specialist drives, we write down $n$ states and its actions, fit three networks, and test them on states of
# other episodes.
#
# * *plain*: an ordinary network
# * *plain, mirrored data*: the same, which is given each state and its mirror image
# * *equivariant*: the network of 4.3
#
# All three have hidden layers of 64 and 64 units and get the same number of gradient steps.
#
# *What you should see:* three lines that fall, each the mean of three seeds (dots).  Read them from left to right: which of
# the two others has, at $n$ examples, the error that the plain network has at $2 n$?

# %%
walk = load_policy("walk", TrainConfig(preset="full", seed=0))
driven = np.concatenate(list(visit(evaluation_env("walk", EvaluationConfig(episodes=16)), walk, 6_000)))
with np.errstate(over="ignore"):
    wanted = walk.policy(driven).astype(np.float32)  # (M, 12)
inputs = np.clip((driven - walk.policy.mean) / walk.policy.std, -5, 5).astype(np.float32)
known, unseen = slice(0, 4_000), slice(4_000, None)


class Plain(nn.Module):
    """An ordinary network of the same size."""

    def __init__(self):
        super().__init__()
        layers = nn.Linear(inputs.shape[1], 64), nn.ELU(), nn.Linear(64, 64), nn.ELU(), nn.Linear(64, ACTION_DIM)
        self.layers = nn.Sequential(*layers)

    def forward(self, x):
        """Return actions (n, 12)."""
        return self.layers(x)


class Equivariant(nn.Module):
    """The network of 4.3, with its own last layer."""

    def __init__(self):
        super().__init__()
        self.net = EquivariantMLP(OBS_MIRROR, (64, 64), ACTION_MIRROR, 1.0)

    def forward(self, x):
        """Return actions (n, 12)."""
        return self.net(self.net.parts(x))


def imitation_error(kind, mirrored, examples, seed, steps=1000, batch=64):
    """Fit a network to some of the states; return its mean squared error on unseen ones / their variance."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    rows = rng.choice(known.stop, examples, replace=False)
    x, y = inputs[rows], wanted[rows]
    if mirrored:
        x, y = np.concatenate([x, OBS_MIRROR(x)]), np.concatenate([y, ACTION_MIRROR(y)])
    x, y, model = torch.from_numpy(x), torch.from_numpy(y), kind()
    optimizer = torch.optim.Adam(model.parameters(), 1e-3)
    for _ in range(steps):
        drawn = torch.from_numpy(rng.integers(0, len(x), batch))
        loss = ((model(x[drawn]) - y[drawn]) ** 2).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    with torch.no_grad():
        error = ((model(torch.from_numpy(inputs[unseen])).numpy() - wanted[unseen]) ** 2).mean()
    return error / wanted[unseen].var()


EXAMPLES = (50, 100, 200, 400, 800)
figure, axes = new_figure(1, 1, (7.0, 4.2))
axis = axes[0, 0]
for label, kind, mirrored, colour in (
    ("plain", Plain, False, RED),
    ("plain, mirrored data", Plain, True, ORANGE),
    ("equivariant", Equivariant, False, GREEN),
):
    errors = np.array([[imitation_error(kind, mirrored, n, seed) for n in EXAMPLES] for seed in range(3)])  # (3, 5)
    axis.loglog(EXAMPLES, errors.mean(axis=0), color=colour, label=label)
    axis.loglog(EXAMPLES, errors.T, "o", color=colour, markersize=4, alpha=0.6)
    print(f"{label:21}", "  ".join(f"{n}: {e:.3f}" for n, e in zip(EXAMPLES, errors.mean(axis=0), strict=True)))
axis.set_xticks(EXAMPLES, EXAMPLES)
axis.set_yticks(ticks := (0.01, 0.02, 0.03, 0.05, 0.1), ticks)
axis.minorticks_off()
axis.set(xlabel="examples n [-]", ylabel="squared error / variance of the actions [-]")
axis.legend(fontsize=9)
axis.grid(alpha=0.3, which="both")
show(figure, "04_examples")

# %% [markdown]
# Giving a plain network the mirrored data as well is the cheap way to teach it the symmetry, and for imitation it is a good one:
# $n$ examples with their mirror images are worth nearly as much as $2 n$.  The equivariant network gains less here, for it is
# another network: with half of the free numbers it takes another path through the same number of gradient steps.  What it does
# have is the symmetry **everywhere and exactly**, where mirrored data teach it roughly and only where there are data; and it
# saves half of the arithmetic, where they double it.  In reinforcement learning mirrored data have a catch besides: the mirrored
# action of a policy that is not symmetric is an action that it would hardly have taken, and PPO's ratio of probabilities
# (tutorial 3) makes no sense for it.

# %% [markdown]
# ## 4.5 A surprise: the donkey between two haystacks
#
# Buridan's donkey stands exactly between two equal heaps of hay, has no reason to prefer one, and starves.  Our robot starts
# in the same spot: legs in the home pose, looking straight ahead, on level ground.  Its observation is its own mirror
# image, $x = M x$, so
#
# $$f(x) = f(M x) = M' f(x)$$
#
# Whatever it does, it does **with both sides at once**.  A trot lifts one front foot and leaves the other on the ground.
#
# **Predict, then run.**  We let the shipped walking policy start there, once in an ideal world without any noise and once
# with the usual noise of its sensors.  Can it ever begin to trot in the ideal world?
#
# *What you should see:* how different left and right are, as the largest difference between an action and its mirror image,
# on a logarithmic axis; and below, which feet stand (dark).  Where a line drops back to rounding error the robot has fallen
# and starts again.

# %%
figure, axes = new_figure(3, 1, (8.0, 6.6))
for line, (label, noise, colour) in enumerate((("ideal", 0.0, BLUE), ("with noise", 1.0, RED))):
    env = Go1Env(
        World([flat]), num_envs=1, config=EnvConfig(start_noise=0.0, noise=noise, push_interval=0.0, payload_high=0.0)
    )
    observation, _ = env.reset(seed=3)
    asymmetry, feet, falls = [], [], 0
    for _ in range(round(4.0 / ideal.dt)):
        action = walk.policy(observation)
        asymmetry.append(np.abs(action - ACTION_MIRROR(action)).max())
        observation, _, terminated, _, _ = env.step(action)
        falls += terminated.sum()
        feet.append(env.foot_contact[0].copy())
    t = ideal.dt * np.arange(len(asymmetry))
    axes[0, 0].semilogy(t, np.maximum(asymmetry, 1e-9), color=colour, label=label)
    axes[line + 1, 0].imshow(
        np.array(feet).T, aspect="auto", cmap="Greys", vmin=0, vmax=1.3, interpolation="nearest",
        extent=(0, t[-1] + ideal.dt, 3.5, -0.5),
    )  # fmt: skip
    axes[line + 1, 0].set_yticks(range(4), ["FR", "FL", "RR", "RL"])
    axes[line + 1, 0].set_title(label, loc="left", fontsize=10)
    different = np.flatnonzero(np.array(asymmetry) > 0.1)
    when = f"after {different[0] * ideal.dt:.2f} s" if len(different) else "never in these 4 s"
    print(f"{label:10}: left and right differ by {asymmetry[0]:.0e} at the start, by 0.1 {when}; falls: {falls}")
axes[0, 0].set(ylabel="|a - M'a|", xlim=(0, 4))
axes[0, 0].legend(fontsize=9, loc="lower right")
axes[0, 0].grid(alpha=0.3)
axes[2, 0].set_xlabel("time [s]")
show(figure, "04_donkey")
print(f"time: {time.perf_counter() - STARTED:.0f} s")

# %% [markdown]
# <details><summary>Answer</summary>
#
# On paper never: with equal numbers on both sides the legs move in pairs, front with front and rear with rear, for ever.  You
# can see it try: in the first stride of the ideal world both rear feet leave the ground nearly together, a gait that the policy
# has never practised.  In the simulation it can get away from there, because something breaks the tie: the centre of mass that
# lies 2 mm to the left (4.2), and, if that were not so, the rounding errors with which the blue line begins.
# A robot on its legs is unstable, so such a difference grows until one side wins.  With noise the tie is broken at the first
# step.
#
# So noise is not only a nuisance that a robust policy has to endure: a symmetric policy **needs** it, or a body or a start
# that is a little crooked, to choose a side.  Training has all of these.
#
# </details>
#
# Next: `05_climb.py` trains such a network.

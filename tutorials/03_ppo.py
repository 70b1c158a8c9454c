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
# # 3. PPO: advantages by hand, and a silent bug
#
# PPO needs three ideas: how much better an action was than expected (two lines of numpy), what to do when an episode ends
# (where many implementations are wrong), and how far one update may go (one line of torch).  Then the whole algorithm
# learns a small task twice, once as it should and once with a bug that nobody notices (paper section 3.2.1).
#
# It takes about 10 seconds on two cores.  As a notebook it shows its figures below the cells; `python tutorials/03_ppo.py` writes
# them into the folder `figures/` of the directory you start it from.

# %%
import time

from agility_ref.observation import Mirror
from agility_ref.pictures.plots import BLUE, GREEN, ORANGE, RED, new_figure, show
from agility_ref.ppo import Learner, PPOConfig, gae, policy_loss, train

import numpy as np
import torch

STARTED = time.perf_counter()

# %% [markdown]
# ## 3.1 How much better than expected?
#
# The critic predicts $V(s)$, the discounted reward from state $s$ on.  One step later we know more:
#
# $$\delta_t = r_t + \gamma V(s_{t+1}) - V(s_t) \quad \text{(surprise of one step)}, \qquad
# A_t = \delta_t + \gamma \lambda A_{t+1} \quad \text{(surprises that follow count too)}$$
#
# Three steps by hand, with $\gamma = 0.9$ and $\lambda = 0.8$, so $\gamma \lambda = 0.72$; rewards $1, 2, 3$; values
# $V(s_0), V(s_1), V(s_2) = 4, 5, 6$ and $V(s_3) = 7$:
#
# $$\begin{aligned}
# \delta_2 &= 3 + 0.9 \cdot 7 - 6 = 3.3 & A_2 &= 3.3 \\
# \delta_1 &= 2 + 0.9 \cdot 6 - 5 = 2.4 & A_1 &= 2.4 + 0.72 \cdot 3.3 = 4.776 \\
# \delta_0 &= 1 + 0.9 \cdot 5 - 4 = 1.5 & A_0 &= 1.5 + 0.72 \cdot 4.776 = 4.93872
# \end{aligned}$$

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
# $$\delta_1 = 2 + 0 - 5 = -3, \qquad A_1 = -3, \qquad A_0 = 1.5 - 0.72 \cdot 3 = -0.66$$
#
# *Truncated*: the clock ran out.  The robot was fine and would have gone on, so the value of
# its last state counts; but step 2 belongs to another episode and adds nothing:
#
# $$\delta_1 = 2 + 0.9 \cdot 6 - 5 = 2.4, \qquad A_1 = 2.4, \qquad A_0 = 1.5 + 0.72 \cdot 2.4 = 3.228$$
#
# A trap: after an automatic reset the next observation in the buffer is the *new* episode's
# first.  $V(s_{t+1})$ has to come from the true last observation, `info["final_obs"]`.

# %%
fell = gae(rewards, values, next_values, at_1, no, 0.9, 0.8)
timed_out = gae(rewards, values, next_values, no, at_1, 0.9, 0.8)
print("terminated at step 1   A =", fell[:, 0].round(5))
print("truncated at step 1    A =", timed_out[:, 0].round(5))
assert np.allclose(fell[:, 0], [-0.66, -3.0, 3.3])
assert np.allclose(timed_out[:, 0], [3.228, 2.4, 3.3])

# %% [markdown]
# **Predict, then run.**  What are the advantages of the running episode for $\lambda = 0$ and for $\lambda = 1$?  For which
# of the two does the critic's opinion of $s_1$ and $s_2$ not matter in $A_0$?

# %%
for lam in (0.0, 1.0):
    print(
        f"lambda = {lam:.0f}:  A =", gae(rewards, values, next_values, no, no, gamma=0.9, gae_lambda=lam)[:, 0].round(5)
    )

# %% [markdown]
# <details><summary>Answer</summary>
#
# For $\lambda = 0$ each advantage is the surprise of one step, $1.5, 2.4, 3.3$: little noise, but as wrong as the critic is.
# For $\lambda = 1$ the sum telescopes, $A_0 = 1 + 0.9 \cdot 2 + 0.81 \cdot 3 + 0.729 \cdot 7 - 4 = 6.333$: $V(s_1)$ and
# $V(s_2)$ drop out, and all the noise of the rewards is in.  $\lambda = 0.95$ is the usual compromise.
#
# </details>

# %% [markdown]
# ## 3.2 One way to be wrong: bootstrapping on death
#
# Suppose someone merges the two flags and treats every end as a time-out.  Nothing crashes.
# Take the smallest world that shows what happens: one state, reward 1 per step, and at every step
# the robot dies with probability $p$.  Then
#
# $$\text{truth: } V = 1 + \gamma (1 - p) V \;\Rightarrow\; V = \frac{1}{1 - \gamma (1 - p)}, \qquad
# \text{with the bug: } V = 1 + \gamma V \;\Rightarrow\; V = \frac{1}{1 - \gamma}$$
#
# The second does not contain $p$.  To the buggy learner **dying costs nothing**, however
# often it happens.  We let both learn from the same experience with `gae`; advantage plus value is
# the critic's target.
#
# *What you should see:* each curve climbs to its dashed line; the orange one stays five times too
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
axis.set_title(f"one state, reward 1, death with probability {DEATH} per step", fontsize=10)
axis.legend(fontsize=8, loc="center right")
axis.grid(alpha=0.3)
show(figure, "03_bootstrap_bug")

# %% [markdown]
# ## 3.3 How far may one update go?
#
# PPO raises the probability of actions with $A > 0$ and lowers it for $A < 0$, but stops
# caring once the ratio $r = \pi(a|s) / \pi_\text{old}(a|s)$ has moved by $\epsilon$:
#
# $$L = -\,\mathbb{E}\bigl[\min\bigl(r A,\; \operatorname{clip}(r, 1 - \epsilon, 1 + \epsilon)\, A\bigr)\bigr]$$
#
# *What you should see:* for $A = +1$ the objective (minus the loss) grows with $r$ and is flat beyond
# $1 + \epsilon$: no more gain from going further.  For $A = -1$ it is flat below $1 - \epsilon$, but **not**
# flat above 1: a bad action that has become likelier is always corrected.  The dashed gradient
# is $r A$, the objective itself, until it drops to zero.

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
show(figure, "03_clipped_objective")

# %% [markdown]
# ## 3.4 The silent bug: a goal that costs everything
#
# Now the opposite mistake, the commoner one: **every end is treated as a death**, time-outs too.  Our robots meet it daily, for
# on their courses an episode is truncated after 20 s *or at the last waypoint*.
#
# To see it in seconds, take a runner in the plane.  It starts at $x = 0$ and sets its velocity $(v_x, v_y)$, at most 1 m/s
# each, ten times a second.  It gets a reward for being alive and one for running forwards,
#
# $$r = 0.2 + 0.8\, v_x - y^2 \quad \text{per second},$$
#
# and its episode is truncated at $x = 4$ m (well done!) or after 10 s.  It never dies.  The observation is
# $(x, y, v_x, v_y)$; left and right are alike, which `Mirror` says with a sign (tutorial 4).
#
# **Predict, then run.**  One learner is told that its episodes were truncated, the other that they terminated.  What will
# the second do about the goal?  And which of the two collects more reward in an episode?


# %%
class Runner:
    """N runners in the plane, with the interface that ``train`` expects; ``bug`` calls every end a death."""

    GOAL, DT, LIMIT = 4.0, 0.1, 100  # [m], [s], control steps

    def __init__(self, num_envs, bug):
        self.num_envs, self.bug = num_envs, bug

    def reset(self, seed=None):
        """Start anew, all of them."""
        self.rng = np.random.default_rng(seed)
        self.state = np.zeros((self.num_envs, 4), np.float32)
        self.age, self.total = np.zeros(self.num_envs, int), np.zeros(self.num_envs)
        self._start(np.arange(self.num_envs))
        return self.state.copy(), {}

    def _start(self, who):
        self.state[who] = 0.0
        self.state[who, 1] = self.rng.uniform(-0.5, 0.5, len(who))
        self.age[who], self.total[who] = 0, 0.0

    def step(self, action):
        """Run for a tenth of a second."""
        velocity = np.clip(action, -1.0, 1.0)
        self.state[:, :2] += self.DT * velocity
        self.state[:, 2:] = velocity
        self.age += 1
        reward = self.DT * (0.2 + 0.8 * velocity[:, 0] - self.state[:, 1] ** 2)
        self.total += reward
        arrived = self.state[:, 0] >= self.GOAL
        over = arrived | (self.age >= self.LIMIT)
        info = {
            "final_obs": self.state.copy(),
            "kind": np.zeros(self.num_envs, int),  # there is one kind of course
            "totals": {"reward": self.total.copy(), "arrived": arrived.copy(), "length": self.age.copy()},
        }
        self._start(np.flatnonzero(over))
        never = np.zeros_like(over)
        terminated, truncated = (over, never) if self.bug else (never, over)
        return self.state.copy(), reward.astype(np.float32), terminated, truncated, info


HANDEDNESS = Mirror(np.arange(4), np.array([1, -1, 1, -1], np.float32))  # of (x, y, vx, vy)
ACTION = Mirror(np.arange(2), np.array([1, -1], np.float32))
config = PPOConfig(num_envs=128, num_steps=32, hidden=(32, 32))
ITERATIONS = 50


def learn(bug):
    """Train runners; return the learner, and return and share of arrivals of each iteration's episodes."""
    learner = Learner.create(HANDEDNESS, ACTION, config, seed=0)
    history = []
    for record in train(Runner(config.num_envs, bug), learner, ITERATIONS * config.batch_size):
        ended = record["episodes"] or [{"reward": np.nan, "arrived": np.nan}]
        history.append([np.mean([e[key] for e in ended]) for key in ("reward", "arrived")])
    return learner, np.array(history).T


def run(learner):
    """Positions x (T,) of one runner without exploration, until its episode is over."""
    env, positions, over = Runner(1, bug=False), [0.0], False
    observation, _ = env.reset(0)
    with torch.inference_mode():
        while not over:
            action = learner.net.actor(learner.observe(observation)).numpy()
            observation, _, _, truncated, info = env.step(action)
            positions.append(info["final_obs"][0, 0])
            over = truncated[0]
    return np.array(positions)


runs = {"right": learn(bug=False), "with the bug": learn(bug=True)}

# %% [markdown]
# *What you should see:* on the left, what a programmer watches, the return.  On the right, what the runners do.

# %%
figure, axes = new_figure(1, 3, (12.0, 3.6))
for (label, (learner, (returns, arrived))), colour in zip(runs.items(), (BLUE, ORANGE), strict=True):
    x = run(learner)
    some = np.flatnonzero(np.isfinite(returns))  # iterations in which an episode ended
    axes[0, 0].plot(some, returns[some], color=colour, label=label)
    axes[0, 1].plot(some, arrived[some], color=colour)
    axes[0, 2].plot(Runner.DT * np.arange(len(x)), x, color=colour)
    print(
        f"{label:13}: return {np.nanmean(returns[-5:]):.1f}, {np.nanmean(arrived[-5:]):.0%} of the episodes arrive; "
        f"without exploration at x = {x[-1]:.2f} m after {Runner.DT * (len(x) - 1):.1f} s"
    )
axes[0, 0].set(xlabel="iteration", ylabel="return per episode [reward]")
axes[0, 0].legend(fontsize=9)
axes[0, 1].set(xlabel="iteration", ylabel="share of episodes that arrive [-]", ylim=(-0.03, 1.03))
axes[0, 2].axhline(Runner.GOAL, color=GREEN, linestyle="--", linewidth=1)
axes[0, 2].set(xlabel="time [s]", ylabel="x of one runner [m], goal dashed")
for axis in axes[0]:
    axis.grid(alpha=0.3)
show(figure, "03_silent_bug")
print(f"time: {time.perf_counter() - STARTED:.0f} s")

# %% [markdown]
# <details><summary>Answer, and the surprise</summary>
#
# The learner with the bug believes that the world ends at the goal.  Behind it is nothing, before it 0.2 per second for
# being alive.  So it runs, because running pays, gets slower and slower, and waits in front of the goal until the clock runs out.
# It arrives only when exploration pushes it over the line.  It is an excellent solution of the wrong problem.
#
# The surprise is the left picture: **its return is the higher one**.  A runner that arrives stops collecting, so by the
# curve that everybody watches, the bug is an improvement.  Nothing crashes, the losses fall, the reward rises.  Two things
# give it away: a measure of what you want (here the share that arrives, for our robots the waypoints), and a test with
# three steps and arithmetic by hand, as in 3.1.
#
# </details>
#
# **Try.**  Give the reward no 0.2 for being alive.  Is the bug then harmless?
#
# <details><summary>Answer</summary>
#
# Nearly.  Waiting earns nothing now, and the last step before the goal still earns its reward, so both arrive.  Whether this bug
# bites depends on the reward, which is why it survives in code that "works": it was tried on a task where it does not.
#
# </details>
#
# Next: `04_symmetry.py`.

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
# # 2. The robot: masses, motors, senses, rewards
#
# A Unitree Go1 is a trunk and four legs with three motors each.  This tutorial opens
# the model, pushes one motor to its limit, reads the observation, takes the reward
# apart, and weighs the robot with its own feet (paper sections 3.1 and 4.1).
#
# It takes about 5 seconds on two cores.  As a notebook it shows its figures below the cells; `python tutorials/02_robot.py` writes
# them into the folder `figures/` of the directory you start it from.

# %%
from agility_ref.env import ACTION_DIM, EnvConfig, Go1Env
from agility_ref.go1 import (
    DEFAULT_DOF_POS,
    DOF_RANGE,
    FOOT_TOUCH,
    JOINTS,
    LEGS,
    STAND_HEIGHT,
    TORQUE_LIMITS,
    PhysicsConfig,
    make_model,
)
from agility_ref.observation import OBS_DIM, OBSERVATION, observation_slices
from agility_ref.pictures.plots import BLUE, GREY, LEG_COLOURS, PURPLE, RED, new_figure, show
from agility_ref.terrain import make_course
from agility_ref.world import World

import mujoco
import numpy as np

# %% [markdown]
# ## 2.1 The model
#
# `make_model` compiles one Go1 on one course.  Legs come in the order FR, FL, RR, RL (front
# right first), and each has a hip (sideways), a thigh and a calf joint.  Axes: x forward,
# y left, z up.

# %%
flat = make_course("walk", difficulty=0.0, seed=0)
model = make_model(flat)
print(f"{'body':10}{'mass [kg]':>10}")
for body in range(1, model.nbody):
    print(f"{model.body(body).name:10}{model.body_mass[body]:10.3f}")
total_mass = model.body_subtreemass[1]
print(f"{'total':10}{total_mass:10.3f}   = {total_mass * 9.81:.1f} N on the ground\n")

print(f"{'joint':10}{'range [rad]':>20}{'home [rad]':>12}{'limit [N m]':>13}")
for k, joint in enumerate(JOINTS[:3]):  # the other legs are the same
    low, high = DOF_RANGE[k]
    print(f"{joint:10}{low:10.3f} ..{high:7.3f}{DEFAULT_DOF_POS[k]:12.2f}{TORQUE_LIMITS[k]:13.2f}")

# %% [markdown]
# *What you should see:* the home pose.  From the side the legs are bent like a `<` with the
# knees to the rear and every foot straight below its hip; from above the hips stand
# between trunk and leg, and nothing is crossed.

# %%
data = mujoco.MjData(model)
mujoco.mj_resetDataKeyframe(model, data, 0)
mujoco.mj_forward(model, data)

figure, axes = new_figure(1, 2, (10.0, 3.6))
for leg, colour in LEG_COLOURS.items():
    chain = [data.body(f"{leg}_{part}").xpos for part in ("hip", "thigh", "calf")] + [data.site(f"{leg}_foot").xpos]
    chain = np.array(chain) - [data.qpos[0], data.qpos[1], 0.0]  # (4, 3): hip, thigh, knee, foot
    if leg.endswith("L"):  # seen from the left, the right legs are hidden behind these
        axes[0, 0].plot(chain[:, 0], chain[:, 2], "o-", color=colour, linewidth=3)
    axes[0, 1].plot(chain[:, 0], chain[:, 1], "o-", color=colour, label=leg, linewidth=3)
half = model.geom("trunk").size
for axis, (h, centre) in zip(axes[0], ((half[2], STAND_HEIGHT), (half[1], 0.0)), strict=True):
    corners = np.array([[-half[0], -h], [half[0], -h], [half[0], h], [-half[0], h], [-half[0], -h]])
    axis.plot(corners[:, 0], corners[:, 1] + centre, color="black", linewidth=1)
    axis.set(xlabel="x, forward [m]", xlim=(-0.4, 0.3), aspect="equal")
    axis.grid(alpha=0.3)
axes[0, 0].axhline(0, color="#777777", linewidth=2)
axes[0, 0].set(ylabel="z, up [m]", title="from the left", ylim=(-0.03, 0.37))
axes[0, 1].set(ylabel="y, left [m]", title="from above", ylim=(-0.2, 0.2))
axes[0, 1].legend(fontsize=8, loc="center")
show(figure, "02_home_pose")

# %% [markdown]
# ## 2.2 A motor is a spring, a damper and a limit
#
# The policy does not command torques.  It names a target angle for every joint, 25 times a
# second, and a PD controller turns that into a torque:
#
# $$q_\text{target} = q_\text{home} + \text{action\_scale} \cdot a \quad [\text{rad}], \qquad
# \tau = \operatorname{clip}\bigl(k_p\,(q_\text{target} - q) - k_d\,\dot q,\; -\tau_\text{max},\; \tau_\text{max}\bigr)
# \quad [\text{N m}]$$
#
# To see the motor alone we switch gravity off, hang the robot in the air, and ask one
# thigh joint for a small and for a large step.  Dots are the torque law above computed from the
# recorded q and qdot; the line is what MuJoCo applied.
#
# *What you should see:* the torque of the small step starts at kp times the step; that of the
# large one sits on the limit (dotted) until the joint has got going.  Then both reverse,
# because the damper brakes, overshoot a little and settle on the dashed target.  The dots lie
# on the lines.

# %%
physics = PhysicsConfig(timestep=0.001)  # ten times finer than in training, for a smooth picture
motor = JOINTS.index("FR_thigh")


def step_response(size, seconds=0.4):
    """Ask the FR thigh for a step [rad]; return time, angle, velocity, torque."""
    fine = make_model(flat, physics)
    fine.opt.gravity[:] = 0.0
    d = mujoco.MjData(fine)
    mujoco.mj_resetDataKeyframe(fine, d, 0)
    d.qpos[2] = 2.0  # [m] in the air
    d.ctrl[motor] += size
    record = []
    while d.time < seconds:
        q, qdot = d.qpos[7 + motor], d.qvel[6 + motor]  # 7 and 6: the trunk's free joint comes first
        mujoco.mj_step(fine, d)
        record.append((d.time, q, qdot, d.actuator_force[motor]))
    return np.array(record).T


figure, axes = new_figure(2, 1, (8.0, 5.5))
for size, colour in ((0.3, BLUE), (1.2, RED)):
    t, q, qdot, torque = step_response(size)
    target = DEFAULT_DOF_POS[motor] + size
    law = np.clip(physics.kp * (target - q) - physics.kd * qdot, -TORQUE_LIMITS[motor], TORQUE_LIMITS[motor])
    axes[0, 0].plot(t, q, color=colour, label=f"step of {size} rad")
    axes[0, 0].axhline(target, color=colour, linewidth=0.8, linestyle="--")
    axes[1, 0].plot(t, torque, color=colour)
    axes[1, 0].plot(t[::8], law[::8], "o", color=colour, markersize=3, alpha=0.6)
    held = np.mean(np.abs(torque) > 0.999 * TORQUE_LIMITS[motor]) * t[-1]
    print(f"step {size} rad: peak torque {np.abs(torque).max():.1f} N m, at the limit for {1000 * held:.0f} ms")
for limit in (-1, 1):
    axes[1, 0].axhline(limit * TORQUE_LIMITS[motor], color="black", linewidth=0.8, linestyle=":")
axes[0, 0].set(ylabel="thigh angle q [rad]")
axes[0, 0].legend(fontsize=8, loc="lower right")
axes[1, 0].set(xlabel="time [s]", ylabel="torque [N m]")
for axis in axes[:, 0]:
    axis.grid(alpha=0.3)
show(figure, "02_step_response")

# %% [markdown]
# **Predict, then run.**  From which step size on does the thigh saturate at once?  Work it out from the torque law, then
# run the cell.

# %%
for size in (0.6, 0.65, 0.7, 0.75):
    torque = step_response(size)[3]
    print(f"step {size} rad: first torque {torque[0]:.2f} N m, the limit is {TORQUE_LIMITS[motor]} N m")

# %% [markdown]
# <details><summary>Answer</summary>
#
# Before anything moves, $\dot q = 0$ and $q_\text{target} - q$ is the step itself, so the law saturates at
# $k_p \cdot \text{size} = \tau_\text{max}$, which is $23.7 / 35 = 0.677$ rad or an action of $0.677 / 0.3 = 2.3$.  The
# environment clips actions at 4, so a policy can ask for more than the motor gives: near the limit, asking for more
# changes nothing, and a learner that is out there gets no signal from its actions.
#
# </details>

# %% [markdown]
# ## 2.3 What the policy sees
#
# One vector of 184 numbers.  The table below is printed from the code, so it cannot be wrong;
# the last column is the amplitude of the uniform noise that training and evaluation add.

# %%
print(f"{'from':>5}{'to':>5}  {'name':20}{'size':>5}  noise +-")
for name, part in observation_slices().items():
    size, noise = OBSERVATION[name]
    print(f"{part.start:5}{part.stop:5}  {name:20}{size:5}  {noise}")
print(f"{OBS_DIM} numbers in all; {ACTION_DIM} actions\n")

courses = [make_course("walk", difficulty=0.0, seed=k) for k in range(4)]
config = EnvConfig().clean()  # no noise, no pushes, no payload
env = Go1Env(World(courses), num_envs=64, config=config)
observation, _ = env.reset(seed=0)
for name, part in observation_slices().items():
    if part.stop - part.start <= 3:
        print(f"robot 0, {name}: {np.round(observation[0, part], 3)}")

# %% [markdown]
# **Predict.**  `projected_gravity` is the direction "down" seen from the trunk.  What would it be for a robot that lies
# on its right side?
#
# <details><summary>Answer</summary>
#
# $(0, -1, 0)$: the trunk's y axis points to its left, and that side is up now, so "down" is along $-y$.  Nothing in this
# vector depends on where the robot faces: gravity tells roll and pitch, never yaw.
#
# </details>

# %% [markdown]
# ## 2.4 The reward, term by term
#
# Each term is one function in `rewards.py`; the reward of a step is their weighted sum
#
# $$r = \Delta t \sum_k w_k\, \text{term}_k$$
#
# We let 64 robots twitch with small random actions for two seconds and average every term.
# Dividing by dt gives reward per second, which is easier to read.
#
# **Predict, then run.**  We do the same with 64 robots that do nothing at all and hold the home pose.  Who earns more, the
# robots that move or those that stand still?
#
# *What you should see:* `alive` and `tracking_yaw` stand near their weights in `RewardConfig`, because nobody falls and
# everybody faces the waypoint.  `tracking_goal_vel`, the largest weight of all, is not even positive: nobody gets
# anywhere, and landing from the start pose slides the robots back a little.  Most of what twitching changes are costs.


# %%
def mean_terms(amplitude, seconds=2.0):
    """Mean of each weighted term per second, over 64 robots whose actions are normal draws of this size."""
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    steps = round(seconds / config.dt)
    sums, largest, falls = {}, 0.0, 0
    for _ in range(steps):
        _, reward, terminated, _, info = env.step(amplitude * rng.standard_normal((env.num_envs, ACTION_DIM)))
        falls += terminated.sum()
        for name, term in info["reward_terms"].items():
            sums[name] = sums.get(name, 0.0) + term.mean() / seconds
        largest = max(largest, np.abs(sum(info["reward_terms"].values()) - reward).max())
    print(
        f"actions of {amplitude}: {sum(sums.values()):+.3f} reward per second, {falls} falls; "
        f"reward and the sum of its terms differ by at most {largest:.0e}"
    )
    return sums


twitching, still = mean_terms(0.3), mean_terms(0.0)
order = sorted(twitching, key=twitching.get)
figure, axes = new_figure(1, 1, (8.0, 5.6))
axis = axes[0, 0]
for terms, shift, colour, label in ((twitching, -0.2, BLUE, "small random actions"), (still, 0.2, GREY, "no action")):
    values = np.array([terms[name] for name in order])
    bars = axis.barh(np.arange(len(order)) + shift, values, 0.4, color=colour, label=label)
    axis.bar_label(bars, labels=[f"{v:+.3f}" for v in values], padding=3, fontsize=7)
axis.set_yticks(range(len(order)), order)
axis.axvline(0, color="black", linewidth=0.8)
axis.set(xlabel="weighted term [reward per second], mean over 64 robots", title="level ground, two seconds")
axis.legend(loc="lower right", fontsize=9)
axis.margins(x=0.14)
show(figure, "02_reward_terms")

# %% [markdown]
# <details><summary>Answer</summary>
#
# Standing still earns more.  That is the surprise of this tutorial, and the trap that every reward of a walking robot
# sets: the first thing that learning discovers is that **moving costs**.  Accelerations, jerky actions and feet that
# lose contact are paid for at once, while the reward for getting somewhere comes only to a robot that can nearly walk.
# From standing still every small change of the policy makes things worse.  Two things pull it out.  One is the noise of
# exploration, which now and then moves a robot *forwards*, and `tracking_goal_vel` pays for each centimetre.  The other
# is a weight of the costs that is small enough for these centimetres to count.
#
# </details>

# %% [markdown]
# ## 2.5 Contact
#
# Episodes begin with the feet 2 cm above the ground.  Once the robot stands still,
# Newton's law leaves no choice:
#
# $$\sum_{\text{feet}} F_z = m g$$
#
# *What you should see:* zero while falling, then an overshoot, and a damped oscillation around 1:
# the knees are springs, see 2.2.  Below, all four feet are in contact (dark) soon after the
# landing.

# %%
env = Go1Env(World([flat]), num_envs=1, config=config)
env.reset(seed=0)
touch = env.simulation.columns(FOOT_TOUCH)  # per foot: contact found, then its force xyz [N]
weight = env.simulation.models[0].body_subtreemass[1] * 9.81
force, contact = [], []
for _ in range(round(3.0 / config.dt)):
    env.step(np.zeros((1, ACTION_DIM)))
    vertical = np.abs(env.simulation.sensors[0, touch].reshape(4, 4)[:, 3])  # a foot can only push: size says all
    force.append(vertical.sum() / weight)
    contact.append(env.foot_contact[0].copy())
t = (np.arange(len(force)) + 1) * config.dt

figure, axes = new_figure(2, 1, (8.0, 4.8))
axes[0, 0].plot(t, force, "o-", color=PURPLE, markersize=3)
axes[0, 0].axhline(1.0, color="black", linewidth=0.8, linestyle=":")
axes[0, 0].set(ylabel="sum of F_z / weight [-]", xlim=(0, t[-1]))
axes[0, 0].grid(alpha=0.3)
axes[1, 0].imshow(
    np.array(contact).T, aspect="auto", cmap="Greys", vmin=0, vmax=1.3, interpolation="nearest",
    extent=(config.dt / 2, t[-1] + config.dt / 2, 3.5, -0.5),
)  # fmt: skip
axes[1, 0].set_yticks(range(4), LEGS)
axes[1, 0].set(xlabel="time [s]", ylabel="foot", xlim=(0, t[-1]))
show(figure, "02_contact")
carried = np.mean(force[-round(1.0 / config.dt) :])
print(f"in the last second the feet carry {carried:.3f} of the weight of {weight:.1f} N")
print(f"trunk at {env.base_pos[0, 2]:.3f} m; with stiff knees it would stand at {STAND_HEIGHT} m")

# %% [markdown]
# **Predict, then run.**  We put 2 kg on the trunk.  Where does the ratio end now, and where does the trunk?

# %%
for payload in (0.0, 2.0):
    heavy = make_model(flat, payload=payload)
    d = mujoco.MjData(heavy)
    mujoco.mj_resetDataKeyframe(heavy, d, 0)
    mujoco.mj_step(heavy, d, round(4.0 / heavy.opt.timestep))
    carried = sum(abs(d.sensor(foot).data[3]) for foot in FOOT_TOUCH) / (heavy.body_subtreemass[1] * 9.81)
    print(f"payload {payload} kg: the feet carry {carried:.3f} of the weight, the trunk stands at {d.qpos[2]:.3f} m")

# %% [markdown]
# <details><summary>Answer</summary>
#
# The ratio still ends at 1: whatever stands still is carried, so force and weight grow together.  The trunk stands
# lower.  The motors are springs without an integral term, and a spring carries more only if it is bent further.  A
# policy sees this as joint angles that never arrive at their targets, and has to learn to aim higher with a load that
# nobody tells it about.
#
# </details>
#
# Next: `03_ppo.py` turns rewards into better actions.

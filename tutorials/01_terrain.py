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
# # 1. Terrain: one list of boxes, five maps
#
# Everything in this project happens on a **course**: a lane 18 m long and 4 m wide with eight waypoints and, on all
# kinds but `walk`, six obstacles.  A course is nothing but a list of blocks.  This tutorial reads five things off that
# list: the heights, the robot's terrain scan, the edges, the waypoints, and the map that tells the oracle which skill
# to use where (paper section 3.2.1, Figure 3).
#
# It takes about 5 seconds on two cores.  As a notebook it shows its figures below the cells; `python tutorials/01_terrain.py`
# writes them into the folder `figures/` of the directory you start it from.

# %%
from agility_ref.env import EnvConfig, Go1Env
from agility_ref.observation import SCANDOT_X, SCANDOT_Y, SCANDOTS, wrap
from agility_ref.pictures.plots import SKILL_COLOURS, new_figure, show
from agility_ref.terrain import (
    CELL,
    COURSE_KINDS,
    LANE_LENGTH,
    LANE_WIDTH,
    SKILLS,
    beam_width,
    gap_width,
    make_course,
    roughness,
    step_height,
)
from agility_ref.world import EDGE_DISTANCE, EDGE_MIN_DROP, World, edge_map, height_map, region_map, scan_map

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

EXTENT = (0.0, LANE_LENGTH, -LANE_WIDTH / 2, LANE_WIDTH / 2)  # [m] for pictures of the lane

# %% [markdown]
# ## 1.1 Boxes
#
# A box is an axis-aligned block.  We only care about its footprint and its top:
#
# $$\text{box}_k = [x_0, x_1] \times [y_0, y_1], \qquad \text{height } z_k \quad [\text{m}]$$
#
# The physics engine gets exactly these boxes as solid blocks.  A box with `walkable=False` is the floor of a pit:
# whoever stands there has fallen off.

# %%
course = make_course("climb-gap", difficulty=0.5, seed=1)
print(f"a {course.kind} course of difficulty {course.difficulty} has {len(course.boxes)} boxes:")
for box in course.boxes:
    note = "" if box.walkable else "   (a pit)"
    print(f"  x {box.x0:5.2f} .. {box.x1:5.2f} m   y {box.y0:+.1f} .. {box.y1:+.1f} m   top {box.top:+.3f} m{note}")

# %% [markdown]
# ## 1.2 The height map
#
# Where boxes overlap, a foot meets the highest one:
#
# $$h(x, y) = \max \{\, z_k : (x, y) \in \text{box}_k \,\}$$
#
# The map samples $h$ at the centres of 2 cm cells.  Box edges are rounded to that grid when a course is generated, so
# the map is exact and not an approximation.
#
# *What you should see:* seven lanes from the side.  `climb-up` is a staircase that only rises, `climb-down` mirrors it,
# `climb` is a pyramid, `gap` is a comb, `beam` is flat because the cut runs along its beams, and the bumps of `walk`
# are a few centimetres high (mind its axis).

# %%
x = (np.arange(round(LANE_LENGTH / CELL)) + 0.5) * CELL  # (900,) cell centres [m]
courses = {kind: make_course(kind, difficulty=0.7, seed=3) for kind in COURSE_KINDS}
heights = {kind: height_map(c) for kind, c in courses.items()}  # kind -> (900, 200) [m]

figure, axes = new_figure(len(COURSE_KINDS), 1, (9.0, 10.5))
for axis, (kind, h) in zip(axes[:, 0], heights.items(), strict=True):
    profile = h[:, h.shape[1] // 2]  # along y = 0
    axis.fill_between(x, profile, profile.min() - 0.3, step="mid", color="#cccccc")
    axis.step(x, profile, where="mid", color="#555555", linewidth=1)
    axis.set(ylabel="height [m]", xlim=(0, LANE_LENGTH), ylim=(profile.min() - 0.3, profile.max() + 0.15))
    axis.set_title(f"{kind}, d = {courses[kind].difficulty}", loc="left", fontsize=10)
axes[-1, 0].set_xlabel("x [m], cut along y = 0")
show(figure, "01_profiles")

# %% [markdown]
# ## 1.3 Waypoints
#
# Where to go is part of the course: eight points $g_0 \dots g_7$ in the plane.  The robot is told the angle by which it
# has to turn to face the next one.  With position $p$ and yaw $\psi$,
#
# $$\text{heading error} = \operatorname{wrap}\bigl(\operatorname{atan2}(g_y - p_y,\; g_x - p_x) - \psi\bigr)
# \in [-\pi, \pi) \quad [\text{rad}]$$
#
# *What you should see:* the same lanes from above; dark is low.  The white dots are the waypoints, joined in their
# order: they stand on solid ground, on the middle of every beam, and zig-zag.

# %%
figure, axes = new_figure(len(COURSE_KINDS), 1, (9.0, 12.5))
for axis, (kind, h) in zip(axes[:, 0], heights.items(), strict=True):
    # imshow wants rows = y, columns = x
    image = axis.imshow(h.T, origin="lower", extent=EXTENT, cmap="cividis", aspect="auto", interpolation="nearest")
    points = courses[kind].waypoints  # (8, 2)
    axis.plot(points[:, 0], points[:, 1], color="black", linewidth=0.8)
    axis.scatter(points[:, 0], points[:, 1], s=22, color="white", edgecolor="black", zorder=3)
    axis.set(ylabel="y [m]")
    axis.set_title(kind, loc="left", fontsize=10)
    figure.colorbar(image, ax=axis, label="height [m]", pad=0.01)
axes[-1, 0].set_xlabel("x [m]")
show(figure, "01_from_above")

# %% [markdown]
# **Predict, then run.**  The next cell puts a robot at three places, the third of them beyond its waypoint and looking
# back.  In one of the three cases `wrap` changes the angle.  In which, and which way would that robot turn without it?

# %%
goal = courses["walk"].waypoints[1]
print(f"the waypoint is at x = {goal[0]:.2f} m, y = {goal[1]:.2f} m")
for x_robot, yaw in ((1.0, 0.0), (1.0, 0.5), (5.0, 3.0)):  # [m], [rad]; all at y = 0
    raw = np.arctan2(goal[1] - 0.0, goal[0] - x_robot) - yaw
    print(f"robot at x = {x_robot} m, yaw {yaw:+.1f} rad: heading error {raw:+.2f}, wrapped {wrap(raw):+.2f} rad")

# %% [markdown]
# <details><summary>Answer</summary>
#
# The third.  The robot has run past the waypoint, and `atan2` jumps from $\pi$ to $-\pi$ as soon as the waypoint's y is
# below the robot's.  The raw difference is almost a full turn to the right, where a small turn to the left does the
# same.  Both describe the same direction; only the wrapped one is a sensible error to make small.
#
# </details>

# %% [markdown]
# ## 1.4 Difficulty
#
# One number $d$ sets every dimension, linearly:
#
# $$\text{step}(d) = 0.10 + 0.35\, d, \qquad \text{gap}(d) = 0.10 + 0.70\, d, \qquad
# \text{beam width}(d) = 0.60 - 0.48\, d \quad [\text{m}]$$
#
# Gaps and beams are rounded to the 2 cm grid (a beam to twice that, because it is symmetric).  The shaded part is the
# range of the preset `quick`; `full` goes to $d = 1$.  A Go1 stands 0.29 m tall at the hips, which tells you what a
# step of 0.45 m means.
#
# *What you should see:* three rising lines and a falling one, two of them with small stairs, and a dotted line at the
# height of the hips.

# %%
d = np.linspace(0, 1, 2001)
figure, axes = new_figure(1, 1, (7.0, 4.0))
axis = axes[0, 0]
axis.axvspan(0, 0.4, color="#eeeeee", label="range of preset quick")
axis.plot(d, [step_height(v) for v in d], color=SKILL_COLOURS["climb-up"], label="step height")
axis.plot(d, [gap_width(v) for v in d], color=SKILL_COLOURS["leap"], label="gap width")
axis.plot(d, [beam_width(v) for v in d], color=SKILL_COLOURS["beam"], label="beam width")
axis.plot(d, [roughness(v) for v in d], color=SKILL_COLOURS["walk"], label="roughness of walk")
axis.axhline(0.29, color="black", linewidth=0.8, linestyle=":", label="height of the Go1's hips")
axis.set(xlabel="difficulty d [-]", ylabel="length [m]", xlim=(0, 1), ylim=(0, 0.85))
axis.legend(fontsize=8)
axis.grid(alpha=0.3)
show(figure, "01_difficulty")

# %% [markdown]
# ## 1.5 Scandots: what the robot sees
#
# The paper gives its policies 132 *scandots*: ground heights on a grid, 12 x 11 in the code base it builds on, that
# moves and turns with the robot.  With trunk position $(p_x, p_y, z)$, yaw $\psi$ and grid offsets $(a, b)$,
#
# $$q = \begin{pmatrix} p_x \\ p_y \end{pmatrix} + R(\psi) \begin{pmatrix} a \\ b \end{pmatrix}, \qquad
# \text{dot} = \operatorname{clip}\bigl(z - 0.3 - \bar h(q),\; -1,\; 1\bigr) \quad [\text{m}]$$
#
# where $\bar h$ is the mean height of the 7 x 7 cells around the point.  So 0 means "ground at standing distance",
# positive means lower, negative means higher.


# %%
def scandots(position, yaw, h):
    """The 132 scandots of one robot; returns their xy (132, 2) and values (132,) [m]."""
    a, b = np.meshgrid(SCANDOT_X, SCANDOT_Y, indexing="ij")  # (12, 11) each, x-major
    px = position[0] + np.cos(yaw) * a - np.sin(yaw) * b
    py = position[1] + np.sin(yaw) * a + np.cos(yaw) * b
    i = np.clip((px / CELL).astype(int), 0, h.shape[0] - 1)
    j = np.clip(((py + LANE_WIDTH / 2) / CELL).astype(int), 0, h.shape[1] - 1)
    dots = np.clip(position[2] - 0.3 - h[i, j], -1.0, 1.0)
    return np.stack([px.ravel(), py.ravel()], axis=1), dots.ravel()


# %% [markdown]
# The environment computes the same thing for all robots at once.  To compare, we put three robots in front of the first
# gap, looking left, ahead and right, let the environment take one step, and read the dots out of the observation.
#
# *What you should see:* three fans of dots over the same gap, turned by the yaw; dots over the pit are red (lower),
# dots over level ground pale.

# %%
kind = "gap"
yaws = np.array([0.5, 0.0, -0.5])  # [rad]
env = Go1Env(World([courses[kind]]), num_envs=3, config=EnvConfig().clean())
env.reset(seed=0)
qpos = env.simulation.qpos  # (3, 19): xyz, quaternion wxyz, 12 joints; a live view
qpos[:, 0], qpos[:, 1] = 1.93, 0.0
qpos[:, 3:7] = np.stack([np.cos(yaws / 2), 0 * yaws, 0 * yaws, np.sin(yaws / 2)], axis=1)
observation, *_ = env.step(np.zeros((3, 12)))


def draw_dots(axis, points, dots, h, limits, most=1.0):
    """Draw scandots over the ground; return what a colour bar needs."""
    axis.imshow(h.T, origin="lower", extent=EXTENT, cmap="Greys_r", interpolation="nearest", alpha=0.5)
    axis.set(xlim=limits[0], ylim=limits[1], xlabel="x [m]", aspect="equal")
    return axis.scatter(
        *points.T, c=dots, cmap="coolwarm", vmin=-most, vmax=most, s=26, edgecolor="#444444", linewidth=0.3
    )


figure, axes = new_figure(1, 3, (11.0, 3.5))
difference = []
for k, axis in enumerate(axes[0]):
    points, dots = scandots(env.base_pos[k], env.yaw[k], scan_map(heights[kind]))
    difference.append(np.abs(dots - observation[k, SCANDOTS]).max())
    shown = draw_dots(axis, points, dots, heights[kind], ((1.0, 3.7), (-1.35, 1.35)))
    axis.plot(*env.base_pos[k, :2], marker="^", color="black", markersize=9)
    axis.set_title(f"yaw {env.yaw[k]:+.2f} rad", fontsize=10)
axes[0, 0].set_ylabel("y [m]")
figure.colorbar(shown, ax=axes[0].tolist(), label="scandot [m]: + lower, - higher")
show(figure, "01_scandots")
print(f"largest difference between our scandots and the environment's: {max(difference):.1e} m")
assert max(difference) < 1e-5

# %% [markdown]
# **Try.**  Replace `"gap"` by `"climb-up"` above.  Which colour does the tread take, and why is a step of 0.35 m harder
# to see than the pit of a gap?
#
# <details><summary>Answer</summary>
#
# Blue, for higher ground is negative.  At $d = 0.7$ the step is $0.10 + 0.35 \cdot 0.7 = 0.345$ m high while the pit is
# $0.05 + 0.95 \cdot 0.7 = 0.715$ m deep, so the pit's dots stand out twice as far from zero.
#
# </details>

# %% [markdown]
# ## 1.6 A surprise: a robot that does not see what it stands on
#
# Why the mean of 7 x 7 cells, and not simply the height at the dot?  The grid's columns are 0.15 m apart, and the
# narrowest beam is 0.12 m wide.
#
# **Predict, then run.**  A robot stands over the narrowest beam, 7 cm to the side of its middle.  How many of the 132
# dots touch the beam if every dot only knows its own point?

# %%
narrow = make_course("beam", difficulty=1.0, seed=3)
h = height_map(narrow)
first = narrow.obstacles[0]  # the span of the first beam
middle = narrow.waypoints[1, 1]  # y of its middle [m]
where = np.array([first.x0 + 0.3, middle - 0.07, 0.3])

figure, axes = new_figure(1, 2, (9.0, 4.6))
for axis, name, ground in zip(
    axes[0], ("each dot a point", "each dot a mean of 7 x 7 cells"), (h, scan_map(h)), strict=True
):
    points, dots = scandots(where, 0.0, ground)
    ahead = (points[:, 0] > first.x0 + 0.1) & (points[:, 0] < first.x1 - 0.1)  # dots over the beam's span
    sees = ahead & (dots < 0.2 - 1e-3)  # the ground beside the beam is 0.2 m lower
    shown = draw_dots(axis, points, dots, h, ((first.x0 - 0.4, first.x1 + 0.6), (-1, 1)), most=0.25)
    axis.plot(*where[:2], marker=">", color="black", markersize=9)
    axis.set_title(f"{name}: {sees.sum()} touch the beam", fontsize=10)
    print(f"{name}: {sees.sum()} of {ahead.sum()} dots over the beam's span touch the beam")
axes[0, 0].set_ylabel("y [m]")
figure.colorbar(shown, ax=axes[0].tolist(), label="scandot [m]: + lower, - higher")
show(figure, "01_unseen_beam")

# %% [markdown]
# <details><summary>Answer</summary>
#
# None.  The beam passes between two columns of dots, and to the robot the ground is simply 0.2 m lower on both sides of
# it.  No policy, however well trained, can walk along a beam that is not in its observation.  With means, the two
# columns beside the beam see a part of it, and **how large** a part says where between them the beam lies: a blurred
# picture holds more than a sharp one that is sampled too coarsely.  Signal processing calls this aliasing, and the blur
# an anti-aliasing filter.
#
# </details>

# %% [markdown]
# ## 1.7 Edges
#
# Table 1 counts *edge violations*: feet that stand within 5 cm of an edge.  An edge is a border between two
# neighbouring cells with
#
# $$| h - h' | > 0.075 \text{ m}$$
#
# The code base behind the paper looks for edges along x only; `edges="x"` does that, and the default looks along y too.
#
# *What you should see:* the shores of the islands are red in both pictures, the long sides of the beams only in the
# right one.  The red strip covers the low ground beside an edge too, but only a foot at the height of the upper side
# counts.

# %%
figure, axes = new_figure(1, 2, (10.0, 3.6))
for axis, along in zip(axes[0], ("x", "xy"), strict=True):
    marked = np.isfinite(edge_map(heights["beam"], along))
    axis.imshow(heights["beam"].T, origin="lower", extent=EXTENT, cmap="cividis", interpolation="nearest")
    overlay = np.where(marked.T, 1.0, np.nan)
    axis.imshow(overlay, origin="lower", extent=EXTENT, cmap="autumn", vmin=0.8, vmax=2, interpolation="nearest")
    axis.set(xlim=(2.0, 5.5), ylim=(-1, 1), xlabel="x [m]", title=f"edges={along!r}: {marked.mean():.1%} of the lane")
axes[0, 0].set_ylabel("y [m]")
show(figure, "01_edges")
print(f"an edge drops more than {EDGE_MIN_DROP} m; a foot violates it within {EDGE_DISTANCE} m")

# %% [markdown]
# **Predict, then run.**  At $d = 0$ a gap is 0.10 m wide and its pit 0.05 m deep.  How much of such a course is edge?

# %%
for difficulty in (0.0, 0.1):
    share = np.isfinite(edge_map(height_map(make_course("gap", difficulty)))).mean()
    print(f"gap, d = {difficulty}: {share:.1%} of the lane is within {EDGE_DISTANCE} m of an edge")

# %% [markdown]
# <details><summary>Answer</summary>
#
# Nothing.  The pit is shallower than the 0.075 m from which a drop counts, so the easiest course has gaps but no edges.
# Whoever compares edge violations between difficulties compares different definitions of an obstacle as well.
#
# </details>

# %% [markdown]
# ## 1.8 The oracle's regions
#
# Because we build the terrain, we know which skill belongs where.  Every obstacle claims the stretch from a lead before
# it to a tail after it,
#
# $$\text{region of an obstacle} = [\, x_0 - \text{LEAD}_\text{skill},\; x_1 + \text{TAIL}_\text{skill} \,] \quad [\text{m}]$$
#
# never starting before the previous obstacle's tail ends; everything else is walked.  The oracle policy of Table 1
# looks up its skill in this map, and the supervised selector learns to read it from the scandots.
#
# *What you should see:* colours begin before each obstacle and end a little after it; on `walk` everything is grey; on
# `climb-gap` all skills but the beam appear.

# %%
colours = ListedColormap([SKILL_COLOURS[skill] for skill in SKILLS])


def draw_regions(axis, course):
    """Draw the oracle's skill along x over the profile of the ground."""
    profile = height_map(course)[:, round(LANE_WIDTH / CELL) // 2]
    low, high = profile.min() - 0.3, profile.max() + 0.5
    axis.imshow(
        region_map(course)[None], extent=(0, LANE_LENGTH, low, high), cmap=colours, vmin=0, vmax=len(SKILLS) - 1,
        aspect="auto", interpolation="nearest", alpha=0.6,
    )  # fmt: skip
    axis.fill_between(x, profile, low, step="mid", color="#333333")
    axis.set(ylabel="height [m]", xlim=(0, LANE_LENGTH), ylim=(low, high))


figure, axes = new_figure(len(COURSE_KINDS), 1, (9.0, 10.5))
for axis, course in zip(axes[:, 0], courses.values(), strict=True):
    draw_regions(axis, course)
    axis.set_title(course.kind, loc="left", fontsize=10)
axes[-1, 0].set_xlabel("x [m], cut along y = 0")
handles = [Patch(color=SKILL_COLOURS[skill], alpha=0.6, label=skill) for skill in SKILLS]
figure.legend(handles=handles, loc="outside upper center", ncols=len(SKILLS))
show(figure, "01_oracle_regions")
share = {s: np.mean([(region_map(c) == k).mean() for c in courses.values()]) for k, s in enumerate(SKILLS)}
print("share of all seven lanes:", ", ".join(f"{s} {v:.0%}" for s, v in share.items()))

# %% [markdown]
# **Predict, then run.**  The next figure shows `climb-gap` at $d = 0$ and at $d = 1$.  Gaps get wider, but the ground
# between two obstacles is drawn from the same 0.8 to 1.5 m.  What becomes of the grey stretches between obstacles?

# %%
figure, axes = new_figure(2, 1, (9.0, 3.6))
for axis, difficulty in zip(axes[:, 0], (0.0, 1.0), strict=True):
    course = make_course("climb-gap", difficulty, seed=3)
    draw_regions(axis, course)
    between = (x > course.obstacles[0].x0) & (x < course.obstacles[-1].x1)
    walked = (region_map(course)[between] == SKILLS.index("walk")).mean()
    axis.set_title(
        f"climb-gap, d = {difficulty:.0f}: {walked:.0%} is walked between first and last obstacle",
        loc="left",
        fontsize=10,
    )
axes[-1, 0].set_xlabel("x [m], cut along y = 0")
show(figure, "01_leads")

# %% [markdown]
# <details><summary>Answer</summary>
#
# They hardly exist at either difficulty: the tail of one obstacle and the lead of the next are together about as long
# as the ground between them, and where they would overlap, the tail wins and the lead is cut short.  On these courses
# the oracle switches from one hard skill straight to another: each specialist has to take over a robot that another
# one leaves in mid-stride, which no course of its own training has prepared it for.
#
# </details>
#
# Next: `02_robot.py` puts a Go1 on these courses.

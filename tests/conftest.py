"""Small fixtures shared by the suite: random policies, and a folder of finished runs."""

import os
from contextlib import suppress

os.environ.setdefault("MPLBACKEND", "Agg")

from agility_ref.errors import UserError
from agility_ref.pictures.video import choose_gl

with suppress(UserError):  # tests that need OpenGL are skipped without
    choose_gl()  # before MuJoCo is imported

from agility_ref.env import ACTION_DIM
from agility_ref.files import write_npz
from agility_ref.observation import OBS_DIM
from agility_ref.pictures.record import Episode
from agility_ref.policy import Policy
from agility_ref.terrain import Course

import numpy as np
import pytest
from made import random_arrays

SKILLS = ("walk", "climb-up", "climb-down", "leap", "beam")


@pytest.fixture
def make_policy():
    """Return a function that makes a Policy with random weights."""

    def make(seed=0, name="random", obs_dim=OBS_DIM, act_dim=ACTION_DIM, gain=1.0):
        return Policy.from_arrays(random_arrays(seed, obs_dim, act_dim, gain), {"policy": name, "act_dim": act_dim})

    return make


@pytest.fixture
def finished_run():
    """Return a function that fakes a finished run: random weights and DONE."""

    def make(root, name, seed=0, gain=100.0, obs_dim=OBS_DIM, act_dim=ACTION_DIM, steps=1000, preset="full", **meta):
        folder = root / name / f"seed{seed}"
        meta = {"policy": name, "preset": preset, "act_dim": act_dim, "obs_dim": obs_dim, "steps": steps, **meta}
        write_npz(folder / "policy.npz", random_arrays(sum(map(ord, name)), obs_dim, act_dim, gain), meta)
        (folder / "DONE").write_text(f"{steps} steps\n")
        return folder

    return make


@pytest.fixture
def make_episode():
    """Return a function that makes a recorded episode by hand, from x [m], vx [m/s] and skills of every step."""

    def make(x, skill, wanted, vx=0.0, course=None, obstacles=(), reached=0, skills=SKILLS, name="p"):
        x, steps = np.asarray(x, float), len(x)
        qpos, qvel = np.zeros((steps, 19)), np.zeros((steps, 18))
        qpos[:, 0], qvel[:, 0] = x, vx
        course = course or Course("gap", 0.5, (), tuple(obstacles), np.zeros((8, 2)))
        feet, joints = np.zeros((steps, 4), bool), np.zeros((steps, 12))
        return Episode(
            policy=name, environment=course.kind, course=course, dt=0.02, command=0.8, fell=False, reached=reached,
            qpos=qpos, qvel=qvel, foot_pos=np.zeros((steps, 4, 3)), foot_contact=feet, foot_on_edge=feet,
            body_contact=np.zeros((steps, 9), bool), torque=joints, target=joints, waypoint_index=np.zeros(steps, int),
            heading_error=np.zeros(steps), reward_terms={}, skills=tuple(skills),
            skill=np.asarray(skill), wanted=np.asarray(wanted),
        )  # fmt: skip

    return make


@pytest.fixture
def five_skills(make_policy):
    """Five different random specialists, in the order of the oracle's labels."""
    return {name: make_policy(k, name, gain=100.0) for k, name in enumerate(SKILLS)}


@pytest.fixture
def failing_batch():
    """Return a stand-in for a batch, made from the real one: it reports robot 2 as failed after every step."""

    from mujoco import batch

    class Failing:
        def __init__(self, real):
            self.real = real

        def step(self, *args, **kwargs):
            self.real.step(*args, **kwargs)
            raise batch.SimulationError([2], "robot 2 failed")

        def __getattr__(self, name):
            return getattr(self.real, name)

    return Failing

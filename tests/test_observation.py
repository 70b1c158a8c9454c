"""The observation's layout and its mirror image."""

from dataclasses import replace

from agility_ref.env import EnvConfig, Go1Env
from agility_ref.go1 import DEFAULT_DOF_POS
from agility_ref.observation import (
    ACTION_MIRROR,
    OBS_DIM,
    OBS_MIRROR,
    SCANDOT_MIRROR,
    SCANDOT_X,
    SCANDOT_Y,
    SCANDOTS,
    Mirror,
    observation_slices,
    rotation,
    wrap,
)
from agility_ref.terrain import make_course
from agility_ref.world import World

import numpy as np
import pytest

SLICES = observation_slices()


SWAP = Mirror(np.array([1, 0, 2, 3]), np.array([-1, -1, -1, 1], np.float32))
MIRRORS = {
    "observation": OBS_MIRROR, "action": ACTION_MIRROR, "scandots": SCANDOT_MIRROR, "identity": Mirror.identity(5),
    "swap": SWAP,
}  # fmt: skip


@pytest.fixture(params=MIRRORS.values(), ids=MIRRORS.keys())
def mirror(request):
    return request.param


# --- mirrors -------------------------------------------------------------------------------


def test_a_mirror_image_by_hand():
    np.testing.assert_array_equal(SWAP(np.array([[1.0, 2.0, 3.0, 4.0]])), [[-2.0, -1.0, -3.0, 4.0]])


def test_mirroring_twice_is_nothing(mirror):
    x = np.random.default_rng(0).standard_normal((3, 4, len(mirror.index)))
    np.testing.assert_array_equal(mirror(mirror(x)), x)


def test_bases_are_orthonormal_and_span_everything(mirror):
    rows = np.concatenate(mirror.bases())
    np.testing.assert_allclose(rows @ rows.T, np.eye(len(mirror.index)), atol=1e-6)


def test_bases_hold_what_a_mirror_keeps_and_what_it_flips(mirror):
    even, odd = mirror.bases()
    # The rows of a matrix E M are the mirror images of the rows of E.
    np.testing.assert_array_equal(mirror(even), even)
    np.testing.assert_array_equal(mirror(odd), -odd)


@pytest.mark.parametrize("mirror, even, odd", [
    (OBS_MIRROR, 98, 86), (ACTION_MIRROR, 6, 6), (SCANDOT_MIRROR, 72, 60), (Mirror.identity(5), 5, 0), (SWAP, 2, 2),
])  # fmt: skip
def test_sizes_of_the_bases(mirror, even, odd):
    """Scandots in 12 rows of 11: 6 even and 5 odd combinations each; of the rest, each pair of joints or feet gives one
    of each, and of 12 numbers about the trunk the mirror flips 6: v_y, w_x, w_z, g_y and both heading errors."""
    assert [len(basis) for basis in mirror.bases()] == [even, odd]


def test_the_observations_mirror_is_made_of_the_others():
    x = np.random.default_rng(0).standard_normal((7, OBS_DIM))
    image = OBS_MIRROR(x)
    np.testing.assert_array_equal(image[:, SCANDOTS], SCANDOT_MIRROR(x[:, SCANDOTS]))
    for part in ("dof_pos", "dof_vel", "last_action"):
        np.testing.assert_array_equal(image[:, SLICES[part]], ACTION_MIRROR(x[:, SLICES[part]]))


def test_hips_change_sides_and_sign_thighs_and_calves_sides_alone():
    # legs FR FL RR RL, joints hip thigh calf
    action = np.arange(1.0, 13.0)
    np.testing.assert_array_equal(ACTION_MIRROR(action), [-4, 5, 6, -1, 2, 3, -10, 11, 12, -7, 8, 9])


def test_scandots_change_their_sides():
    dots = np.arange(len(SCANDOT_X) * len(SCANDOT_Y)).reshape(len(SCANDOT_X), len(SCANDOT_Y))
    np.testing.assert_array_equal(SCANDOT_MIRROR(dots.ravel()).reshape(dots.shape), dots[:, ::-1])
    np.testing.assert_allclose(SCANDOT_Y, -SCANDOT_Y[::-1], atol=1e-6)


def test_mirror_image_of_a_turned_robot():
    """A robot left of the middle that faces left, beside its mirror image: they observe each other's mirror image."""
    course = make_course("beam", 0.5, 3)
    flipped = replace(
        course,
        boxes=tuple(replace(b, y0=-b.y1, y1=-b.y0) for b in course.boxes),
        waypoints=course.waypoints * [1, -1],
    )
    config = replace(EnvConfig().clean(), action_repeat=1, scandot_period=1)
    env = Go1Env(World([course, flipped]), 2, config, lambda ids, fraction: ids)
    rng = np.random.default_rng(0)
    env.command[:] = 1.0
    env._qpos[:, 0], env._qpos[:, 1] = 2.1, (0.2, -0.2)  # before the first beam
    env._qpos[:, 3:7] = [[0.98, 0.05, 0.02, 0.19], [0.98, -0.05, 0.02, -0.19]]
    joints = DEFAULT_DOF_POS + rng.uniform(-0.1, 0.1, 12)
    env._qpos[:, 7:] = joints, ACTION_MIRROR(joints)
    action = rng.uniform(-0.3, 0.3, 12)
    observation, reward, *_ = env.step(np.stack([action, ACTION_MIRROR(action)]))
    one, other = observation
    assert np.ptp(one[SCANDOTS]) > 0.1
    # The real trunk's centre of mass lies 2 mm left of its middle: nearly, not exactly.
    tolerance = np.full(OBS_DIM, 5e-3)
    tolerance[SLICES["dof_vel"]] = 0.2
    assert (np.abs(OBS_MIRROR(one) - other) < tolerance).all()
    assert (np.abs(one - other) > 10 * tolerance).any()
    assert reward[0] == pytest.approx(reward[1], abs=1e-3)


# --- angles and rotations ------------------------------------------------------------------


def quaternions(n=50):
    quat = np.random.default_rng(0).standard_normal((n, 4))
    return quat / np.linalg.norm(quat, axis=1, keepdims=True)


def times(a, b):
    """Hamilton's product of two quaternions, wxyz."""
    scalar = a[0] * b[0] - a[1:] @ b[1:]
    return np.array([scalar, *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:]))])


def test_rotation_against_quaternions_one_vector_at_a_time():
    """v turns into q v q*, the slow way."""
    quats, vector = quaternions(), np.array([0.3, -1.2, 2.0])
    for matrix, quat in zip(rotation(quats), quats, strict=True):
        turned = times(times(quat, np.array([0.0, *vector])), quat * [1, -1, -1, -1])
        np.testing.assert_allclose(matrix @ vector, turned[1:], atol=1e-12)


def test_rotations_are_orthogonal():
    r = rotation(quaternions())
    np.testing.assert_allclose(r @ r.transpose(0, 2, 1), np.tile(np.eye(3), (50, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(r), 1.0)


def test_a_turn_to_the_left_by_hand():
    half = np.sqrt(0.5)  # 90 degrees about z: x turns to y, y to -x
    np.testing.assert_allclose(
        rotation(np.array([[half, 0, 0, half]]))[0], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12
    )


def test_wrap_keeps_the_angle_and_its_range():
    angle = np.linspace(-20.0, 20.0, 401)
    wrapped = wrap(angle)
    assert (np.abs(wrapped) <= np.pi).all()
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * angle), atol=1e-9)

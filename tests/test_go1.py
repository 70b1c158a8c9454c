from agility_ref.go1 import (
    BODY_TOUCH,
    DEFAULT_DOF_POS,
    DOF_RANGE,
    FOOT_RADIUS,
    FOOT_TOUCH,
    FOOT_VELOCITY,
    JOINTS,
    LEGS,
    STAND_HEIGHT,
    TORQUE_LIMITS,
    TOTAL_MASS,
    PhysicsConfig,
    make_model,
)
from agility_ref.terrain import CELL, COURSE_KINDS, GRID_SHAPE, LANE_WIDTH, make_course
from agility_ref.world import height_map

import mujoco
import numpy as np
import pytest

JOINT_ORDER = "FR_hip FR_thigh FR_calf FL_hip FL_thigh FL_calf RR_hip RR_thigh RR_calf RL_hip RL_thigh RL_calf".split()


@pytest.fixture(scope="module")
def model():
    return make_model(make_course("walk", 0.0, 0))


@pytest.fixture(scope="module")
def home(model):
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    return data


def test_total_mass(model):
    assert model.body_mass.sum() == pytest.approx(12.743448, abs=1e-9)
    assert pytest.approx(12.743448, abs=1e-9) == TOTAL_MASS


def test_sizes(model):
    assert (model.nq, model.nv, model.nu, model.nsensordata) == (19, 18, 12, 4 * 4 + 9 + 4 * 3)


def test_joint_order(model):
    names = [model.joint(j).name for j in range(1, model.njnt)]  # 0 is the free joint
    assert names == JOINT_ORDER == list(JOINTS)


def test_actuators_drive_the_joints_in_their_order(model):
    assert [model.actuator(a).name for a in range(model.nu)] == JOINT_ORDER
    assert [model.joint(j).name for j in model.actuator_trnid[:, 0]] == JOINT_ORDER


def test_joint_ranges(model):
    leg = [(-0.863, 0.863), (-0.686, 4.501), (-2.818, -0.888)]
    assert model.jnt_limited[1:].all()
    np.testing.assert_allclose(model.jnt_range[1:], leg * 4)
    np.testing.assert_allclose(DOF_RANGE, leg * 4)


def test_torque_limits(model):
    limits = np.array([23.7, 23.7, 35.55] * 4)
    assert model.actuator_forcelimited.all()
    np.testing.assert_allclose(model.actuator_forcerange, np.column_stack([-limits, limits]))
    np.testing.assert_allclose(TORQUE_LIMITS, limits)


def test_armature_is_rotor_inertia_times_gear_squared(model):
    # 1.11842e-4 * 6^2 = 4.026312e-3,  1.11842e-4 * 9^2 = 9.059202e-3
    np.testing.assert_allclose(model.dof_armature[6:], [4.026312e-3, 4.026312e-3, 9.059202e-3] * 4, rtol=1e-6)
    np.testing.assert_array_equal(model.dof_armature[:6], 0.0)


def test_actuators_are_pd_controllers():
    # force = kp (ctrl - q) - kd qd
    model = make_model(make_course("walk", 0.0, 0), PhysicsConfig(kp=31.0, kd=0.7))
    np.testing.assert_allclose(model.actuator_gainprm[:, 0], 31.0)
    np.testing.assert_allclose(model.actuator_biasprm[:, :3], [[0.0, -31.0, -0.7]] * 12)


def test_default_physics_is_50_hz(model):
    physics = PhysicsConfig()
    assert physics.timestep * physics.substeps == pytest.approx(0.02)
    assert model.opt.timestep == physics.timestep


def test_home_keyframe(model):
    np.testing.assert_allclose(model.key_qpos[0, 7:], [0.0, 0.9, -1.8] * 4)
    np.testing.assert_allclose(model.key_ctrl[0], DEFAULT_DOF_POS)
    assert model.key_qpos[0, 2] == pytest.approx(0.2878)


def test_feet_just_touch_in_the_home_pose(model, home):
    feet = np.array([home.site(f"{leg}_foot").xpos for leg in LEGS])
    # trunk 0.2878 m above ground that the foot spheres touch
    np.testing.assert_allclose(home.qpos[2] - feet[:, 2] + FOOT_RADIUS, 0.2878, atol=1e-4)
    assert STAND_HEIGHT == 0.2878


def test_feet_stand_where_the_legs_say(home):
    feet = np.array([home.site(f"{leg}_foot").xpos for leg in LEGS]) - home.qpos[:3]
    # x: hip at 0.1881; y: 0.04675 + 0.08 = 0.12675; FR, FL, RR, RL
    np.testing.assert_allclose(
        feet[:, :2], [(0.1881, -0.12675), (0.1881, 0.12675), (-0.1881, -0.12675), (-0.1881, 0.12675)], atol=1e-3
    )


def test_only_terrain_touches_the_robot(model):
    robot = model.geom_bodyid > 0
    # two geoms touch if (contype of one) & (conaffinity of the other)
    assert (model.geom_contype[robot] == 0).all()
    assert (model.geom_contype[~robot][:, None] & model.geom_conaffinity[robot]).all()


def test_a_standing_robot_is_carried_by_its_feet(model):
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for _ in range(300):
        mujoco.mj_step(model, data)
    feet = np.array([data.sensor(name).data for name in FOOT_TOUCH])
    assert (feet[:, 0] > 0).all()
    # the sensor gives the force of the feet on the ground: downwards
    assert feet[:, 3].sum() == pytest.approx(-12.743448 * 9.81, rel=0.02)
    assert all(data.sensor(name).data == 0 for name in BODY_TOUCH)  # trunk, thighs, calves are off the ground
    for name in FOOT_VELOCITY:
        np.testing.assert_allclose(data.sensor(name).data, 0.0, atol=0.01)  # the feet rest


def test_a_lying_trunk_is_felt(model):
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[2] = 0.05
    mujoco.mj_forward(model, data)
    assert data.sensor("trunk_touch").data[0] > 0


def test_payload_is_added_to_the_trunk():
    loaded = make_model(make_course("walk", 0.0, 0), payload=1.5)
    assert loaded.body("trunk").mass[0] == pytest.approx(5.204 + 1.5)
    assert loaded.body_mass.sum() == pytest.approx(12.743448 + 1.5)


def test_friction_is_the_grounds():
    model = make_model(make_course("walk", 0.0, 0), friction=0.7)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[2] -= 0.005
    mujoco.mj_forward(model, data)
    assert data.ncon == 4
    np.testing.assert_allclose(data.contact.friction[:, 0], 0.7)


def test_models_padded_alike_have_equal_sizes():
    courses = [make_course(kind, 0.5, 0) for kind in COURSE_KINDS]
    most = max(len(c.boxes) for c in courses)
    sizes = {(m.nq, m.nv, m.nu, m.nbody, m.ngeom, m.nsite, m.nsensordata)
             for m in (make_model(c, num_boxes=most) for c in courses)}  # fmt: skip
    assert len(sizes) == 1


@pytest.mark.parametrize("kind", COURSE_KINDS)
def test_physics_stands_where_the_height_map_says(kind):
    course = make_course(kind, 0.8, 2)
    model = make_model(course)
    data = mujoco.MjData(model)
    data.qpos[:3] = 0.0, 0.0, 100.0  # out of the rays' way
    mujoco.mj_forward(model, data)
    heights = height_map(course)
    rng = np.random.default_rng(0)
    geom = np.zeros(1, np.int32)
    for i, j in zip(rng.integers(0, GRID_SHAPE[0], 300), rng.integers(0, GRID_SHAPE[1], 300), strict=True):
        x, y = (i + 0.5) * CELL, (j + 0.5) * CELL - LANE_WIDTH / 2
        distance = mujoco.mj_ray(model, data, np.array([x, y, 10.0]), np.array([0.0, 0.0, -1.0]), None, 1, -1, geom)
        assert 10.0 - distance == pytest.approx(heights[i, j], abs=1e-6)

from dataclasses import asdict, fields, replace

from agility_ref.go1 import DEFAULT_DOF_POS
from agility_ref.rewards import TERMS, RewardConfig, StepState, compute_reward

import numpy as np
import pytest

DT = 0.02


def state(n=1, **changes):
    """N robots standing still in the home pose, level, facing the waypoint."""
    return StepState(**{
        "dt": DT,
        "base_lin_vel": np.zeros((n, 3)),
        "base_ang_vel": np.zeros((n, 3)),
        "projected_gravity": np.tile([0.0, 0.0, -1.0], (n, 1)),
        "goal_velocity": np.zeros(n),
        "speed": np.zeros(n),
        "heading_error": np.zeros(n),
        "command": np.ones(n),
        "on_level_course": np.ones(n, bool),
        "dof_pos": np.tile(DEFAULT_DOF_POS, (n, 1)),
        "dof_vel": np.zeros((n, 12)),
        "last_dof_vel": np.zeros((n, 12)),
        "torque": np.zeros((n, 12)),
        "action": np.zeros((n, 12)),
        "last_action": np.zeros((n, 12)),
        "foot_force": np.zeros((n, 4, 3)),
        "foot_contact": np.ones((n, 4), bool),
        "foot_on_edge": np.zeros((n, 4), bool),
        "foot_speed": np.zeros((n, 4)),
        "foot_clearance": np.zeros((n, 4)),
        "body_contact": np.zeros((n, 9), bool),
    } | changes)  # fmt: skip


def twelve(**entries):
    """(1, 12) zeros with entries {"j3": 0.5} filled in."""
    row = np.zeros((1, 12))
    for name, value in entries.items():
        row[0, int(name[1:])] = value
    return row


def test_every_weight_has_a_term():
    assert [f.name for f in fields(RewardConfig)] == list(TERMS)


@pytest.mark.parametrize("name, changes, expected", [
    # slower than asked: 0.4 / 0.8; backwards: -0.4 / 0.8
    ("tracking_goal_vel", {"goal_velocity": np.array([0.4]), "speed": np.array([0.4]), "command": np.array([0.8])}, 0.5),
    ("tracking_goal_vel", {"goal_velocity": np.array([-0.4]), "speed": np.array([0.4]), "command": np.array([0.8])}, -0.5),
    # 2 m/s straight ahead is worth 0.8 m/s; at 60 degrees off, half of that
    ("tracking_goal_vel", {"goal_velocity": np.array([2.0]), "speed": np.array([2.0]), "command": np.array([0.8])}, 1.0),
    ("tracking_goal_vel", {"goal_velocity": np.array([1.0]), "speed": np.array([2.0]), "command": np.array([0.8])}, 0.5),
    # exp(-|ln 2|) = 1/2, to either side
    ("tracking_yaw", {"heading_error": np.array([np.log(2.0)])}, 0.5),
    ("tracking_yaw", {"heading_error": np.array([-np.log(2.0)])}, 0.5),
    # 0.3^2 = 0.09 on level ground, half of it elsewhere
    ("lin_vel_z", {"base_lin_vel": np.array([[5.0, 5.0, -0.3]])}, 0.09),
    ("lin_vel_z", {"base_lin_vel": np.array([[5.0, 5.0, -0.3]]), "on_level_course": np.array([False])}, 0.045),
    # 1^2 + 2^2 = 5, yaw rate free
    ("ang_vel_xy", {"base_ang_vel": np.array([[1.0, -2.0, 7.0]])}, 5.0),
    # 0.6^2 + 0.0^2 = 0.36 on level ground only
    ("orientation", {"projected_gravity": np.array([[0.6, 0.0, -0.8]])}, 0.36),
    ("orientation", {"projected_gravity": np.array([[0.6, 0.0, -0.8]]), "on_level_course": np.array([False])}, 0.0),
    # ((0.5 - 0.1) / 0.02)^2 = 400
    ("dof_acc", {"dof_vel": twelve(j3=0.5), "last_dof_vel": twelve(j3=0.1)}, 400.0),
    # 3^2 + 4^2
    ("torques", {"torque": twelve(j0=3.0, j11=-4.0)}, 25.0),
    # |(3, 4)| = 5, the norm
    ("action_rate", {"action": twelve(j1=3.0), "last_action": twelve(j2=4.0)}, 5.0),
    # hips are joints 0, 3, 6, 9: 0.1^2 + 0.2^2; the thigh at j1 does not count
    ("hip_pos", {"dof_pos": DEFAULT_DOF_POS + twelve(j0=0.1, j9=-0.2, j1=5.0)}, 0.05),
    # ... but does here: 0.1^2 + 0.3^2
    ("dof_error", {"dof_pos": DEFAULT_DOF_POS + twelve(j0=0.1, j1=0.3)}, 0.10),
    ("collision", {"body_contact": np.array([[True, False, True] + [False] * 6])}, 2.0),
    ("feet_edge", {"foot_on_edge": np.array([[True, True, False, True]])}, 3.0),
    # 0.5 m/s x 5 cm + 1 m/s x (5 - 3) cm; above 5 cm nothing, below the ground (beside an edge) no more than 5 cm
    ("feet_drag", {
        "foot_speed": np.array([[0.5, 1.0, 3.0, 0.0]]), "foot_clearance": np.array([[-0.5, 0.03, 0.06, 0.0]]),
    }, 0.045),
    # FR and RL stand, FL and RR swing: a trot; with RR down too one pair is out of step
    ("gait_sync", {"foot_contact": np.array([[True, False, False, True]])}, 0.0),
    ("gait_sync", {"foot_contact": np.array([[True, False, True, True]])}, 1.0),
    ("gait_sync", {"foot_contact": np.array([[True, False, True, True]]), "on_level_course": np.array([False])}, 0.0),
    # in flight neither pair keeps step
    ("gait_sync", {"foot_contact": np.zeros((1, 4), bool)}, 2.0),
    # off the level course: 1 - 0.06 / (0.3 * 0.8) = 0.75; going back counts as standing, 0.24 m/s as going
    ("standing", {"goal_velocity": np.array([0.06]), "command": np.array([0.8]), "on_level_course": np.array([False])}, 0.75),
    ("standing", {"goal_velocity": np.array([-1.0]), "on_level_course": np.array([False])}, 1.0),
    ("standing", {"goal_velocity": np.array([0.3]), "on_level_course": np.array([False])}, 0.0),
    ("alive", {}, 1.0),
])  # fmt: skip
def test_term_by_hand(name, changes, expected):
    np.testing.assert_allclose(TERMS[name](state(**changes)), [expected], rtol=1e-12)


def test_feet_stumble_beyond_four_times_the_load():
    force = np.zeros((3, 4, 3))
    force[0, 2] = (3.9, 0.0, 1.0)  # sideways 3.9 times the load: still standing
    force[1, 2] = (0.0, -4.1, 1.0)  # 4.1 times: kicked a face
    np.testing.assert_array_equal(TERMS["feet_stumble"](state(3, foot_force=force)), [0.0, 1.0, 0.0])


def test_standing_still_costs_nothing():
    costs = [name for name, weight in asdict(RewardConfig()).items() if weight < 0]
    assert costs
    for name in costs:
        assert TERMS[name](state(2)).tolist() == [0.0, 0.0], name


def test_standing_before_an_obstacle_earns_nothing():
    # 0.5 exp(-0) for facing the waypoint, -0.5 for not getting there
    reward, _ = compute_reward(state(on_level_course=np.array([False])), RewardConfig())
    assert reward.tolist() == [0.0]


@pytest.mark.parametrize("name", TERMS)
def test_terms_treat_robots_one_by_one(name):
    rng = np.random.default_rng(0)

    def random_like(value):
        if not isinstance(value, np.ndarray):
            return value
        return rng.random(value.shape) < 0.5 if value.dtype == bool else rng.uniform(0.5, 2.0, value.shape)

    both = StepState(**{f.name: random_like(getattr(state(5), f.name)) for f in fields(StepState)})
    alone = [
        StepState(**{f.name: v[k : k + 1] if isinstance(v := getattr(both, f.name), np.ndarray) else v
                     for f in fields(StepState)})
        for k in range(5)
    ]  # fmt: skip
    assert TERMS[name](both).shape == (5,)
    np.testing.assert_allclose(TERMS[name](both), np.concatenate([TERMS[name](s) for s in alone]), rtol=1e-12)


def test_reward_is_dt_times_the_weighted_sum():
    nothing = RewardConfig(**dict.fromkeys(TERMS, 0.0))
    weights = replace(nothing, tracking_yaw=2.0, torques=-0.1)
    # 0.02 * (2 * exp(-0) - 0.1 * 5^2) = 0.02 * (2 - 2.5) = -0.01
    reward, terms = compute_reward(state(torque=twelve(j5=5.0)), weights)
    np.testing.assert_allclose(reward, [-0.01], rtol=1e-12)
    np.testing.assert_allclose(terms["tracking_yaw"], [0.04], rtol=1e-12)
    np.testing.assert_allclose(terms["torques"], [-0.05], rtol=1e-12)
    assert terms["collision"].tolist() == [0.0]


def test_weights_have_the_sign_of_their_meaning():
    earns = {name for name, weight in vars(RewardConfig()).items() if weight > 0}
    assert earns == {"tracking_goal_vel", "tracking_yaw", "alive"}

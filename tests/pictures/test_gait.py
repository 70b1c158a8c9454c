from agility_ref.curriculum import PRESETS
from agility_ref.evaluate import EvaluationConfig
from agility_ref.go1 import FOOT_RADIUS
from agility_ref.pictures.gait import contact_share, diagonal_correlation, foot_clearance, measure, swing_peaks
from agility_ref.pictures.record import record
from agility_ref.terrain import make_course
from agility_ref.training import weights
from agility_ref.training.bank import load_policy
from agility_ref.training.runs import TrainConfig

import numpy as np
import pytest

# The presets whose walk is held to the bounds below; the budget of quick is too short for a gait.
HELD = ("full",)
MIN_CLEARANCE = 0.03  # [m] half of the height range of the roughest ground
CONTACT = (0.35, 0.75)  # a trot is near 0.5; below, a foot is carried, above, it is dragged
MIN_DIAGONAL = 0.7  # a trot; walks that learned at a discount of 0.99 per 40 ms had 0.4 to 0.8
MAX_BODY = 0.05  # share of steps: a knee may touch down after a push, none may be walked on


# --- hand-made arrays ---------------------------------------------------------------------


def feet(*columns):
    """One robot whose four feet have these columns; strings of 1 (stands) and 0 (in the air)."""
    return np.array([[c == "1" for c in column] for column in columns]).T[:, None]


def test_contact_share_counts_counted_steps_only():
    contact = feet("1111", "0000", "1100", "0110")
    everything = np.ones((4, 1), bool)
    assert contact_share(contact, everything).tolist() == [1.0, 0.0, 0.5, 0.5]
    assert contact_share(contact, np.array([[0], [1], [1], [0]], bool)).tolist() == [1.0, 0.0, 0.5, 1.0]


def test_contact_share_weighs_every_counted_step_of_every_robot_alike():
    contact = np.concatenate([feet("11", "11", "11", "11"), feet("00", "00", "00", "00")], axis=1)
    counted = np.array([[1, 1], [1, 0]], bool)  # the second robot fell after one step
    assert contact_share(contact, counted) == pytest.approx(2 / 3)


def test_diagonal_feet_agree_in_a_trot_and_not_in_a_pace_or_a_bound():
    a, b = "11001100", "00110011"
    for gait, expected in ((feet(a, b, b, a), 1.0), (feet(a, b, a, b), -1.0), (feet(a, a, b, b), -1.0)):
        assert diagonal_correlation(gait, np.ones((8, 1), bool)) == pytest.approx(expected)
    # FR 1100, RL 1000: covariance 1/4 - 1/2 x 1/4 = 1/8, deviations 1/2 and sqrt(3)/4, correlation 1 / sqrt 3;
    # FL and RR agree.
    half = feet("1100", "0110", "0110", "1000")
    assert diagonal_correlation(half, np.ones((4, 1), bool)) == pytest.approx((1 / np.sqrt(3) + 1) / 2)
    assert np.isnan(diagonal_correlation(feet("1111", "0110", "0110", "1111"), np.ones((4, 1), bool)))


def test_a_swing_lies_between_two_contacts_and_has_one_peak():
    contact = feet("0100110", "1111111", "0000000", "1010101")
    clearance = np.zeros((7, 1, 4))
    clearance[:, 0, 0] = [9, 0, 0.02, 0.05, 0, 0, 9]  # the first and the last lift-off have no other end
    clearance[:, 0, 3] = [0, 0.01, 0, 0.02, 0, 0.03, 0]
    peaks = swing_peaks(contact, clearance, np.ones((7, 1), bool))
    assert [p.tolist() for p in peaks] == [[0.05], [], [], [0.01, 0.02, 0.03]]


def test_a_swing_that_is_not_counted_throughout_does_not_count():
    contact = np.tile(feet("1001001", "1111111", "1111111", "1111111"), (1, 2, 1))
    clearance = np.zeros((7, 2, 4))
    clearance[1:3, :, 0], clearance[4:6, :, 0] = 0.04, 0.06
    counted = np.ones((7, 2), bool)
    counted[:2, 0] = False  # the first robot had not settled
    counted[6:, 1] = False  # the second one's episode had ended
    assert [sorted(p) for p in swing_peaks(contact, clearance, counted)] == [[0.04, 0.06], [], [], []]


def test_clearance_is_over_the_ground_under_the_foot():
    course = make_course("climb-up", 1.0, 0)  # the first step rises 0.45 m at x = 2.5
    feet_at = np.array([[2.4, 0.0, 0.10 + FOOT_RADIUS], [2.6, 0.0, 0.55 + FOOT_RADIUS]])
    assert foot_clearance(feet_at, course) == pytest.approx([0.10, 0.10])


# --- recorded episodes --------------------------------------------------------------------


def test_a_robot_that_stands_has_no_swings(make_policy):
    from agility_ref.selector import Single

    still = Single("still", make_policy(gain=0.0))
    (episode,) = record(still, "walk", EvaluationConfig(difficulty=0.0, clean=True))
    gait = measure([episode])
    assert gait.contact_share.tolist() == [1.0] * 4 and gait.swings_per_second.tolist() == [0.0] * 4
    assert np.isnan(gait.swing_clearance).all()
    assert gait.body_share == 0.0 and 0.0 < gait.torque_share < 1.0


def test_episodes_shorter_than_the_settling_have_no_gait(make_policy):
    from agility_ref.selector import Single

    wild = Single("wild", make_policy(gain=1000.0))
    episodes = record(wild, "walk", EvaluationConfig(difficulty=0.0), robots=2)
    with pytest.raises(ValueError, match="no episode lasts"):
        measure(episodes, settle=30.0)
    assert measure(episodes, settle=0.0).torque_share <= 1.0


# --- the shipped walk ---------------------------------------------------------------------

SHIPPED = [
    (preset, seed)
    for preset in PRESETS
    for seed in range(10)
    if preset in HELD and (weights.FOLDER / weights.file_name(preset, "walk", seed)).exists()
]


@pytest.fixture(scope="module", params=SHIPPED, ids=lambda p: f"{p[0]}-seed{p[1]}")
def walk(request, tmp_path_factory):
    """Gait of the shipped walk on level ground, noise and pushes on."""
    preset, seed = request.param
    own = tmp_path_factory.mktemp("no-runs")
    policy = load_policy("walk", TrainConfig(preset=preset, seed=seed, out=str(own)))
    return measure(record(policy, "walk", EvaluationConfig(difficulty=0.0), courses=tuple(range(16))))


def test_every_foot_is_lifted(walk):
    assert (walk.swing_clearance >= MIN_CLEARANCE).all(), walk


def test_no_foot_is_dragged_or_carried(walk):
    assert (walk.contact_share >= CONTACT[0]).all() and (walk.contact_share <= CONTACT[1]).all(), walk


def test_the_gait_is_a_trot(walk):
    assert walk.diagonal_correlation >= MIN_DIAGONAL, walk


def test_torques_stay_within_the_motors_limits(walk):
    assert walk.torque_share <= 1.0 + 1e-9, walk


def test_the_robot_walks_on_its_feet(walk):
    assert walk.body_share <= MAX_BODY, walk

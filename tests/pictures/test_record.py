from agility_ref.env import EnvConfig, Go1Env
from agility_ref.errors import UserError
from agility_ref.evaluate import EvaluationConfig, evaluate, evaluation_env
from agility_ref.pictures.record import play, record, side_by_side
from agility_ref.selector import Hierarchy, Single, oracle_hierarchy
from agility_ref.terrain import SKILLS, make_course
from agility_ref.world import World

import numpy as np
import pytest

CONFIG = EvaluationConfig(difficulty=0.3, seed=4)


@pytest.fixture(scope="module")
def random_policy():
    from agility_ref.policy import Policy

    from made import random_arrays

    return Single("random", Policy.from_arrays(random_arrays(0, gain=100.0), {"policy": "random", "act_dim": 12}))


@pytest.fixture(scope="module")
def episodes(random_policy):
    return record(random_policy, "climb", CONFIG, courses=(0, 1), robots=2)


def test_one_episode_a_robot_side_by_side_on_their_course(episodes):
    assert len(episodes) == 4
    assert episodes[0].course is episodes[1].course and episodes[0].course is not episodes[2].course
    assert not np.array_equal(episodes[0].qpos[0], episodes[1].qpos[0])  # other starts


def test_shapes(episodes):
    for e in episodes:
        T = len(e)
        assert T > 1 and e.time[-1] == pytest.approx((T - 1) * 0.04)
        assert e.qpos.shape == (T, 19) and e.foot_pos.shape == (T, 4, 3)
        assert e.foot_contact.shape == e.foot_on_edge.shape == (T, 4)
        assert e.torque.shape == e.target.shape == (T, 12)
        assert all(term.shape == (T,) for term in e.reward_terms.values())
        assert e.skill is None and e.wanted is None and e.skill_name(0) == "random"


def test_recording_is_what_the_environment_did(random_policy):
    """Step the same environment by hand and compare state and reward, to the last bit."""
    world = World([make_course("gap", 0.5, 1)])
    (episode,) = play(random_policy, Go1Env(world, 1, seed=9), "gap", 9)
    env = Go1Env(world, 1, seed=9)
    observation, _ = env.reset(9)
    for t in range(len(episode)):
        assert np.array_equal(env.base_pos[0], episode.qpos[t, :3])
        assert env.waypoint_index[0] == episode.waypoint_index[t]
        assert np.array_equal(env.foot_contact[0], episode.foot_contact[t])
        observation, reward, terminated, truncated, info = env.step(random_policy.act(observation, env)[0])
        assert reward[0] == pytest.approx(episode.reward[t], abs=1e-12)
    assert (terminated | truncated)[0]
    assert bool(terminated[0]) == episode.fell
    assert info["totals"]["waypoints"][0] == episode.reached


def test_no_row_of_the_next_episode_slips_in(episodes):
    for e in episodes:
        jumps = np.abs(np.diff(e.qpos[:, 0]))
        assert jumps.max() < 0.2  # a reset would throw the robot back to the start
        assert (np.diff(e.waypoint_index) >= 0).all()


def test_target_respects_the_action_limit(episodes):
    home = np.array([0.0, 0.9, -1.8] * 4)
    for e in episodes:
        assert np.abs(e.target - home).max() <= 4.0 * 0.3 + 1e-12


def test_hierarchy_records_chosen_and_wanted(five_skills):
    oracle = oracle_hierarchy("oracle", five_skills)
    (episode,) = record(oracle, "climb-up", CONFIG)
    assert episode.skills == tuple(five_skills)
    assert np.array_equal(episode.skill, episode.wanted)  # the oracle agrees with itself
    assert episode.skill_name(0) == "walk"  # the start platform is walked
    liar = oracle_hierarchy("liar", five_skills)
    liar.choose = lambda observation, env: np.full(env.num_envs, 4)
    (episode,) = record(liar, "climb-up", CONFIG)
    assert (episode.skill == 4).all() and episode.wanted[0] == 0 and episode.skill_name(0) == "beam"


def test_same_seed_same_recording(random_policy):
    a, b = (record(random_policy, "gap", CONFIG)[0] for _ in range(2))
    assert np.array_equal(a.qpos, b.qpos) and a.summary() == b.summary()


@pytest.mark.parametrize("environment, courses", [("gaps", (0,)), ("gap", (-1,))])
def test_bad_input_is_a_user_error(random_policy, environment, courses):
    with pytest.raises(UserError):
        record(random_policy, environment, CONFIG, courses)


SHORT = EnvConfig(episode_seconds=1.2)  # 30 steps, each of two control steps
FEW = EvaluationConfig(episodes=3, seed=1)


def episodes_of(hierarchy, environment="climb-gap"):
    return play(hierarchy, evaluation_env(environment, FEW, SHORT), environment, FEW.seed)


@pytest.mark.parametrize("environment", ["climb-gap", "beam"])
def test_a_recording_is_the_evaluation_step_by_step(five_skills, environment):
    hierarchy = Hierarchy("leaper", tuple(five_skills.values()), lambda o, env: np.full(len(o), 3), np.arange(5))
    played, evaluation = episodes_of(hierarchy, environment), evaluate(hierarchy, environment, FEW, SHORT)
    np.testing.assert_array_equal([e.reached / 8 for e in played], evaluation.waypoint_fraction)
    np.testing.assert_array_equal([2 * len(e) for e in played], evaluation.episode_length)
    steps = max(map(len, played))
    np.testing.assert_array_equal(side_by_side(played, "skill", -1), evaluation.skill[:steps])
    np.testing.assert_array_equal(side_by_side(played, "wanted", -1), evaluation.oracle[:steps])
    assert [e.course for e in played] == evaluation_env(environment, FEW).world.courses


def test_shapes_and_ends(five_skills):
    class Jump(Hierarchy):
        """Leaves the lane in the third step, on the first course only; elsewhere it stands."""

        def act(self, observation, env):
            self.step = getattr(self, "step", 0) + 1
            if self.step == 3:
                env._qpos[0, 1] = 5.0
            action, skill = super().act(observation, env)
            return 0 * action, skill

    played = episodes_of(Jump("jump", tuple(five_skills.values()), lambda o, env: np.full(len(o), 1), np.arange(5)))
    assert [len(e) for e in played] == [3, 30, 30]
    np.testing.assert_array_equal(side_by_side(played, "skill", -1)[:, 0], [1] * 3 + [-1] * 27)
    assert side_by_side(played, "qvel").shape == (30, 3, 18) and not side_by_side(played, "qvel")[3:, 0].any()
    assert played[0].skills == tuple(SKILLS) and played[0].dt == 0.04


def test_velocity_moves_the_position(five_skills):
    for e in episodes_of(oracle_hierarchy("oracle", five_skills)):
        moved = np.diff(e.qpos[:10, :3], axis=0) / e.dt
        between = (e.qvel[:9, :3] + e.qvel[1:10, :3]) / 2
        np.testing.assert_allclose(moved[..., :2], between[..., :2], atol=0.4)  # contacts act between two steps
        assert np.corrcoef(moved[..., 0].ravel(), between[..., 0].ravel())[0, 1] > 0.8


def test_the_oracle_is_never_wrong(five_skills):
    assert not any(e.wrong.any() for e in episodes_of(oracle_hierarchy("oracle", five_skills)))


@pytest.mark.parametrize("kind, leaps, climbs", [("gap", 6, 0), ("climb-gap", 2, 2), ("walk", 0, 0)])
def test_spans_name_the_obstacles_of_the_course(make_episode, kind, leaps, climbs):
    episode = make_episode([0.0], [0], [0], course=make_course(kind, 0.5, 0))
    assert episode.spans("leap").shape == (leaps, 2) and episode.spans("climb-up").shape == (climbs, 2)
    wanted = [(o.x0, o.x1) for o in episode.course.obstacles if o.skill == "leap"]
    np.testing.assert_array_equal(episode.spans("leap"), np.reshape(wanted, (-1, 2)))

import json
from dataclasses import replace

from agility_ref import evaluate as evaluation_module
from agility_ref.env import EnvConfig, Go1Env
from agility_ref.errors import UserError
from agility_ref.evaluate import (
    METRICS,
    EvaluationConfig,
    edge_violation,
    episode_length,
    evaluate,
    evaluation_courses,
    evaluation_env,
    evaluation_world,
    reward_metric,
    waypoint_fraction,
)
from agility_ref.observation import observation_slices
from agility_ref.results.published import evaluate_by_protocol, mean_std, summary
from agility_ref.selector import Hierarchy, Single, oracle_hierarchy
from agility_ref.terrain import COURSE_KINDS, NUM_WAYPOINTS
from agility_ref.training.policies import ENVIRONMENTS
from agility_ref.world import World

import numpy as np
import pytest

SHORT = EnvConfig(episode_seconds=1.2)  # 30 steps, each of two control steps
FEW = EvaluationConfig(episodes=3, seed=1)
SLICES = observation_slices()

# --- metrics, by hand ------------------------------------------------------------------
# Five steps of two episodes.  The first lasts all five, the second ends with step 3 of 5;
# what its robot does after the reset must not count.

ALIVE = np.array([[1, 1], [1, 1], [1, 1], [1, 0], [1, 0]], bool)
REWARD = np.array([[1.0, 0.5], [2.0, 0.5], [-1.0, -3.0], [0.5, 100.0], [0.5, 100.0]])
WAYPOINTS = np.array([[0, 0], [1, 0], [1, 2], [2, 7], [4, 7]])
EDGE = np.array([[0, 4], [1, 1], [2, 1], [0, 4], [0, 4]])


def test_reward_by_hand():
    # 1 + 2 - 1 + 0.5 + 0.5 = 3;  0.5 + 0.5 - 3 = -2
    np.testing.assert_allclose(reward_metric(REWARD, ALIVE), [3.0, -2.0])


def test_episode_length_by_hand():
    np.testing.assert_array_equal(episode_length(ALIVE, 1), [5, 3])
    np.testing.assert_array_equal(episode_length(ALIVE, 2), [10, 6])


def test_waypoint_fraction_by_hand():
    # 4 of 8, 2 of 8
    np.testing.assert_allclose(waypoint_fraction(WAYPOINTS, ALIVE), [0.5, 0.25])


def test_edge_violation_by_hand():
    # (0 + 1 + 2 + 0 + 0) / 5 = 0.6;  (4 + 1 + 1) / 3 = 2
    np.testing.assert_allclose(edge_violation(EDGE, ALIVE), [0.6, 2.0])


# --- mean and deviation ------------------------------------------------------------------


@pytest.mark.parametrize("metric, published", [
    # 1 2 6: mean 3, squares 4 + 1 + 9 over 2; over 3 for the other two
    ("reward", 7**0.5), ("episode_length", 7**0.5),
    ("waypoint_fraction", (14 / 3) ** 0.5), ("edge_violation", (14 / 3) ** 0.5),
])  # fmt: skip
def test_standard_deviations_by_hand(metric, published):
    values = np.array([1.0, 2.0, 6.0])
    assert mean_std(values, metric, "complete") == pytest.approx((3.0, (14 / 3) ** 0.5))
    assert mean_std(values, metric, "as-published") == pytest.approx((3.0, published))


def test_the_deviation_of_one_episode():
    assert mean_std(np.array([5.0]), "reward", "complete") == (5.0, 0.0)
    assert np.isnan(mean_std(np.array([5.0]), "reward", "as-published")[1])


# --- courses ---------------------------------------------------------------------------


@pytest.mark.parametrize("environment", COURSE_KINDS)
def test_one_course_an_episode(environment):
    world = evaluation_world(environment, FEW)
    assert len(world) == 3 and set(world.kinds) == {environment}
    assert len({c.boxes for c in world.courses}) == 3


@pytest.mark.parametrize("preset, highest", [("quick", 0.4), ("full", 1.0)])
def test_difficulties_are_drawn_from_the_presets_range(preset, highest):
    d = evaluation_world("gap", EvaluationConfig(episodes=40, preset=preset)).difficulties
    assert d.min() >= 0 and 0.8 * highest < d.max() <= highest


@pytest.mark.parametrize("seed", range(4))
def test_difficulties_are_spread_evenly(seed):
    d = evaluation_world("gap", EvaluationConfig(episodes=64, seed=seed)).difficulties
    for n in (16, 32, 64):  # independent draws put 0 to 6 of 16 into a quarter
        counts = np.histogram(d[:n], 4, (0.0, 1.0))[0]
        assert np.abs(counts - n / 4).max() <= 1.5
    # d_k+1 - d_k is the golden ratio, but for whole turns
    np.testing.assert_allclose(np.diff(d) % 1.0, (5**0.5 - 1) / 2, atol=1e-12)


def test_difficulty_can_be_fixed():
    assert (evaluation_world("gap", EvaluationConfig(episodes=3, difficulty=0.3)).difficulties == 0.3).all()


def test_seeds_change_the_courses():
    a, b = (evaluation_world("gap", EvaluationConfig(episodes=2, seed=s)).courses[0] for s in (0, 1))
    assert a.boxes != b.boxes


def test_more_episodes_keep_the_first_courses():
    a, b = (evaluation_world("gap", EvaluationConfig(episodes=n)) for n in (2, 4))
    assert [c.boxes for c in a.courses] == [c.boxes for c in b.courses[:2]]


@pytest.mark.parametrize("environment, config, message", [
    ("beams", {}, "unknown environment 'beams': did you mean beam"),
    ("gap", {"preset": "ful"}, "unknown preset"),
    ("gap", {"protocol": "published"}, "unknown protocol 'published': did you mean as-published"),
    ("gap", {"episodes": 0}, "episodes must be a number of at least 1, not 0"),
    ("gap", {"episodes": 2**24 + 1}, "episodes must be at most 1.67772e\\+07, not 16777217"),
    ("gap", {"seed": -1}, "seed must be a number of at least 0, not -1"),
    ("gap", {"difficulty": 1.5}, "difficulty must be between 0 and 1, not 1.5"),
])  # fmt: skip
def test_bad_input_is_refused(environment, config, message):
    with pytest.raises(UserError, match=message):
        evaluation_world(environment, EvaluationConfig(**config))


def test_clean_turns_noise_and_pushes_off():
    env = evaluation_env("gap", EvaluationConfig(episodes=2, clean=True))
    assert env.config == EnvConfig().clean()


# --- evaluation ------------------------------------------------------------------------


@pytest.fixture
def single(make_policy):
    return Single("random", make_policy(0, gain=100.0))


def arrays(evaluation):
    return {name: getattr(evaluation, name) for name in (*METRICS, "fell", "difficulty")}


def test_evaluation_has_one_number_an_episode(single):
    evaluation = evaluate(single, "gap", FEW, SHORT)
    assert all(values.shape == (3,) for values in arrays(evaluation).values())
    assert evaluation.skill is None and evaluation.oracle is None
    assert (evaluation.episode_length >= 1).all() and (evaluation.episode_length <= 60).all()
    assert ((evaluation.edge_violation >= 0) & (evaluation.edge_violation <= 4)).all()


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_same_evaluation_twice_is_identical(single, environment):
    a, b = (arrays(evaluate(single, environment, FEW, SHORT)) for _ in range(2))
    for name in a:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def test_policies_meet_the_same_courses_and_commands(make_policy):
    starts = []

    class Noting(Single):
        """Writes down the first observation and the commands of every step."""

        def act(self, observation, env):
            starts.append((observation.copy(), env.command.copy(), env.world))
            return super().act(observation, env)

    for seed in (0, 1):
        evaluate(Noting("noting", make_policy(seed, gain=100.0)), "gap", FEW, EnvConfig(episode_seconds=0.04))
    (obs_a, command_a, world_a), (obs_b, command_b, world_b) = starts
    np.testing.assert_array_equal(obs_a, obs_b)
    np.testing.assert_array_equal(command_a, command_b)
    assert world_a is world_b


def test_episodes_are_complete(single):
    evaluation = evaluate(single, "walk", FEW, SHORT)
    np.testing.assert_array_equal(evaluation.episode_length[~evaluation.fell], 60)


class Jump(Single):
    """Leaves the lane in the third step, on the first course only."""

    def act(self, observation, env):
        self.step = getattr(self, "step", 0) + 1
        if self.step == 3:
            env._qpos[0, 1] = 5.0
        return np.zeros((len(observation), 12)), None


def test_falls_are_told_from_time_outs(make_policy):
    evaluation = evaluate(Jump("jump", make_policy()), "walk", FEW, SHORT)
    np.testing.assert_array_equal(evaluation.fell, [True, False, False])
    np.testing.assert_array_equal(evaluation.episode_length, [6, 60, 60])


def test_what_happens_after_the_first_episode_does_not_count(make_policy):
    class Finish(Single):
        """Reaches the last waypoint in step 2 on the first course, and leaves the lane in step 5."""

        def act(self, observation, env):
            self.step = getattr(self, "step", 0) + 1
            if self.step == 2:
                env.waypoint_index[0] = NUM_WAYPOINTS
            if self.step == 5:
                env._qpos[0, 1] = 5.0
            return np.zeros((len(observation), 12)), None

    evaluation = evaluate(Finish("finish", make_policy()), "walk", FEW, SHORT)
    assert not evaluation.fell.any()
    np.testing.assert_array_equal(evaluation.episode_length, [4, 60, 60])
    np.testing.assert_array_equal(evaluation.waypoint_fraction, [1.0, 0.0, 0.0])


def test_reward_is_that_of_the_first_episode_only(make_policy):
    # Robot 0 leaves the lane in step 3; what it does until the others end, in step 30, must not count.
    long, short = (
        evaluate(Jump("jump", make_policy()), "walk", FEW, config)
        for config in (SHORT, EnvConfig(episode_seconds=0.12))
    )
    assert long.reward[0] == short.reward[0] != 0.0
    assert long.edge_violation[0] == short.edge_violation[0]
    assert (long.reward[1:] != short.reward[1:]).all()


def test_summary_is_json_ready(single):
    figures = summary(evaluate(single, "gap", FEW, SHORT))
    back = json.loads(json.dumps(figures))
    assert back == figures
    assert set(METRICS) <= set(back)
    assert back["policy"] == "random" and back["environment"] == "gap" and back["episodes"] == 3


def test_summary_is_mean_and_std(single):
    evaluation = evaluate(single, "gap", FEW, SHORT)
    figures = summary(evaluation)
    for metric in METRICS:
        values = getattr(evaluation, metric)
        assert figures[metric]["mean"] == pytest.approx(sum(values) / 3)
        assert figures[metric]["std"] == pytest.approx((sum((values - sum(values) / 3) ** 2) / 3) ** 0.5)


# --- as published ------------------------------------------------------------------------

PUBLISHED = replace(FEW, protocol="as-published")


def test_who_falls_early_counts_several_times(make_policy):
    evaluation = evaluate_by_protocol(Jump("jump", make_policy()), "walk", PUBLISHED, SHORT)
    # 45 steps: robot 0 ends in steps 3 and 33, the others in step 30 alone
    np.testing.assert_array_equal(evaluation.episode_length, [6, 60, 60, 60])
    np.testing.assert_array_equal(evaluation.fell, [True, False, False, False])
    d = evaluation_world("walk", PUBLISHED).difficulties
    np.testing.assert_array_equal(evaluation.difficulty, d[[0, 1, 2, 0]])
    assert evaluation.edge_violation.shape == (45 * 3,)
    assert summary(evaluation)["episodes"] == 4 and summary(evaluation)["falls"] == 0.25


def test_published_edges_are_those_across_the_lane_alone():
    # A beam has two long sides, which the original does not see.
    complete, published = (evaluation_world("beam", config).edges for config in (FEW, PUBLISHED))
    courses = evaluation_courses("beam", FEW)
    np.testing.assert_array_equal(complete, World(courses, "xy").edges)
    np.testing.assert_array_equal(published, World(courses, "x").edges)
    assert np.isinf(published[np.isfinite(complete)]).any()


def test_the_first_episodes_are_those_of_the_complete_protocol(single):
    # The same courses, starts, noise and pushes until the first end.
    complete, published = (evaluate_by_protocol(single, "walk", c, SHORT) for c in (FEW, PUBLISHED))
    first = int(complete.episode_length.argmin())
    assert published.reward[0] == pytest.approx(complete.reward[first])
    assert published.episode_length[0] == complete.episode_length[first]


# --- hierarchies -----------------------------------------------------------------------


def test_oracle_agrees_with_itself(five_skills):
    evaluation = evaluate(oracle_hierarchy("oracle", five_skills), "gap", FEW, SHORT)
    alive = evaluation.skill >= 0
    assert alive.any()
    assert (evaluation.skill == evaluation.oracle)[alive].mean() == 1.0


def test_skills_are_recorded_until_the_end(five_skills):
    hierarchy = Hierarchy("always leap", tuple(five_skills.values()), lambda o, env: np.full(len(o), 3), np.arange(5))
    evaluation = evaluate(hierarchy, "gap", FEW, SHORT)
    assert evaluation.skill.shape == evaluation.oracle.shape
    np.testing.assert_array_equal((evaluation.skill == 3).sum(axis=0), evaluation.episode_length / 2)
    np.testing.assert_array_equal(
        (evaluation.skill == -1).sum(axis=0), len(evaluation.skill) - evaluation.episode_length / 2
    )


def test_always_one_skill_evaluates_as_that_skill(five_skills):
    hierarchy = Hierarchy("always leap", tuple(five_skills.values()), lambda o, env: np.full(len(o), 3), np.arange(5))
    a = arrays(evaluate(hierarchy, "gap", FEW, SHORT))
    b = arrays(evaluate(Single("leap", five_skills["leap"]), "gap", FEW, SHORT))
    for name in a:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def test_edges_are_counted_step_by_step(make_policy, monkeypatch):
    monkeypatch.setattr(Go1Env, "_near_edge", lambda self: np.tile([True, True, False, False], (self.num_envs, 1)))
    assert evaluate(Single("random", make_policy()), "walk", FEW, SHORT).edge_violation.tolist() == [2.0] * 3


def test_control_steps_are_those_of_all_episodes(make_policy):
    e = evaluate(Single("random", make_policy()), "walk", FEW, SHORT)
    assert summary(e)["control_steps"] == 180


def test_the_seed_of_an_evaluation_decides_the_starts(make_policy, monkeypatch):
    """Not the courses alone: on the same courses another seed draws other starts, commands and payloads."""
    seen = []

    class Noting(Single):
        def act(self, observation, env):
            payload = [model.body_mass.sum() for model in env.simulation.models]
            seen.append((observation[:, SLICES["dof_pos"]], env.command.copy(), np.array(payload)))
            return super().act(observation, env)

    world = evaluation_world("gap", FEW)
    monkeypatch.setattr(evaluation_module, "evaluation_world", lambda *_: world)
    for seed in (1, 2):
        evaluate(Noting("noting", make_policy()), "gap", replace(FEW, seed=seed), EnvConfig(episode_seconds=0.04))
    for first, second in zip(*seen, strict=True):
        assert (first != second).all()

from agility_ref.env import ACTION_DIM, EnvConfig, Go1Env
from agility_ref.observation import NUM_SCANDOTS, OBS_DIM, SCANDOTS
from agility_ref.policy import Policy
from agility_ref.selector import (
    Hierarchy,
    SelectorEnv,
    Single,
    oracle_hierarchy,
    selector_hierarchy,
    skill_labels,
)
from agility_ref.terrain import SKILLS, make_course
from agility_ref.world import World

import numpy as np
import pytest

FIVE = ("walk", "climb-up", "climb-down", "leap", "beam")
LABELS = np.arange(5)  # the skills of a bank are in the order of the oracle's labels


@pytest.fixture
def env():
    """Four robots, each on its own course: walk, gap, climb, beam."""
    world = World([make_course(kind, 0.5, 0) for kind in ("walk", "gap", "climb", "beam")])
    return Go1Env(world, 4, EnvConfig().clean(), lambda ids, fraction: ids)


@pytest.fixture
def observation():
    return np.random.default_rng(0).standard_normal((6, OBS_DIM)).astype(np.float32)


def spread(env):
    """Put the robots before the first obstacle of their course, so that their labels differ."""
    for robot, course in enumerate(env.world.courses):
        env._qpos[robot, 0] = course.obstacles[0].x0 if course.obstacles else 5.0


def constant(skill):
    return lambda observation, env: np.full(len(observation), skill)


# --- labels ----------------------------------------------------------------------------


def test_labels_of_a_full_bank_are_the_skills():
    np.testing.assert_array_equal(skill_labels(SKILLS), range(5))


def test_labels_follow_the_order_of_the_bank():
    bank = ("beam", "leap", "climb-down", "climb-up", "walk")
    assert [bank[k] for k in skill_labels(bank)] == list(SKILLS)


def test_three_skills_stand_in_for_five():
    bank = ("walk", "climb", "leap")
    named = dict(zip(SKILLS, (bank[k] for k in skill_labels(bank)), strict=True))
    assert named == {"walk": "walk", "climb-up": "climb", "climb-down": "climb", "leap": "leap", "beam": "walk"}


# --- hierarchy -------------------------------------------------------------------------


def test_each_robot_gets_its_own_skill(five_skills, observation):
    skills = tuple(five_skills.values())
    hierarchy = Hierarchy("test", skills, constant(0), LABELS)
    chosen = np.array([4, 0, 2, 2, 1, 3])
    action = hierarchy.execute(observation, chosen)
    assert action.shape == (6, ACTION_DIM)
    for robot, k in enumerate(chosen):
        np.testing.assert_allclose(action[robot], skills[k](observation[robot : robot + 1])[0], atol=1e-5)


def test_only_chosen_skills_are_run(observation):
    def never(observation):
        raise AssertionError("a skill that nobody chose was run")

    hierarchy = Hierarchy("test", (never, lambda o: np.ones((len(o), ACTION_DIM))), constant(1), LABELS)
    action, skill = hierarchy.act(observation, None)
    assert (action == 1).all() and (skill == 1).all()


@pytest.mark.parametrize("k", range(5))
def test_always_the_same_skill_is_that_skill(five_skills, observation, k):
    skills = tuple(five_skills.values())
    action, skill = Hierarchy("test", skills, constant(k), LABELS).act(observation, None)
    np.testing.assert_array_equal(action, Single("alone", skills[k]).act(observation, None)[0])
    assert (skill == k).all()


def test_every_step_is_a_decision(five_skills, observation):
    calls = iter(range(5))
    hierarchy = Hierarchy("test", tuple(five_skills.values()), lambda o, e: np.full(len(o), next(calls)), LABELS)
    assert [hierarchy.act(observation, None)[1][0] for _ in range(5)] == [0, 1, 2, 3, 4]


def test_a_decision_once_returned_is_not_changed(five_skills, observation):
    calls = iter(range(5))
    hierarchy = Hierarchy("test", tuple(five_skills.values()), lambda o, e: np.full(len(o), next(calls)), LABELS)
    first = hierarchy.act(observation, None)[1]
    hierarchy.act(observation, None)
    assert (first == 0).all()


# --- oracle ----------------------------------------------------------------------------


def test_oracle_reads_the_region_map(env, five_skills):
    spread(env)
    _, skill = oracle_hierarchy("oracle", five_skills).act(np.zeros((4, OBS_DIM), np.float32), env)
    assert [FIVE[k] for k in skill] == ["walk", "leap", "climb-up", "beam"]


def test_oracle_over_three_skills(env, make_policy):
    bank = {name: make_policy(k, name) for k, name in enumerate(("walk", "climb", "leap"))}
    spread(env)
    _, skill = oracle_hierarchy("oracle", bank).act(np.zeros((4, OBS_DIM), np.float32), env)
    assert [list(bank)[k] for k in skill] == ["walk", "leap", "climb", "walk"]


# --- learned selector ------------------------------------------------------------------


def linear_selector(obs_dim, column):
    """A selector of two skills: index 1 where the observed column is positive."""
    weight = np.zeros((2, obs_dim), np.float32)
    weight[1, column] = 1.0
    arrays = {
        "actor.0.weight": weight, "actor.0.bias": np.zeros(2, np.float32),
        "normalizer.mean": np.zeros(obs_dim, np.float32), "normalizer.var": np.ones(obs_dim, np.float32),
    }  # fmt: skip
    return Policy.from_arrays(arrays, {"policy": "selector", "act_dim": 2})


@pytest.mark.parametrize("obs_dim, column", [(OBS_DIM, 9), (NUM_SCANDOTS, 9)])
def test_selector_takes_the_largest_logit(make_policy, observation, obs_dim, column):
    bank = {"walk": make_policy(0), "climb": make_policy(1)}
    bank["leap"] = bank["climb"]
    hierarchy = selector_hierarchy("test", bank, linear_selector(obs_dim, column))
    seen = observation[:, column if obs_dim == OBS_DIM else SCANDOTS.start + column]
    np.testing.assert_array_equal(hierarchy.act(observation, None)[1], seen > 0)


# --- environment of the PPO selector ---------------------------------------------------


def test_oracle_reward_is_plus_or_minus_dt(env, five_skills):
    selector_env = SelectorEnv(env, oracle_hierarchy("oracle", five_skills), "oracle")
    selector_env.reset(0)
    spread(env)
    chosen = np.array([SKILLS.index(s) for s in ("walk", "walk", "climb-up", "leap")])  # right, wrong, right, wrong
    _, reward, *_ = selector_env.step(chosen)
    np.testing.assert_allclose(reward, [0.04, -0.04, 0.04, -0.04])  # 25 Hz


def test_environment_reward_is_passed_on(env, five_skills):
    selector_env = SelectorEnv(env, oracle_hierarchy("oracle", five_skills), "environment")
    selector_env.reset(0)
    _, reward, _, _, info = selector_env.step(np.zeros(4, int))
    np.testing.assert_array_equal(reward, sum(info["reward_terms"].values()))


def test_selector_env_executes_the_chosen_skill(env, five_skills):
    selector_env = SelectorEnv(env, oracle_hierarchy("oracle", five_skills), "environment")
    observation, _ = selector_env.reset(0)
    after, *_ = selector_env.step(np.full(4, 3))
    action = five_skills["leap"](observation)
    last_action = slice(36, 48)
    np.testing.assert_allclose(after[:, last_action], np.clip(action, -4, 4), atol=1e-6)


def test_selector_env_passes_on_how_episodes_end(env, five_skills):
    selector_env = SelectorEnv(env, oracle_hierarchy("oracle", five_skills), "oracle")
    selector_env.reset(0)
    env._qpos[2, 1] = 5.0  # outside the lane
    observation, reward, terminated, truncated, info = selector_env.step(np.zeros(4, int))
    np.testing.assert_array_equal(terminated, [False, False, True, False])
    assert not truncated.any() and reward[2] == 0.04  # walking, where walking was right
    others = [0, 1, 3]
    np.testing.assert_array_equal(info["final_obs"][others], observation[others])
    assert (info["final_obs"][2] != observation[2]).any()
    assert info["totals"]["length"].tolist() == [1] * 4
    assert len(set(info["kind"])) == 4  # each robot is on a kind of its own


@pytest.fixture
def three_skills(make_policy):
    return {name: make_policy(k, name) for k, name in enumerate(("walk", "climb", "leap"))}


def test_oracle_reward_over_three_skills(env, three_skills):
    selector_env = SelectorEnv(env, oracle_hierarchy("oracle", three_skills), "oracle")
    selector_env.reset(0)
    spread(env)  # before nothing, a gap, a step, a beam
    _, reward, *_ = selector_env.step(np.array([0, 2, 1, 0]))  # walk, leap, climb, and walk in the place of beam
    np.testing.assert_allclose(reward, 0.04)


def test_a_selector_of_three_knows_the_oracles_labels(three_skills):
    hierarchy = selector_hierarchy("ps-rl-3", three_skills, linear_selector(OBS_DIM, 9))
    assert hierarchy.labels.tolist() == [0, 1, 1, 2, 0]

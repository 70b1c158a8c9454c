from agility_ref.env import ACTION_DIM, EnvConfig, Go1Env
from agility_ref.observation import NUM_SCANDOTS, OBS_DIM, SCANDOTS
from agility_ref.policy import Policy
from agility_ref.selector import (
    Hierarchy,
    SelectorConfig,
    SelectorEnv,
    Single,
    SupervisedConfig,
    collect_labels,
    fit_selector,
    oracle_hierarchy,
    selector_hierarchy,
    skill_labels,
    visit,
)
from agility_ref.terrain import SKILLS, make_course
from agility_ref.world import World

import numpy as np
import pytest

FIVE = ("walk", "climb-up", "climb-down", "leap", "beam")


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
    hierarchy = Hierarchy("test", skills, constant(0))
    chosen = np.array([4, 0, 2, 2, 1, 3])
    action = hierarchy.execute(observation, chosen)
    assert action.shape == (6, ACTION_DIM)
    for robot, k in enumerate(chosen):
        np.testing.assert_allclose(action[robot], skills[k](observation[robot : robot + 1])[0], atol=1e-5)


def test_only_chosen_skills_are_run(observation):
    def never(observation):
        raise AssertionError("a skill that nobody chose was run")

    hierarchy = Hierarchy("test", (never, lambda o: np.ones((len(o), ACTION_DIM))), constant(1))
    action, skill = hierarchy.act(observation, None)
    assert (action == 1).all() and (skill == 1).all()


@pytest.mark.parametrize("k", range(5))
def test_always_the_same_skill_is_that_skill(five_skills, observation, k):
    skills = tuple(five_skills.values())
    action, skill = Hierarchy("test", skills, constant(k)).act(observation, None)
    np.testing.assert_array_equal(action, Single("alone", skills[k]).act(observation, None)[0])
    assert (skill == k).all()


def test_decisions_are_held(five_skills, observation):
    calls = iter(range(5))
    hierarchy = Hierarchy(
        "test", tuple(five_skills.values()), lambda o, e: np.full(len(o), next(calls)), decision_steps=3
    )
    chosen = [hierarchy.act(observation, None)[1][0] for _ in range(8)]
    assert chosen == [0, 0, 0, 1, 1, 1, 2, 2]


def test_reset_forgets_the_held_decision(five_skills, observation):
    calls = iter(range(5))
    hierarchy = Hierarchy(
        "test", tuple(five_skills.values()), lambda o, e: np.full(len(o), next(calls)), decision_steps=3
    )
    assert hierarchy.act(observation, None)[1][0] == 0
    hierarchy.reset()
    assert [hierarchy.act(observation, None)[1][0] for _ in range(4)] == [1, 1, 1, 2]


def test_a_robot_whose_episode_ended_decides_anew_at_once(five_skills, observation):
    calls = iter(range(5))
    hierarchy = Hierarchy(
        "test", tuple(five_skills.values()), lambda o, e: np.full(len(o), next(calls)), decision_steps=3
    )
    chosen = [hierarchy.act(observation, None)[1]]
    hierarchy.reset(np.array([2, 5]))  # their episodes ended with the first step of the hold
    chosen += [hierarchy.act(observation, None)[1] for _ in range(6)]
    # Robots 0, 1, 3, 4 decide at steps 0, 3, 6, robots 2 and 5 at 0 and again at 1, 4.  The
    # chooser is asked whenever somebody decides: at 0, 1, 3, 4, 6.
    assert [step[0] for step in chosen] == [0, 0, 0, 2, 2, 2, 4]
    assert [step[2] for step in chosen] == [0, 1, 1, 1, 3, 3, 3]
    np.testing.assert_array_equal(chosen[1], [0, 0, 1, 0, 0, 1])


def test_a_decision_once_returned_is_not_changed(five_skills, observation):
    calls = iter(range(5))
    hierarchy = Hierarchy("test", tuple(five_skills.values()), lambda o, e: np.full(len(o), next(calls)))
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


def test_the_checkpoint_says_how_long_a_choice_is_held(five_skills):
    selector = linear_selector(NUM_SCANDOTS, 0)
    assert selector_hierarchy("test", five_skills, selector).decision_steps == 1
    selector.meta["decision_steps"] = 10
    assert selector_hierarchy("test", five_skills, selector).decision_steps == 10


def separable(n, seed):
    """Scandots whose label is the sector that two of them point to."""
    x = np.random.default_rng(seed).uniform(-1, 1, (n, NUM_SCANDOTS)).astype(np.float32)
    return x, np.where(x[:, 0] > 0.3, 2, np.where(x[:, 5] > 0, 1, 0))


def test_fit_selector_learns_a_separable_problem():
    config = SupervisedConfig(epochs=15, batch_size=64, hidden=(32,))
    arrays, losses = fit_selector(*separable(3000, 0), 3, config, seed=0)
    assert losses[0] > 3 * losses[-1]
    selector = Policy.from_arrays(arrays, {"policy": "ps-sl", "act_dim": 3})
    assert selector.obs_dim == NUM_SCANDOTS
    x, label = separable(1000, 1)
    assert (selector(x).argmax(axis=1) == label).mean() > 0.9


def test_fit_selector_is_reproducible():
    config = SupervisedConfig(epochs=2, batch_size=64, hidden=(8,))
    data = separable(200, 0)
    a, b, other = (fit_selector(*data, 3, config, seed)[0] for seed in (0, 0, 1))
    np.testing.assert_array_equal(a["actor.0.weight"], b["actor.0.weight"])
    assert (a["actor.0.weight"] != other["actor.0.weight"]).any()


def test_first_loss_is_that_of_guessing():
    # a new network is near uniform over 3 skills: -log(1/3)
    config = SupervisedConfig(epochs=1, batch_size=10_000, hidden=(8,))
    _, losses = fit_selector(*separable(500, 0), 3, config, seed=0)
    assert losses[0] == pytest.approx(np.log(3), abs=0.05)


def test_collected_labels_are_the_oracles(env, five_skills):
    oracle = oracle_hierarchy("oracle", five_skills)
    wanted = []

    class Noting(Hierarchy):
        """An actor that always walks, and writes down what the oracle would do."""

        def act(self, observation, env):
            wanted.append(env.oracle_skill())
            return super().act(observation, env)

    actor = Noting("walker", tuple(five_skills.values()), constant(0))
    scandots, labels = collect_labels(env, actor, oracle, 38)
    assert scandots.shape == (40, NUM_SCANDOTS)  # ten steps of four robots
    np.testing.assert_array_equal(labels, np.concatenate(wanted))


# --- environment of the PPO selector ---------------------------------------------------


def test_oracle_reward_is_plus_or_minus_dt(env, five_skills):
    selector_env = SelectorEnv(env, oracle_hierarchy("oracle", five_skills), "oracle")
    selector_env.reset(0)
    spread(env)
    chosen = np.array([SKILLS.index(s) for s in ("walk", "walk", "climb-up", "leap")])  # right, wrong, right, wrong
    _, reward, *_ = selector_env.step(chosen)
    np.testing.assert_allclose(reward, [0.02, -0.02, 0.02, -0.02])


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


# --- held decisions, by hand -------------------------------------------------------------


class Scripted:
    """Two robots whose rewards and ends are written down; an observation holds the step count."""

    num_envs = 2
    config = EnvConfig()

    def __init__(self, rewards, terminated=(), truncated=()):
        self.rewards, self.terminated, self.truncated = rewards, terminated, truncated
        self.t, self.actions = 0, []

    def observe(self, t):
        return np.full((2, OBS_DIM), t, np.float32)

    def reset(self, seed):
        self.t = 0
        return self.observe(0), {}

    def oracle_skill(self):
        return np.zeros(2, int)

    def step(self, action):
        self.actions.append(action[:, 0].copy())
        ends = [
            np.array([(self.t, robot) in marked for robot in range(2)]) for marked in (self.terminated, self.truncated)
        ]
        reward = np.array(self.rewards[self.t], float)
        self.t += 1
        info = {"final_observation": self.observe(self.t), "episode": {"length": np.full(2, self.t)}}
        return self.observe(self.t), reward, *ends, info


def held(env, reward="environment", gamma=0.5, **config):
    """A SelectorEnv over skills that act by their index: 0 walks, 1 to 4 do something else."""
    skills = tuple((lambda o, k=k: np.full((len(o), ACTION_DIM), float(k))) for k in range(5))
    selector_env = SelectorEnv(env, Hierarchy("test", skills, constant(0)), reward, SelectorConfig(**config), gamma)
    selector_env.reset(0)
    return selector_env


def test_reward_of_a_hold():
    env = Scripted([(1, 8), (2, 4), (4, 2)])
    observation, reward, terminated, truncated, info = held(env, decision_steps=3).step(np.array([3, 1]))
    # 1 + 2/2 + 4/4 = 3;  8 + 4/2 + 2/4 = 10.5
    np.testing.assert_allclose(reward, [3.0, 10.5])
    np.testing.assert_array_equal(env.actions, [[3, 1]] * 3)
    assert not terminated.any() and not truncated.any()
    assert (observation == 3).all() and (info["final_observation"] == observation).all()


def test_an_episode_that_ends_within_a_hold():
    # Robot 1 falls in the second of four steps, and its next episode ends in the fourth.
    env = Scripted([(1, 1), (1, 2), (1, 100), (1, 100)], terminated={(1, 1)}, truncated={(3, 1)})
    selector_env = held(env, decision_steps=4)
    observation, reward, terminated, truncated, info = selector_env.step(np.array([3, 2]))
    # 1 + 1/2 + 1/4 + 1/8 = 1.875;  1 + 2/2 = 2: what comes after its end is nobody's
    np.testing.assert_allclose(reward, [1.875, 2.0])
    np.testing.assert_array_equal(terminated, [False, True])
    np.testing.assert_array_equal(truncated, [False, False])
    np.testing.assert_array_equal(info["episode"]["length"], [4, 2])
    np.testing.assert_array_equal(info["final_observation"][:, 0], [4, 2])
    assert (observation == 4).all()
    # it leaps, leaps, and then walks to the end of the hold
    np.testing.assert_array_equal(env.actions, [[3, 2], [3, 2], [3, 0], [3, 0]])


def test_an_end_in_the_last_step_of_a_hold():
    env = Scripted([(1, 1), (1, 2)], truncated={(1, 0)})
    _, reward, terminated, truncated, info = held(env, decision_steps=2).step(np.array([3, 2]))
    np.testing.assert_allclose(reward, [1.5, 2.0])
    np.testing.assert_array_equal(truncated, [True, False])
    assert not terminated.any()
    np.testing.assert_array_equal(info["final_observation"][:, 0], [2, 2])


def test_switching_costs_within_an_episode_only():
    # Robot 1 falls in the third decision: its fourth is the first of an episode, and free.
    env = Scripted([(0, 0)] * 5, terminated={(2, 1)})
    selector_env = held(env, switch_cost=0.25)
    rewards = [selector_env.step(np.array(skill))[1] for skill in ((1, 1), (1, 2), (3, 2), (4, 3), (4, 4))]
    np.testing.assert_allclose(np.stack(rewards).T, [[0, 0, -0.25, -0.25, 0], [0, -0.25, 0, 0, -0.25]])
    selector_env.reset(0)
    np.testing.assert_allclose(selector_env.step(np.array([2, 2]))[1], 0.0)


def test_a_switch_costs_once_per_hold():
    selector_env = held(Scripted([(0, 0)] * 6), decision_steps=3, switch_cost=0.25)
    selector_env.step(np.array([1, 1]))
    np.testing.assert_allclose(selector_env.step(np.array([1, 2]))[1], [0.0, -0.25])


def test_oracle_reward_counts_every_step_of_a_hold():
    # the oracle always walks: +-0.02 (1 + 1/2 + 1/4) = +-0.035
    _, reward, *_ = held(Scripted([(9, 9)] * 3), "oracle", decision_steps=3).step(np.array([0, 1]))
    np.testing.assert_allclose(reward, [0.035, -0.035])


def test_decisions_of_any_length_have_the_same_return():
    # sum over decisions of (gamma^k)^m R_m = sum over steps of gamma^t r_t
    gamma, rewards = 0.9, np.random.default_rng(0).normal(size=(12, 2))
    expected = (gamma ** np.arange(12)) @ rewards
    for hold in (1, 2, 3, 4, 6, 12):
        selector_env = held(Scripted(rewards), decision_steps=hold, gamma=gamma)
        total = sum(gamma ** (hold * m) * selector_env.step(np.zeros(2, int))[1] for m in range(12 // hold))
        np.testing.assert_allclose(total, expected)


def test_a_hold_is_its_control_steps(five_skills):
    """Ten single steps of one choice and one hold of ten end in the same state, falls included."""
    courses = [make_course(kind, 0.5, 0) for kind in ("walk", "gap", "climb", "beam")]
    skill = np.array([0, 3, 1, 4])
    results = []
    for hold in (1, 10):
        env = Go1Env(World(courses), 4, EnvConfig(), lambda ids, fraction: ids)
        hierarchy = oracle_hierarchy("oracle", five_skills)
        selector_env = SelectorEnv(env, hierarchy, "environment", SelectorConfig(decision_steps=hold), 1.0)
        selector_env.reset(0)
        reward = 0.0
        for _ in range(10 // hold):
            observation, r, terminated, truncated, _ = selector_env.step(skill)
            assert not (terminated | truncated).any()
            reward = reward + r
        results.append((observation, reward))
    np.testing.assert_array_equal(results[0][0], results[1][0])
    np.testing.assert_allclose(results[0][1], results[1][1], atol=1e-12)


def test_a_fall_within_a_hold_is_reported_with_its_own_end(env, five_skills):
    selector_env = SelectorEnv(
        env, oracle_hierarchy("oracle", five_skills), "environment", SelectorConfig(decision_steps=5)
    )
    selector_env.reset(0)
    env._qpos[2, 1] = 5.0  # outside the lane: it falls in the first of the five steps
    observation, _, terminated, _, info = selector_env.step(np.zeros(4, int))
    np.testing.assert_array_equal(terminated, [False, False, True, False])
    np.testing.assert_array_equal(info["episode"]["length"], [5, 5, 1, 5])
    others = [0, 1, 3]
    np.testing.assert_array_equal(info["final_observation"][others], observation[others])
    assert (info["final_observation"][2] != observation[2]).any()
    assert env._step_count[2] == 4  # of the next episode


@pytest.fixture
def three_skills(make_policy):
    return {name: make_policy(k, name) for k, name in enumerate(("walk", "climb", "leap"))}


def test_oracle_reward_over_three_skills(env, three_skills):
    selector_env = SelectorEnv(env, oracle_hierarchy("oracle", three_skills), "oracle")
    selector_env.reset(0)
    spread(env)  # before nothing, a gap, a step, a beam
    _, reward, *_ = selector_env.step(np.array([0, 2, 1, 0]))  # walk, leap, climb, and walk in the place of beam
    np.testing.assert_allclose(reward, 0.02)


def test_a_selector_of_three_knows_the_oracles_labels(three_skills):
    hierarchy = selector_hierarchy("ps-rl-3", three_skills, linear_selector(OBS_DIM, 9))
    assert hierarchy.labels.tolist() == [0, 1, 1, 2, 0]


def test_a_held_choice_ends_with_the_episode_also_in_training_data(env, five_skills):
    asked = []
    hierarchy = Hierarchy(
        "held", tuple(five_skills.values()), lambda o, e: asked.append(1) or np.zeros(len(o), int), 100
    )
    env.max_steps = 3
    list(visit(env, hierarchy, 4 * 7))
    assert len(asked) == 3  # at steps 0, 3, 6


def test_action_noise_is_drawn_anew(env, five_skills, monkeypatch):
    taken, step = [], env.step
    monkeypatch.setattr(env, "step", lambda action: taken.append(action) or step(action))
    still = Single("still", lambda o: np.zeros((len(o), 12)))
    list(visit(env, still, 400, 0.5))
    assert np.mean(taken) == pytest.approx(0.0, abs=0.05) and np.std(taken) == pytest.approx(0.5, abs=0.05)


def test_a_selectors_normaliser_is_that_of_the_scandots():
    arrays, _ = fit_selector(*separable(50, 0), 3, SupervisedConfig(epochs=1, hidden=(4,)), 0)
    assert not arrays["normalizer.mean"].any()
    np.testing.assert_allclose(arrays["normalizer.var"], 0.09)

from dataclasses import replace

from agility_ref.env import ACTION_DIM, TRAINING, EnvConfig, Go1Env
from agility_ref.errors import UserError
from agility_ref.go1 import DEFAULT_DOF_POS, STAND_HEIGHT
from agility_ref.observation import (
    NUM_SCANDOTS,
    OBS_DIM,
    OBSERVATION,
    SCANDOT_X,
    SCANDOT_Y,
    SCANDOTS,
    observation_slices,
    rotation,
    wrap,
)
from agility_ref.rewards import compute_reward
from agility_ref.terrain import CELL, COURSE_KINDS, LANE_WIDTH, NUM_WAYPOINTS, SKILLS, make_course
from agility_ref.world import World

import numpy as np
import pytest

CLEAN = replace(EnvConfig().clean(), action_repeat=1, scandot_period=2)  # a step is one control step of 20 ms
SLICES = observation_slices()


def make_env(kind="gap", n=4, config=CLEAN, d=0.5, seed=0, **options):
    world = World([make_course(kind, d, k) for k in range(2)])
    return Go1Env(world, n, config, lambda ids, fraction: ids % 2, seed=seed, **options)


def random_actions(steps, n, seed=0, scale=1.0):
    return scale * np.random.default_rng(seed).standard_normal((steps, n, ACTION_DIM))


def rollout(env, actions):
    """Observations (T, N, 184), rewards, terminated, truncated, infos."""
    return tuple(np.array(x) if k < 4 else x for k, x in enumerate(zip(*map(env.step, actions), strict=True)))


def stand(env, ids, x, y, z=0.0, yaw=0.0):
    """Put robots in the home pose, at rest, on a surface at height z."""
    env._qpos[ids] = env.simulation.home
    env._qpos[ids, 0], env._qpos[ids, 1], env._qpos[ids, 2] = x, y, z + STAND_HEIGHT
    env._qpos[ids, 3], env._qpos[ids, 6] = np.cos(yaw / 2), np.sin(yaw / 2)
    env._qvel[ids] = 0.0


def still(env):
    return np.zeros((env.num_envs, ACTION_DIM))


# --- contract, on every course --------------------------------------------------------


@pytest.fixture(scope="module", params=COURSE_KINDS)
def played(request):
    """Forty random steps of four robots with all noise on."""
    env = make_env(request.param, config=EnvConfig())
    first, _ = env.reset(3)
    return first, rollout(env, random_actions(40, 4))


def test_shapes_and_types(played):
    first, (obs, reward, terminated, truncated, infos) = played
    assert first.shape == (4, OBS_DIM) and obs.shape == (40, 4, OBS_DIM)
    assert first.dtype == obs.dtype == np.float32
    assert reward.shape == terminated.shape == truncated.shape == (40, 4)
    assert terminated.dtype == truncated.dtype == bool
    assert infos[0]["final_obs"].shape == (4, OBS_DIM)
    assert all(value.shape == (4,) for value in infos[0]["totals"].values())
    assert infos[0]["feet_on_edge"].shape == (4,) and infos[0]["kind"].shape == (4,)
    assert set(infos[0]["totals"]) == {"reward", "length", "waypoints", "edge"}


def test_all_is_finite(played):
    first, (obs, reward, *_) = played
    assert np.isfinite(first).all() and np.isfinite(obs).all() and np.isfinite(reward).all()


@pytest.mark.parametrize("kind", COURSE_KINDS)
def test_no_observation_element_is_constant(kind):
    # Without noise, which would hide a dead element.
    obs, *_ = rollout(make_env(kind, n=6), random_actions(60, 6, scale=2.0))
    constant = np.ptp(obs.reshape(-1, OBS_DIM), axis=0) == 0
    assert not constant.any(), np.flatnonzero(constant)


def test_observations_do_not_share_memory():
    env = make_env(n=2)
    a, _ = env.reset(0)
    b, *_ = env.step(still(env))
    kept = b.copy()
    c, *_ = env.step(still(env))
    assert not np.shares_memory(a, b) and not np.shares_memory(b, c)
    np.testing.assert_array_equal(b, kept)
    assert not any(np.shares_memory(b, getattr(env, name)) for name in ("base_lin_vel", "heading_error"))


def test_infos_do_not_change_later():
    env = make_env(n=2)
    _, reward, _, _, info = env.step(still(env))
    kept = {name: value.copy() for name, value in info["totals"].items()}, reward.copy()
    for action in random_actions(5, 2):
        env.step(action)
    for name, value in kept[0].items():
        np.testing.assert_array_equal(info["totals"][name], value)
    np.testing.assert_array_equal(reward, kept[1])


@pytest.mark.parametrize("kind", COURSE_KINDS)
def test_same_seed_same_trajectory_at_any_thread_count(kind):
    config = replace(EnvConfig(), episode_seconds=0.4, push_interval=0.2)  # resets and pushes included
    actions = random_actions(30, 4)
    a, b = (rollout(make_env(kind, config=config, seed=5, num_threads=k), actions) for k in (1, 2))
    for x, y in zip(a[:4], b[:4], strict=True):
        np.testing.assert_array_equal(x, y)


def test_reset_with_a_seed_starts_over():
    env = make_env(config=EnvConfig(scandot_period=2))
    actions = random_actions(11, 4)  # an odd number: half the robots have looked
    first_a, _ = env.reset(9)
    a = rollout(env, actions)
    first_b, _ = env.reset(9)
    b = rollout(env, actions)
    np.testing.assert_array_equal(first_a, first_b)
    for x, y in zip(a[:4], b[:4], strict=True):
        np.testing.assert_array_equal(x, y)


def test_other_seed_other_start():
    env = make_env()
    a, _ = env.reset(1)
    b, _ = env.reset(2)
    assert (a != b).any(axis=1).all()


@pytest.mark.parametrize("config", [EnvConfig(), CLEAN])
def test_reward_is_the_sum_of_its_terms_exactly(config):
    env = make_env(config=config)
    for action in random_actions(50, 4):
        _, reward, _, _, info = env.step(action)
        np.testing.assert_array_equal(reward, sum(info["reward_terms"].values()))


def test_models_of_a_world_have_equal_sizes():
    env = Go1Env(World([make_course(kind, 0.5, 0) for kind in COURSE_KINDS]), 2)
    assert len({(m.nq, m.nv, m.nu, m.ngeom, m.nbody, m.nsensordata) for m in env.simulation.models}) == 1


def test_control_runs_at_50_hz_and_actions_come_at_half_of_it():
    assert EnvConfig(action_repeat=1).dt == pytest.approx(0.02)
    assert EnvConfig().dt == pytest.approx(0.04)


# --- action ----------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(4, 11), (3, 12), (12,), (4, 12, 1)])
def test_wrong_action_shape_is_refused(shape):
    with pytest.raises(ValueError, match="shape"):
        make_env().step(np.zeros(shape))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_action_that_is_not_finite_is_refused(bad):
    env = make_env()
    action = still(env)
    action[2, 5] = bad
    with pytest.raises(UserError, match="1 entries"):
        env.step(action)


def test_a_refused_action_changes_nothing():
    a, b = make_env(), make_env()
    with pytest.raises(UserError):
        a.step(np.full((4, ACTION_DIM), np.nan))
    np.testing.assert_array_equal(a.step(still(a))[0], b.step(still(b))[0])


def test_actions_are_clipped():
    a, b = make_env(), make_env()
    limit = CLEAN.action_limit
    np.testing.assert_array_equal(
        a.step(np.full((4, ACTION_DIM), 9 * limit))[0], b.step(np.full((4, ACTION_DIM), limit))[0]
    )


def test_the_robot_stands_on_a_zero_action():
    env = make_env("walk")
    for _ in range(100):
        obs, _, terminated, _, _ = env.step(still(env))
        assert not terminated.any()
    assert obs[:, SLICES["foot_contact"]].all()
    np.testing.assert_allclose(env.base_pos[:, 2], STAND_HEIGHT, atol=0.05)
    np.testing.assert_allclose(obs[:, SLICES["projected_gravity"]], [[0.0, 0.0, -1.0]] * 4, atol=0.1)


# --- observation -----------------------------------------------------------------------


def test_slices_tile_the_observation():
    assert OBS_DIM == 184
    assert sorted(i for s in SLICES.values() for i in range(s.start, s.stop)) == list(range(OBS_DIM))
    assert list(SLICES) == list(OBSERVATION)
    assert SCANDOTS == SLICES["scandots"]


def test_docstring_table_is_the_observation():
    rows = [line.split()[:2] for line in Go1Env.__doc__.splitlines()]
    table = {row[0]: int(row[1]) for row in rows if len(row) == 2 and row[0] in OBSERVATION}
    assert table == {name: size for name, (size, _) in OBSERVATION.items()}


def test_observation_after_a_teleport():
    env = make_env()
    stand(env, 0, 1.0, 0.0, yaw=0.3)
    obs, *_ = env.step(still(env))
    # waypoint 0 stands straight ahead at (2, 0): the heading error is minus the yaw
    assert obs[0, SLICES["heading_error"]][0] == pytest.approx(-0.3, abs=0.02)
    np.testing.assert_allclose(obs[0, SLICES["dof_pos"]], env._qpos[0, 7:] - env.simulation.home[7:], atol=1e-6)
    assert obs[0, SLICES["command"]][0] == np.float32(env.command[0])


def test_last_action_is_observed():
    env = make_env()
    action = random_actions(1, 4)[0]
    obs, *_ = env.step(action)
    np.testing.assert_array_equal(obs[:, SLICES["last_action"]], action.astype(np.float32))


def test_velocity_is_in_the_trunks_frame():
    env = make_env("walk")
    stand(env, 0, 1.0, 0.0, z=0.3, yaw=np.pi / 2)
    env._qvel[0, :2] = 0.0, 1.0  # along +y of the world, which is straight ahead
    obs, *_ = env.step(still(env))
    np.testing.assert_allclose(obs[0, SLICES["base_lin_vel"]][:2], [1.0, 0.0], atol=0.05)


def test_rotation_against_mujoco():
    import mujoco

    quats = np.random.default_rng(0).standard_normal((5, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    for matrix, quat in zip(rotation(quats), quats, strict=True):
        expected = np.zeros(9)
        mujoco.mju_quat2Mat(expected, quat)
        np.testing.assert_allclose(matrix, expected.reshape(3, 3), atol=1e-12)


def test_wrap():
    np.testing.assert_allclose(wrap(np.array([0.0, 3.0, 4.0, -4.0])), [0.0, 3.0, 4.0 - 2 * np.pi, 2 * np.pi - 4.0])


def surface(boxes, x, y):
    """Height of the ground at (x, y), y from the right border."""
    return max(b.top for b in boxes if b.x0 <= x <= b.x1 and b.y0 <= y - LANE_WIDTH / 2 <= b.y1)


@pytest.mark.parametrize("kind", COURSE_KINDS)
def test_scandots_against_a_loop_over_boxes(kind):
    env = make_env(kind, n=6, d=0.8, config=replace(CLEAN, scandot_period=1))
    rng = np.random.default_rng(1)
    for robot in range(6):
        x, y = rng.uniform(1.0, 17.0), rng.uniform(-1.5, 1.5)
        support = env.world.support[robot % 2, env.world.column(np.array(x))]
        stand(env, robot, x, y, z=support + 0.4, yaw=rng.uniform(-3, 3))
    # The robots fall freely for one step; the last observation is of the pose they are in then.
    poses = []
    simulate = env.simulation.step

    def note_pose(num_steps):
        failed = simulate(num_steps)
        poses.append(env._qpos.copy())
        return failed

    env.simulation.step = note_pose
    *_, info = env.step(still(env))
    observed = info["final_obs"][:, SCANDOTS].reshape(6, len(SCANDOT_X), len(SCANDOT_Y))
    checked = 0
    for robot in range(6):
        x, y, z = poses[-1][robot, :3]
        forward = rotation(poses[-1][robot : robot + 1, 3:7])[0][:, 0]
        yaw = np.arctan2(forward[1], forward[0])
        boxes = env.world.courses[robot % 2].boxes
        for a, dx in enumerate(SCANDOT_X):
            for b, dy in enumerate(SCANDOT_Y):
                px = x + np.cos(yaw) * dx - np.sin(yaw) * dy
                py = y + np.sin(yaw) * dx + np.cos(yaw) * dy + LANE_WIDTH / 2
                if min(px % CELL, -px % CELL, py % CELL, -py % CELL) < 2e-4:
                    continue  # on the border of a cell, rounding decides
                # The mean over 7 x 7 cells, at their centres; beyond the lane its border goes on.
                i, j = (int(np.clip(p // CELL, 0, n - 1)) for p, n in ((px, 900), (py, 200)))
                around = [
                    surface(boxes, (np.clip(i + k, 0, 899) + 0.5) * CELL, (np.clip(j + m, 0, 199) + 0.5) * CELL)
                    for k in range(-3, 4)
                    for m in range(-3, 4)
                ]
                assert observed[robot, a, b] == pytest.approx(np.clip(z - 0.3 - np.mean(around), -1, 1), abs=1e-5)
                checked += 1
    assert checked > 0.9 * 6 * NUM_SCANDOTS


# --- noise -----------------------------------------------------------------------------


def test_noise_does_not_depend_on_the_actions():
    noisy = replace(CLEAN, noise=1.0)
    difference = []
    for seed in (1, 2):
        actions = random_actions(15, 4, seed)
        envs = [make_env(config=c, seed=3) for c in (noisy, CLEAN)]
        if seed == 2:
            for env in envs:
                stand(env, 0, 1.0, 5.0)  # one robot falls and starts again
        a, b = (rollout(env, actions)[4] for env in envs)
        difference.append([x["final_obs"] - y["final_obs"] for x, y in zip(a, b, strict=True)])
    np.testing.assert_allclose(difference[0], difference[1], atol=1e-4)
    assert np.abs(difference[0]).max() > 0.1


def test_noise_stays_within_its_amplitudes():
    actions = random_actions(20, 4)
    a, b = (rollout(make_env(config=c, seed=3), actions)[0] for c in (replace(CLEAN, noise=2.0), CLEAN))
    for name, (_, amplitude) in OBSERVATION.items():
        difference = np.abs(a - b)[:, :, SLICES[name]]
        assert difference.max() <= 2 * amplitude + 1e-5, name
        assert (difference > amplitude).any() == (amplitude > 0), name


def test_starts_do_not_depend_on_the_actions():
    config = replace(EnvConfig(), episode_seconds=0.4)
    commands = []
    for seed in (1, 2):
        env = make_env("walk", config=config, seed=3)
        rollout(env, random_actions(10, 4, seed, scale=0.3))  # ends in the reset after 10 steps
        commands.append((env.command.copy(), env._qpos.copy()))
    np.testing.assert_array_equal(commands[0][0], commands[1][0])
    np.testing.assert_array_equal(commands[0][1], commands[1][1])


def test_pushes_do_not_depend_on_the_actions():
    config = replace(CLEAN, push_interval=0.1, push_velocity=20.0)  # far above what 20 ms of ground can undo
    velocities = []
    for seed in (1, 2):
        env = make_env("walk", n=16, config=config, seed=3)
        if seed == 2:
            stand(env, 0, 1.0, 5.0)  # one robot falls and starts again: the others' pushes stay the same
        pushed = np.zeros((16, 2))
        for action in random_actions(5, 16, seed, scale=0.3):  # each robot's push is due in one of five steps
            before = env._qvel[:, :2].copy()
            env.step(action)
            after = env._qvel[:, :2]
            jumped = (np.abs(after - before).max(axis=1) > 4.0) & (pushed == 0).all(axis=1)
            pushed[jumped] = after[jumped]
        velocities.append(pushed[1:])
    both = (velocities[0] != 0).any(axis=1) & (velocities[1] != 0).any(axis=1)
    assert both.sum() > 8
    np.testing.assert_allclose(velocities[0][both], velocities[1][both], atol=2.5)


def test_clean_is_calm():
    assert (CLEAN.noise, CLEAN.push_interval, CLEAN.payload_high) == (0.0, 0.0, 0.0)
    assert CLEAN.friction_low == CLEAN.friction_high == 1.0
    env = make_env("walk")
    masses = [m.body_mass.sum() for m in env.simulation.models]
    assert masses[0] == masses[1] == pytest.approx(12.743448)


# --- episodes --------------------------------------------------------------------------


def test_time_limit_truncates_and_resets_in_the_same_step():
    env = make_env("walk", config=replace(CLEAN, episode_seconds=0.1))  # 5 steps
    actions = random_actions(5, 4)
    for k, action in enumerate(actions):
        obs, _, terminated, truncated, info = env.step(action)
        assert truncated.all() == (k == 4) and not terminated.any()
    assert (info["totals"]["length"] == 5).all()
    final = info["final_obs"]
    np.testing.assert_array_equal(final[:, SLICES["last_action"]], actions[-1].astype(np.float32))
    np.testing.assert_array_equal(obs[:, SLICES["last_action"]], 0.0)
    assert np.abs(final[:, SLICES["dof_vel"]]).max() > 0.1
    np.testing.assert_array_equal(obs[:, SLICES["dof_vel"]], 0.0)


def test_final_observation_equals_the_observation_elsewhere():
    env = make_env("walk", n=6, config=EnvConfig())
    stand(env, 2, 1.0, 5.0)  # one robot beside the lane
    obs, _, terminated, _, info = env.step(still(env))
    np.testing.assert_array_equal(terminated, np.arange(6) == 2)
    same = (obs == info["final_obs"]).all(axis=1)
    np.testing.assert_array_equal(same, ~terminated)


def test_a_masked_reset_leaves_the_other_robots_alone():
    env, twin = (make_env("walk", seed=5) for _ in range(2))
    for action in random_actions(20, 4):
        env.step(action)
        twin.step(action)
    mask = np.array([False, True, False, True])
    before = env._qpos.copy(), env._step_count.copy()
    obs, info = env.reset(mask=mask)
    np.testing.assert_array_equal(env._qpos[~mask], before[0][~mask])
    np.testing.assert_array_equal(env._step_count, np.where(mask, 0, before[1]))
    assert (np.abs(env._qpos[mask, 0] - 1.0) <= CLEAN.start_noise).all() and info == {}
    np.testing.assert_array_equal(obs[mask, SLICES["last_action"]], 0.0)
    after, expected = env.step(still(env))[0], twin.step(still(env))[0]
    np.testing.assert_array_equal(after[~mask], expected[~mask])
    assert (after[mask] != expected[mask]).any(axis=1).all()


def test_without_autoreset_a_finished_robot_waits_for_its_reset():
    env = make_env("walk", config=replace(CLEAN, episode_seconds=0.1), autoreset=False)
    for action in random_actions(5, 4):
        obs, _, _, truncated, info = env.step(action)
    assert truncated.all()
    np.testing.assert_array_equal(obs, info["final_obs"])
    np.testing.assert_array_equal(obs[:, SLICES["last_action"]], action.astype(np.float32))
    env.reset(mask=truncated)
    assert not env.step(still(env))[3].any()


def test_a_masked_reset_tells_how_far_the_episodes_came():
    env, told = make_env("walk"), []
    env.next_course = lambda ids, fraction: told.append((ids.tolist(), fraction)) or np.zeros(len(ids), int)
    env.waypoint_index[:] = [2, 4, 6, 8]
    env.reset(mask=np.array([False, True, False, True]))
    ((ids, fraction),) = told
    assert ids == [1, 3] and fraction.tolist() == [0.5, 1.0]


def test_action_repeat_keeps_the_time_limit():
    # 0.4 s are 20 control steps, or 10 decisions of two steps each
    env = make_env("walk", config=replace(CLEAN, episode_seconds=0.4, action_repeat=2))
    for k in range(10):
        _, _, _, truncated, _ = env.step(still(env))
        assert truncated.all() == (k == 9)


def test_episode_sums_are_those_of_the_steps():
    env = make_env("walk", config=replace(CLEAN, episode_seconds=0.1))
    total = np.zeros(4)
    for action in random_actions(5, 4):
        _, reward, _, _, info = env.step(action)
        total += reward
        np.testing.assert_allclose(info["totals"]["reward"], total, rtol=1e-12)
    _, reward, _, _, info = env.step(still(env))  # a new episode
    np.testing.assert_array_equal(info["totals"]["reward"], reward)
    assert (info["totals"]["length"] == 1).all()


def test_stalling_terminates_in_training_only():
    # Robots that stand on the start platform reach no waypoint: over after 0.1 s, 5 steps.
    env = make_env("walk", config=replace(CLEAN, stall_seconds=0.1))
    for k in range(10):
        _, _, terminated, _, _ = env.step(still(env))
        assert terminated.all() == (k % 5 == 4)
    assert EnvConfig().stall_seconds == 0.0 < TRAINING.stall_seconds


def test_a_waypoint_restarts_the_stall_clock():
    env = make_env("walk", config=replace(CLEAN, stall_seconds=0.2))  # 10 steps
    x, y = env.world.waypoints[0, 0]
    for k in range(20):
        if k == 3:  # robot 0 stays at its first waypoint from step 3 on: reached 5 steps later, after step 8
            stand(env, [0], x, y)
        _, _, terminated, _, _ = env.step(still(env))
        assert terminated[1] == (k in (9, 19))
        assert terminated[0] == (k == 17)


def test_turned_starts_face_anywhere():
    env = make_env("walk", n=400, config=replace(CLEAN, turned_start_share=0.5))
    yaw = env.yaw
    np.testing.assert_allclose(2 * np.arctan2(env._qpos[:, 6], env._qpos[:, 3]), yaw, atol=1e-9)
    # Half are uniform in +-pi, of which 0.1 / pi = 3 % lie in the +-0.1 rad of all others.
    assert 0.4 < (np.abs(yaw) > 0.1).mean() < 0.57
    assert yaw.min() < -2.5 and yaw.max() > 2.5
    assert (np.abs(make_env("walk", n=400).yaw) <= 0.1).all()


@pytest.mark.parametrize("kind", COURSE_KINDS)
def test_never_both_terminated_and_truncated(kind):
    # Robots are thrown about at the very step their time runs out.
    env = make_env(kind, n=16, config=replace(EnvConfig(), episode_seconds=0.3))
    ended = np.zeros(2, int)
    for k, action in enumerate(random_actions(60, 16, scale=3.0)):
        if k % 5 == 4:
            stand(env, k % 16, 1.0, 5.0)
        _, _, terminated, truncated, _ = env.step(action)
        assert not (terminated & truncated).any()
        ended += terminated.sum(), truncated.sum()
    assert (ended > 0).all()


def test_reset_follows_next_course():
    calls = []

    def next_course(ids, fraction):
        calls.append((ids.copy(), fraction))
        return np.ones(len(ids), int)

    world = World([make_course("walk", 0.0, 0), make_course("gap", 0.5, 0)])
    env = Go1Env(world, 3, CLEAN, next_course)
    assert calls[-1][1] is None and len(calls[-1][0]) == 3
    stand(env, 1, 1.0, 5.0)
    env.waypoint_index[1] = 2
    env.step(still(env))
    np.testing.assert_array_equal(calls[-1][0], [1])
    np.testing.assert_allclose(calls[-1][1], [2 / NUM_WAYPOINTS])
    assert (env.course == 1).all()


def test_infos_name_the_kind_of_course_that_was_played():
    world = World([make_course(kind, 0.5, 0) for kind in ("gap", "climb", "gap")])
    assert list(world.kinds) == ["gap", "climb", "gap"]
    env = Go1Env(world, 3, CLEAN, lambda ids, fraction: ids if fraction is None else np.ones(len(ids), int))
    stand(env, 0, 1.0, 5.0)  # falls, and goes on on the climb
    kinds = [env.step(still(env))[4]["kind"] for _ in range(2)]
    for kind in kinds:
        assert kind[1] != kind[2]
    assert kinds[0][0] == kinds[0][2] and kinds[1][0] == kinds[1][1]


@pytest.mark.parametrize("change, message", [
    ({"action_repeat": 0}, "action-repeat must be a number of at least 1, not 0"),
    ({"scandot_period": 0}, "scandot-period must be a number of at least 1, not 0"),
    ({"episode_seconds": 0.0}, "episode-seconds must be a number of at least 0.0001, not 0.0"),
    ({"noise": -0.5}, "noise must be a number of at least 0, not -0.5"),
    ({"noise": np.nan}, "noise must be a number of at least 0, not nan"),
    ({"push_interval": np.inf}, "push-interval must be a number of at least 0, not inf"),
    ({"command_low": 0.9, "command_high": 0.8}, "command-high must be a number of at least 0.9, not 0.8"),
    ({"friction_low": 0.7, "friction_high": 0.6}, "friction-high must be a number of at least 0.7, not 0.6"),
])  # fmt: skip
def test_a_task_that_cannot_be_run_is_refused(change, message):
    with pytest.raises(UserError) as refusal:
        EnvConfig(**change)
    assert str(refusal.value) == message


# --- waypoints -------------------------------------------------------------------------


def near_waypoint(env, offset=0.0):
    """Put all robots at their current waypoint, ``offset`` [m] beside it; step once."""
    index = np.minimum(env.waypoint_index, NUM_WAYPOINTS - 1)
    waypoint = env.world.waypoints[env.course, index]
    stand(env, slice(None), waypoint[:, 0], waypoint[:, 1] + offset, z=0.0)
    return env.step(still(env))


def test_waypoint_is_reached_after_a_tenth_of_a_second():
    env = make_env("gap")
    for expected in (0, 0, 0, 0, 1):  # 5 steps of 0.02 s
        *_, info = near_waypoint(env)
        assert (info["totals"]["waypoints"] == expected).all()


@pytest.mark.parametrize("offset, reached", [(0.18, 1), (0.22, 0)])
def test_waypoint_radius(offset, reached):
    env = make_env("gap")
    for _ in range(6):
        *_, info = near_waypoint(env, offset)
    assert (info["totals"]["waypoints"] == reached).all()


def test_leaving_restarts_the_clock():
    env = make_env("gap")
    for offset in (0.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0):
        *_, info = near_waypoint(env, offset)
    assert (info["totals"]["waypoints"] == 0).all()


def test_last_waypoint_truncates():
    env = make_env("gap")
    env.waypoint_index[:] = NUM_WAYPOINTS - 1
    for k in range(5):
        _, _, terminated, truncated, info = near_waypoint(env)
        assert truncated.all() == (k == 4) and not terminated.any()
    assert (info["totals"]["waypoints"] == NUM_WAYPOINTS).all()
    assert (env.waypoint_index == 0).all()  # reset in the same step


def test_robots_look_at_the_ground_in_turn():
    period = CLEAN.scandot_period
    env = make_env("gap", n=2 * period)
    before = env.reset(0)[0][:, SCANDOTS]
    looked = []
    for _ in range(period):
        after = env.step(still(env))[0][:, SCANDOTS]
        looked.append((after != before).any(axis=1))
        before = after
    np.testing.assert_array_equal(np.sum(looked, axis=0), 1)  # every robot once in a period ...
    np.testing.assert_array_equal(np.sum(looked, axis=1), 2)  # ... and equally many each step


def test_goal_turns_to_the_next_waypoint():
    env = make_env("walk", d=0.0)
    for _ in range(5):
        obs, *_ = near_waypoint(env)
    index = env.waypoint_index
    assert (index == 1).all()
    obs, *_ = env.step(still(env))  # the observation turns a control step later
    goal = env.world.waypoints[env.course, index] - env.base_pos[:, :2]
    np.testing.assert_allclose(
        obs[:, SLICES["heading_error"]][:, 0], wrap(np.arctan2(goal[:, 1], goal[:, 0]) - env.yaw), atol=1e-5
    )


# --- falling ---------------------------------------------------------------------------


def test_falling_into_a_pit_terminates():
    env = make_env("gap", n=1, d=1.0)
    pit = env.world.courses[0].obstacles[0]
    stand(env, 0, (pit.x0 + pit.x1) / 2, 0.0, z=-1.0)
    assert env.step(still(env))[2].all()


def test_leaping_over_a_pit_does_not():
    env = make_env("gap", n=1, d=1.0)
    pit = env.world.courses[0].obstacles[0]
    stand(env, 0, (pit.x0 + pit.x1) / 2, 0.0, z=0.05)
    assert not env.step(still(env))[2].any()


@pytest.mark.parametrize("x, y", [(1.0, 2.1), (1.0, -2.1), (-0.1, 0.0)])
def test_leaving_the_lane_terminates(x, y):
    env = make_env("walk", n=1)
    stand(env, 0, x, y)
    assert env.step(still(env))[2].all()


@pytest.mark.parametrize("tilt, fallen", [(1.2, False), (1.6, True)])
def test_tipping_over_terminates(tilt, fallen):
    env = make_env("walk", n=1)
    stand(env, 0, 1.0, 0.0, z=0.3)
    env._qpos[0, 3:7] = np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0  # rolled
    assert env.step(still(env))[2].all() == fallen


def beam_env():
    env = make_env("beam", n=1, d=1.0)
    beam = env.world.courses[0].obstacles[0]
    top = next(b for b in env.world.courses[0].boxes if b.walkable and b.x0 == beam.x0)
    return env, (beam.x0 + beam.x1) / 2, (top.y0 + top.y1) / 2


def test_standing_beside_a_beam_terminates():
    env, x, y = beam_env()
    stand(env, 0, x, y + 0.6, z=-0.2)
    assert env.step(still(env))[2].all()


def test_standing_on_a_beam_does_not():
    env, x, y = beam_env()
    stand(env, 0, x, y)
    assert not env.step(still(env))[2].any()


def test_two_feet_at_beam_height_are_enough():
    env, x, y = beam_env()
    stand(env, 0, x, y + 0.127)  # right feet on the beam, left feet beside it ...
    left = [10, 11, 12, 16, 17, 18]
    env._qpos[0, left] = [0.0, 0.45, -0.89] * 2  # ... reaching 0.12 m below its top
    assert not env.step(still(env))[2].any()
    feet = env.simulation.foot_pos[0, :, 2]
    assert (feet[[1, 3]] < -0.05).all() and (feet[[0, 2]] > 0.0).all()


def test_failed_simulations_are_ended(failing_batch):
    env = make_env("walk")
    env.simulation.batch = failing_batch(env.simulation.batch)
    obs, reward, terminated, _, info = env.step(still(env))
    np.testing.assert_array_equal(terminated, [False, False, True, False])
    assert np.isfinite(obs).all()
    assert reward[2] == 0.0 and all(term[2] == 0.0 for term in info["reward_terms"].values())
    assert reward[[0, 1, 3]].all()


def test_actions_are_offsets_from_the_home_pose():
    # q_target = home + 0.3 * action: 0.9 + 0.3 * 0.5 = 1.05 for the thigh of FR
    env, action = make_env(), np.zeros((4, ACTION_DIM))
    action[:, 1] = 0.5
    env.step(action)
    np.testing.assert_allclose(env.simulation.ctrl[:, :3], [[0.0, 1.05, -1.8]] * 4)


@pytest.mark.parametrize("kind, alive, idle", [("walk", True, False), ("gap", False, True)])
def test_rewards_know_the_level_course(kind, alive, idle):
    env = make_env(kind)
    for _ in range(50):  # landed, and standing
        *_, info = env.step(still(env))
    assert (info["reward_terms"]["alive"] > 0).all() == alive
    assert (info["reward_terms"]["standing"] < 0).all() == idle


def test_diverged_simulations_are_ended():
    # MuJoCo puts a state that blows up back to the start of the model and only warns.
    env = make_env("walk")
    env._qvel[2, 8] = 1e12
    obs, _, terminated, _, _ = env.step(still(env))
    np.testing.assert_array_equal(terminated, [False, False, True, False])
    assert np.isfinite(obs).all()
    assert not env.step(still(env))[2].any()


# --- edges and the oracle --------------------------------------------------------------


def settle_feet_at(env, x, steps=10):
    """Stand the front feet at x; return the feet counted on an edge after settling."""
    stand(env, 0, x - 0.1881, 0.0)
    for _ in range(steps):
        *_, info = env.step(still(env))
    return info["feet_on_edge"][0]


def test_feet_on_an_edge_are_counted():
    env = make_env("gap", n=1, d=1.0)
    edge = env.world.courses[0].obstacles[0].x0
    assert settle_feet_at(env, edge - 0.03) == 2
    assert settle_feet_at(env, edge - 0.20) == 0


def test_feet_in_the_air_violate_no_edge():
    env = make_env("gap", n=1, d=1.0)
    edge = env.world.courses[0].obstacles[0].x0
    stand(env, 0, edge - 0.03 - 0.1881, 0.0, z=0.03)  # 3 cm above it
    *_, info = env.step(still(env))
    assert not info["final_obs"][0, SLICES["foot_contact"]].any()
    assert info["feet_on_edge"][0] == 0


def test_feet_below_an_edge_do_not_violate_it():
    env = make_env("climb-up", n=1, d=1.0)
    riser = env.world.courses[0].obstacles[0].x0
    assert settle_feet_at(env, riser - 0.03) == 0  # the edge is 0.45 m above these feet
    assert env.foot_contact[0].all()


@pytest.mark.parametrize("kind, skill", [
    ("gap", "leap"), ("beam", "beam"), ("climb-up", "climb-up"), ("climb-down", "climb-down"), ("walk", "walk"),
])  # fmt: skip
def test_oracle_names_the_skill_under_the_robot(kind, skill):
    env = make_env(kind)
    obstacles = env.world.courses[0].obstacles
    env._qpos[:, 0] = obstacles[0].x0 if obstacles else 5.0
    assert SKILLS[env.oracle_skill()[0]] == skill
    env._qpos[:, 0] = 1.0
    assert SKILLS[env.oracle_skill()[0]] == "walk"


# --- what the rewards are given ---------------------------------------------------------------


@pytest.fixture
def states(monkeypatch):
    """List of the StepStates that compute_reward is called with."""
    seen = []

    def spy(state, weights):
        seen.append(state)
        return compute_reward(state, weights)

    monkeypatch.setattr("agility_ref.env.compute_reward", spy)
    return seen


def test_rewards_are_given_the_motion_of_the_trunk(states):
    env = make_env("climb-up")
    for action in random_actions(5, 4, scale=0.3):
        joints_before = env.simulation.qvel[:, 6:].copy()
        env.step(action)
    (s, q, v) = states[-1], env.simulation.qpos, env.simulation.qvel
    np.testing.assert_allclose(s.last_dof_vel, joints_before)
    np.testing.assert_allclose(s.dof_vel, v[:, 6:])
    np.testing.assert_allclose(s.base_ang_vel, v[:, 3:6])
    for n in range(4):
        to_goal = env.world.waypoints[env.course[n], 0] - q[n, :2]  # none is reached yet
        assert s.goal_velocity[n] == pytest.approx(v[n, :2] @ to_goal / np.linalg.norm(to_goal))
        assert s.speed[n] == pytest.approx(np.linalg.norm(v[n, :2]))
        w, x, y, z = q[n, 3:7]
        yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        assert s.heading_error[n] == pytest.approx(np.arctan2(to_goal[1], to_goal[0]) - yaw, abs=1e-6)


def test_rewards_are_given_the_forces_of_a_robot_at_rest(states):
    """Four feet carry the weight and rest on the ground; the motors' springs carry the rest."""
    env = make_env("gap")
    for _ in range(200):  # the trunk bobs for three seconds
        env.step(still(env))
    s, model = states[-1], env.simulation.models[0]
    weight = model.body_mass.sum() * 9.81
    np.testing.assert_allclose(s.foot_force[:, :, 2].sum(axis=1), weight, rtol=0.02)
    assert (np.abs(s.foot_force[:, :, :2]) < s.foot_force[:, :, 2:]).all()
    assert s.foot_contact.all() and not s.body_contact.any()
    np.testing.assert_allclose(s.foot_clearance, 0.0, atol=0.005)
    assert (s.foot_speed < 0.02).all()
    # PD control at rest: tau = kp (q_target - q)
    np.testing.assert_allclose(s.torque, env.config.physics.kp * (DEFAULT_DOF_POS - s.dof_pos), atol=0.02)


def test_rewards_are_given_moving_feet_in_the_air_and_a_trunk_on_the_ground(states):
    env = make_env("gap", n=2)
    stand(env, [0], 1.0, 0.0, z=0.3)  # falls freely, 0.3 m up
    env._qvel[0, 0] = 1.5
    stand(env, [1], 1.0, 0.0)
    env._qpos[1, 2] = 0.05  # the trunk's underside touches
    env.step(still(env))
    s = states[-1]
    assert not s.foot_contact[0].any() and s.body_contact[1].any() and not s.body_contact[0].any()
    np.testing.assert_allclose(s.foot_clearance[0], 0.3, atol=0.02)
    np.testing.assert_allclose(s.foot_speed[0], 1.5, atol=0.05)


# --- starts, conditions and pushes ----------------------------------------------------------


def test_a_push_replaces_the_horizontal_velocity():
    env = make_env(n=2, config=replace(CLEAN, push_interval=0.1, push_velocity=0.5))
    env.push_timer[:] = 1, 2
    stand(env, [0, 1], 1.0, 0.0, z=1.0)  # in free flight nothing else changes it
    env._qvel[:, 0] = 2.0
    env.step(still(env))
    pushed, flying = env._qvel[:, :2]
    assert (np.abs(pushed) <= 0.51).all() and flying[0] == pytest.approx(2.0, abs=0.05)
    assert env.push_timer.tolist() == [5, 1]


def test_first_pushes_are_spread_over_the_interval():
    env = make_env(n=200, config=EnvConfig(action_repeat=1))  # 6 s are 300 steps
    assert env.push_timer.min() >= 1 and env.push_timer.max() <= 300
    assert env.push_timer.min() < 30 and env.push_timer.max() > 270


def test_starts_are_perturbed():
    env = make_env(n=50)
    x, y = env.base_pos[:, :2].T
    joints = env.simulation.qpos[:, 7:] - DEFAULT_DOF_POS
    for values in (x - 1.0, y, env.yaw, *joints.T):
        assert np.abs(values).max() <= 0.1 + 1e-9 and values.std() > 0.03  # uniform: 0.058


def test_every_course_has_its_own_friction_and_payload():
    courses = [make_course("gap", 0.5, 0)] * 40
    env = Go1Env(World(courses), 1, EnvConfig(friction_low=0.5, friction_high=1.0, payload_high=2.0))
    mass = np.array([m.body("trunk").mass[0] for m in env.simulation.models])
    friction = np.array([m.geom_friction[m.geom_bodyid == 0, 0].max() for m in env.simulation.models])
    assert 0.0 <= np.ptp(mass) <= 2.0 and np.ptp(mass) > 1.5
    assert (friction >= 0.5).all() and (friction <= 1.0).all() and np.ptp(friction) > 0.35


def test_a_held_action_takes_its_time():
    """One step of two is two steps of one, without noise and pushes."""
    once, twice = make_env(config=replace(CLEAN, action_repeat=2)), make_env()
    action = random_actions(1, 4, scale=0.3)[0]
    once.step(action)
    twice.step(action)
    twice.step(action)
    np.testing.assert_allclose(once.simulation.qpos, twice.simulation.qpos, atol=1e-9)


def test_heading_errors_point_to_this_waypoint_and_the_next():
    env = make_env("beam", n=2)
    stand(env, [0, 1], 1.0, 0.5)
    env.step(still(env))
    for n in range(2):
        this, following = env.world.waypoints[env.course[n], :2] - env.base_pos[n, :2]
        expected = [np.arctan2(v[1], v[0]) - env.yaw[n] for v in (this, following)]
        np.testing.assert_allclose(env.heading_error[n], expected, atol=1e-6)


def test_the_last_waypoint_and_a_fall_at_once_is_a_finish():
    env = make_env(n=1)
    env.waypoint_index[:], env._reach_timer[:] = NUM_WAYPOINTS - 1, 4
    x, y = env.world.waypoints[0, -1]
    stand(env, [0], x, y, z=env.world.ground(0, np.array([x, y])))
    env._qpos[0, 3:7] = np.cos(0.8), np.sin(0.8), 0.0, 0.0  # rolled by 1.6 rad: fallen
    _, _, terminated, truncated, info = env.step(still(env))
    assert info["totals"]["waypoints"][0] == NUM_WAYPOINTS and truncated[0] and not terminated[0]


def test_edges_add_up_over_the_episode(monkeypatch):
    env = make_env("walk", n=2)
    monkeypatch.setattr(env, "_near_edge", lambda: np.tile([True, False, True, True], (2, 1)))
    for k in range(1, 4):
        *_, info = env.step(still(env))
        assert info["totals"]["edge"].tolist() == [3 * k, 3 * k]


def test_a_new_episode_begins_with_a_look():
    env = make_env("gap", n=1, d=1.0, config=replace(CLEAN, scandot_period=1000))
    first = env.reset(0)[0][:, SCANDOTS]
    pit = env.world.courses[0].obstacles[0]
    stand(env, 0, (pit.x0 + pit.x1) / 2, 0.0, z=-0.5)
    env._look(np.arange(1))
    observation, _, terminated, _, info = env.step(still(env))
    assert terminated.all() and np.ptp(info["final_obs"][0, SCANDOTS]) > 0.5
    np.testing.assert_allclose(observation[:, SCANDOTS], first, atol=1e-6)


@pytest.mark.parametrize("height, fallen", [(0.03, True), (0.09, False)])
def test_a_trunk_that_sinks_between_the_banks_has_fallen(height, fallen):
    env = make_env("gap", n=1, d=1.0)
    pit = env.world.courses[0].obstacles[0]
    stand(env, 0, (pit.x0 + pit.x1) / 2, 0.0)
    env._qpos[0, 2] = height
    assert env.step(still(env))[2].all() == fallen

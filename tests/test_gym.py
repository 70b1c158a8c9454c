"""The Gymnasium adapter, against Gymnasium's own checks, wrappers and SyncVectorEnv."""

import sys
import types
import warnings
from dataclasses import replace

import agility_ref

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", minversion="1.2")

import agility_ref.gym  # noqa: E402
from agility_ref.env import EnvConfig  # noqa: E402
from agility_ref.errors import UserError  # noqa: E402
from agility_ref.terrain import COURSE_KINDS, NUM_WAYPOINTS  # noqa: E402

MODES = gymnasium.vector.AutoresetMode
SHORT = EnvConfig(episode_seconds=0.2)  # 5 steps
# nothing is drawn: a robot of the batch meets what a robot alone meets
FIXED = replace(SHORT.clean(), start_noise=0.0, command_low=1.0, command_high=1.0)


def single(name="Climb", difficulty=0.3, courses=1, **options):
    return gymnasium.make(f"agility_ref.gym:Go1{name}-v0", difficulty=difficulty, courses=courses, **options)


def vector(num_envs=3, name="Walk", difficulty=0.3, courses=1, **options):
    return gymnasium.make_vec(
        f"agility_ref.gym:Go1{name}-v0", num_envs=num_envs, difficulty=difficulty, courses=courses, **options
    )


@pytest.fixture
def needs_gl():
    """Skip the test where no image can be rendered."""
    env = single(render_mode="rgb_array")
    env.reset(seed=0)
    try:
        env.render()
    except UserError as error:
        pytest.skip(str(error))
    finally:
        env.close()


@pytest.mark.parametrize("kind", COURSE_KINDS)
def test_every_kind_of_course_has_an_id(kind):
    name = "".join(part.capitalize() for part in kind.split("-"))
    env = single(name, difficulty=(0.2, 0.4), courses=3)
    world = env.unwrapped._one.go1.world
    assert (world.kinds == kind).all()
    np.testing.assert_allclose(world.difficulties, [0.2, 0.3, 0.4])
    assert env.reset(seed=0)[0] in env.observation_space


def test_gymnasiums_check_finds_nothing():
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(single().unwrapped, skip_render_check=True)


def test_gymnasiums_check_of_rendering_finds_nothing(needs_gl, viewer):
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(single(render_mode="rgb_array").unwrapped)


def test_the_check_of_stable_baselines3_finds_nothing():
    check_env = pytest.importorskip("stable_baselines3.common.env_checker").check_env
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(single().unwrapped)


def test_spaces_are_finite_and_an_action_of_one_is_the_limit():
    env = single(config=FIXED)
    assert np.isfinite(env.observation_space.low).all() and np.isfinite(env.observation_space.high).all()
    assert (env.action_space.low == -1).all() and (env.action_space.high == 1).all()
    env.reset(seed=0)
    env.step(np.ones(12, np.float32))
    go1 = env.unwrapped._one.go1
    home = go1.simulation.home[7:]
    np.testing.assert_allclose(go1.simulation.ctrl[0] - home, 4 * 0.3, rtol=1e-6)


def test_observations_stay_within_the_space():
    envs = vector(8, courses=4)
    obs, _ = envs.reset(seed=0)
    envs.action_space.seed(0)
    for _ in range(50):
        assert obs in envs.observation_space
        obs, *_ = envs.step(envs.action_space.sample())


def equal(ours, theirs, path="info"):
    assert type(ours) is type(theirs), path
    if isinstance(ours, dict):
        assert ours.keys() == theirs.keys(), path
        for key in ours:
            equal(ours[key], theirs[key], f"{path}[{key}]")
    else:
        assert ours.dtype == theirs.dtype, path
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(a, b, err_msg=path)


@pytest.mark.parametrize("mode", MODES)
def test_the_batch_does_what_gymnasium_does_with_single_environments(mode):
    """Every output of 14 steps, in which each robot ends two episodes and one falls early."""
    ours = vector(config=FIXED, autoreset_mode=mode)
    theirs = gymnasium.vector.SyncVectorEnv([lambda: single("Walk", config=FIXED)] * 3, autoreset_mode=mode)
    assert ours.metadata["autoreset_mode"] is mode
    assert ours.single_observation_space == theirs.single_observation_space
    assert ours.observation_space == theirs.observation_space and ours.action_space == theirs.action_space
    np.testing.assert_array_equal(ours.reset(seed=1)[0], theirs.reset(seed=1)[0])
    robots = [ours.go1, *(env.unwrapped._one.go1 for env in theirs.envs)]
    rng, ends = np.random.default_rng(0), 0
    for t in range(14):
        if t == 2:  # beside the lane
            robots[0].simulation.qpos[1, 1] = robots[2].simulation.qpos[0, 1] = 5.0
        actions = rng.uniform(-0.3, 0.3, (3, 12)).astype(np.float32)
        (*ours_out, ours_info), (*theirs_out, theirs_info) = ours.step(actions), theirs.step(actions)
        for a, b in zip(ours_out, theirs_out, strict=True):
            np.testing.assert_array_equal(a, b)
            assert a.dtype == b.dtype
        equal(ours_info, theirs_info)
        done = ours_out[2] | ours_out[3]
        ends += done.sum()
        if mode is MODES.DISABLED and done.any():
            with pytest.raises(ValueError, match="reset them"):
                ours.step(actions)
            reset = [envs.reset(options={"reset_mask": done.copy()})[0] for envs in (ours, theirs)]
            np.testing.assert_array_equal(*reset)
    assert ends >= 6


def test_success_is_every_waypoint_reached():
    envs = vector(2, autoreset_mode="SameStep")
    envs.reset(seed=0)
    envs.go1.waypoint_index[0] = NUM_WAYPOINTS
    _, _, terminated, truncated, info = envs.step(np.zeros((2, 12)))
    assert truncated.tolist() == [True, False] and not terminated.any()
    assert info["final_info"]["is_success"].tolist() == [True, False]
    assert info["_is_success"].tolist() == [False, True] and not info["is_success"].any()


def test_a_seed_repeats_an_episode_and_without_one_episodes_differ():
    envs = vector(2)
    first, again, other = (envs.reset(seed=seed)[0] for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    assert (vector(2).reset()[0] != vector(2).reset()[0]).any()


def test_courses_and_their_friction_follow_the_course_seed():
    a, b, c = (vector(2, courses=2, course_seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(a.reset(seed=0)[0], b.reset(seed=0)[0])
    assert a.go1.world.courses[0].boxes == b.go1.world.courses[0].boxes != c.go1.world.courses[0].boxes
    friction = [envs.go1.simulation.models[0].geom_friction[0, 0] for envs in (a, b, c)]
    assert friction[0] == friction[1] != friction[2]


def test_record_episode_statistics():
    for mode in (MODES.SAME_STEP, MODES.NEXT_STEP):
        envs = gymnasium.wrappers.vector.RecordEpisodeStatistics(vector(config=SHORT, autoreset_mode=mode))
        envs.reset(seed=0)
        total = np.zeros(3)
        for _ in range(5):
            _, reward, _, _, info = envs.step(np.zeros((3, 12)))
            total += reward
        assert info["episode"]["l"].tolist() == [5, 5, 5] and info["_episode"].all()
        np.testing.assert_allclose(info["episode"]["r"], total)
    env = gymnasium.wrappers.RecordEpisodeStatistics(single(config=SHORT))
    env.reset(seed=0)
    for _ in range(5):
        *_, info = env.step(np.zeros(12))
    assert info["episode"]["l"] == 5


def test_normalize_observation():
    envs = gymnasium.wrappers.vector.NormalizeObservation(vector(8))
    envs.reset(seed=0)
    envs.action_space.seed(0)
    seen = np.array([envs.step(envs.action_space.sample())[0] for _ in range(60)])[30:]
    assert seen.shape == (30, 8, 184) and np.isfinite(seen).all()
    assert abs(seen.mean()) < 0.2 and 0.5 < seen[:, :, :9].std() < 1.5
    env = gymnasium.wrappers.NormalizeObservation(single())
    assert env.reset(seed=0)[0].shape == (184,)


def test_record_video(needs_gl, tmp_path):
    pytest.importorskip("moviepy")
    env = single(config=SHORT, render_mode="rgb_array")
    env = gymnasium.wrappers.RecordVideo(env, tmp_path / "films", disable_logger=True)
    env.reset(seed=0)
    for _ in range(5):
        env.step(np.zeros(12))
    env.close()
    (film,) = tmp_path.glob("films/*.mp4")
    assert film.stat().st_size > 1000


def test_a_frame_shows_the_robot_where_it_is(needs_gl):
    envs = vector(2, "Climb", render_mode="rgb_array")
    envs.reset(seed=0)
    first = envs.render()
    assert len(first) == 2 and first[0].shape == (480, 640, 3) and first[0].dtype == np.uint8
    envs.go1.simulation.qpos[0, 0] += 1.5
    moved = envs.render()
    assert np.abs(moved[0].astype(int) - first[0]).mean() > 2
    np.testing.assert_array_equal(moved[1], first[1])
    envs.close()


@pytest.fixture
def viewer(monkeypatch):
    """Stand in for MuJoCo's viewer, which needs a display; returns the windows that were opened."""
    windows = []

    def launch_passive(model, data):
        window = types.SimpleNamespace(cam=types.SimpleNamespace(), data=data, frames=[], closed=False)
        window.sync = lambda: window.frames.append(data.qpos.copy())
        window.close = lambda: setattr(window, "closed", True)
        windows.append(window)
        return window

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setitem(sys.modules, "mujoco.viewer", types.SimpleNamespace(launch_passive=launch_passive))
    import mujoco

    monkeypatch.setattr(mujoco, "viewer", sys.modules["mujoco.viewer"], raising=False)
    return windows


def test_human_mode_shows_every_step(viewer):
    env = single(render_mode="human")
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.full(12, 0.1))
        expected = env.unwrapped._one.go1.simulation.qpos[0].copy()
    (window,) = viewer
    assert len(window.frames) == 4 and not window.closed
    np.testing.assert_array_equal(window.frames[-1], expected)
    env.close()
    assert window.closed


def test_human_mode_needs_a_display(monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(UserError, match="display"):
        single(render_mode="human").reset()


# --- bad input ------------------------------------------------------------------------


def one_line(error):
    assert "\n" not in str(error.value)


def test_an_unknown_id_is_named():
    with pytest.raises(gymnasium.error.NameNotFound, match="Go1Climb") as error:
        single("Clim")
    one_line(error)


@pytest.mark.parametrize("difficulty", [1.2, (-0.5, 1.0), (0.0, 2.0)])
def test_a_difficulty_out_of_range(difficulty):
    with pytest.raises(ValueError, match=r"outside \[-0.2, 1\]") as error:
        single(difficulty=difficulty, courses=2)
    one_line(error)


@pytest.mark.parametrize("action, kind", [
    (np.zeros(11), ValueError), (np.full(12, np.nan), UserError), (np.zeros((1, 12)), ValueError),
])  # fmt: skip
def test_actions_that_no_robot_can_take(action, kind):
    env = single().unwrapped
    env.reset(seed=0)
    with pytest.raises(kind, match="action has") as error:
        env.step(action)
    one_line(error)


@pytest.mark.parametrize("mask", [[True, False], np.ones(3, bool), np.zeros(2, bool), np.ones(2)])
def test_a_wrong_reset_mask(mask):
    envs = vector(2)
    envs.reset(seed=0)
    with pytest.raises(ValueError, match="reset_mask"):
        envs.reset(options={"reset_mask": mask})


def test_an_unknown_render_mode():
    with pytest.raises(UserError, match="rgb_array"):
        vector(1, render_mode="rgb")


def test_without_gymnasium_the_command_is_named(monkeypatch):
    import importlib

    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(UserError, match=r'pip install "agility-ref\[gym\]"') as error:
        importlib.reload(agility_ref.gym)
    one_line(error)

"""The examples run with the libraries that they are for, as those are installed."""

import importlib.util
import sys
from pathlib import Path

from agility_ref.env import EnvConfig

import numpy as np
import pytest

pytest.importorskip("gymnasium", minversion="1.2")

import gymnasium

EXAMPLES = Path(__file__).parent.parent / "examples"
LIBRARIES = {"sb3_ppo": "stable_baselines3", "cleanrl_ppo": "torch", "torchrl_ppo": "torchrl", "rllib_ppo": "ray.rllib"}


def example(name):
    """Import an example as a module; skip the test where its library is missing."""
    pytest.importorskip(LIBRARIES[name])
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def test_every_example_is_tested():
    assert {path.stem for path in EXAMPLES.glob("*.py")} == LIBRARIES.keys()


@pytest.mark.parametrize("name, sizes", [
    ("sb3_ppo", {"steps": 2000, "num_envs": 64}),
    ("cleanrl_ppo", {"total_timesteps": 2048, "num_envs": 64}),
    pytest.param("torchrl_ppo", {"steps": 2048, "num_envs": 64}, marks=pytest.mark.slow),
    pytest.param("rllib_ppo", {"steps": 2000, "num_envs": 32, "batch_size": 1024}, marks=pytest.mark.slow),
])  # fmt: skip
def test_a_few_thousand_steps(name, sizes, capsys):
    module = example(name)
    config = (module.Args if name == "cleanrl_ppo" else module.Config)(**sizes)
    reached = module.main(config)
    steps = int(capsys.readouterr().out.splitlines()[-1].split()[0])
    assert 0.0 <= reached <= 1.0 and 2000 <= steps < 4000


def make_vec(**config):
    return gymnasium.make_vec(
        "agility_ref.gym:Go1Walk-v0",
        3,
        difficulty=0.2,
        courses=1,
        config=EnvConfig(**config),
        autoreset_mode="SameStep",
    )


def test_stable_baselines3_learns_how_an_episode_ended():
    envs = example("sb3_ppo").Go1VecEnv(make_vec(episode_seconds=0.2))
    envs.seed(3)
    obs = envs.reset()
    twin = make_vec(episode_seconds=0.2)
    np.testing.assert_array_equal(obs, twin.reset(seed=3)[0])
    for t in range(5):
        if t == 2:  # beside the lane
            envs.envs.go1.simulation.qpos[1, 1] = twin.go1.simulation.qpos[1, 1] = 5.0
        obs, reward, done, infos = envs.step(np.zeros((3, 12)))
        expected = twin.step(np.zeros((3, 12)))
        np.testing.assert_array_equal(obs, expected[0])
        np.testing.assert_array_equal(reward, expected[1])
        np.testing.assert_array_equal(done, expected[2] | expected[3])
        assert [bool(info) for info in infos] == done.tolist()
        if t == 2:
            assert done.tolist() == [False, True, False] and not infos[1]["TimeLimit.truncated"]
            assert infos[1]["episode"]["l"] == 3
    assert done[[0, 2]].all() and infos[0]["TimeLimit.truncated"] and not infos[0]["is_success"]
    np.testing.assert_array_equal(infos[0]["terminal_observation"], expected[4]["final_obs"][0])
    assert infos[0]["episode"]["l"] == 5 and infos[0]["waypoints"] == 0.0
    envs.close()


def test_the_normaliser_of_the_single_file_is_that_of_all_it_has_seen():
    import torch

    agent = example("cleanrl_ppo").Agent(4, 2, 0.2)
    seen = torch.from_numpy(np.random.default_rng(0).normal(3.0, 2.0, (300, 4)).astype(np.float32))
    for batch in seen.split([1, 99, 200]):
        agent.update_normalizer(batch)
    normal = agent.normalize(seen)
    assert normal.mean(0).abs().max() < 1e-3 and (normal.std(0) - 1).abs().max() < 1e-2
    torch.testing.assert_close(agent.mean, seen.mean(0), rtol=1e-4, atol=1e-4)

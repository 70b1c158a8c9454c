import re
from dataclasses import asdict, replace

from agility_ref.env import EnvConfig
from agility_ref.errors import UserError
from agility_ref.ppo import PPOConfig
from agility_ref.selector import SelectorConfig, SupervisedConfig
from agility_ref.simulation import PhysicsConfig
from agility_ref.training.bank import as_flags
from agility_ref.training.distill import DistillConfig, FineTuneConfig
from agility_ref.training.limits import ABOVE_ZERO, AT_LEAST, AT_MOST, check_settings
from agility_ref.training.policies import POLICIES, find_policy
from agility_ref.training.runs import TrainConfig

import pytest

CONFIG = TrainConfig()
FLAGS = as_flags(asdict(CONFIG))


@pytest.mark.parametrize("name", POLICIES)
def test_the_defaults_are_within_the_limits(name):
    check_settings(find_policy(name), CONFIG)


@pytest.mark.parametrize("flag", [*AT_LEAST, *ABOVE_ZERO, *AT_MOST])
def test_limits_are_those_of_flags(flag):
    assert flag in FLAGS


def test_bounds_that_are_names_are_flags():
    assert all(bound in FLAGS for bound in AT_LEAST.values() if isinstance(bound, str))


@pytest.mark.parametrize("change, complaint", [
    ({"env": EnvConfig(physics=PhysicsConfig(substeps=0))}, "env.physics.substeps must be at least 1, got 0"),
    ({"env": EnvConfig(push_interval=-1.0)}, "env.push-interval must be at least 0, got -1"),
    ({"env": EnvConfig(command_low=1.0, command_high=0.5)}, "env.command-high must be at least 1.0, got 0.5"),
    ({"env": EnvConfig(command_low=0.0)}, "env.command-low must be above 0, got 0"),
    ({"ppo": PPOConfig(init_std=0.0)}, "ppo.init-std must be above 0, got 0"),
    ({"warm_std": float("nan")}, "warm-std must be a finite number, got nan"),
    ({"ppo": PPOConfig(ent_coef=float("inf"))}, "ppo.ent-coef must be a finite number, got inf"),
    ({"ppo": PPOConfig(gamma=2.0)}, "ppo.gamma must be at most 1, got 2"),
    ({"ppo": PPOConfig(hidden=(8, 0))}, "ppo.hidden must be at least 1, got 0"),
    ({"ppo": PPOConfig(learning_rate=-1.0)}, "ppo.learning-rate must be above 0, got -1"),
    ({"env": EnvConfig(stall_seconds=-1.0)}, "env.stall-seconds must be at least 0, got -1"),
    ({"env": EnvConfig(turned_start_share=2.0)}, "env.turned-start-share must be at most 1, got 2"),
    ({"seed": 2**64}, "seed must be at most"),
    ({"selector": SelectorConfig(decision_steps=0)}, "selector.decision-steps must be at least 1, got 0"),
    ({"selector": SelectorConfig(switch_cost=-0.1)}, "selector.switch-cost must be at least 0, got -0.1"),
    ({"selector": SelectorConfig(switch_cost=float("nan"))}, "selector.switch-cost"),
    ({"selector": SelectorConfig(ent_coef=-0.1)}, "selector.ent-coef must be at least 0, got -0.1"),
    ({"supervised": SupervisedConfig(hidden=(8, 0))}, "supervised.hidden must be at least 1, got 0"),
    ({"supervised": SupervisedConfig(learning_rate=-1.0)}, "supervised.learning-rate must be above 0, got -1"),
    ({"fine_tune": FineTuneConfig(critic_learning_rate=-5e-4)}, "fine-tune.critic-learning-rate must be at least 0"),
    ({"fine_tune": FineTuneConfig(learning_rate_min=1.0)}, "fine-tune.learning-rate-min must be at most 0.003, got 1"),
    ({"supervised": SupervisedConfig(dagger_rounds=-1)}, "supervised.dagger-rounds must be at least 0, got -1"),
    ({"distill": DistillConfig(dagger_rounds=-1)}, "distill.dagger-rounds must be at least 0, got -1"),
    ({"distill": DistillConfig(action_noise=float("nan"))}, "distill.action-noise"),
    ({"fine_tune": FineTuneConfig(critic_steps=-1)}, "fine-tune.critic-steps must be at least 0, got -1"),
])  # fmt: skip
def test_numbers_that_no_run_can_be_made_with(change, complaint):
    with pytest.raises(UserError, match=re.escape(complaint)):
        check_settings(find_policy("walk"), replace(CONFIG, **change))


def test_every_kind_of_course_needs_a_robot():
    with pytest.raises(UserError, match=r"ppo\.num-envs must be at least 5, got 4"):
        check_settings(find_policy("gen-5"), replace(CONFIG, ppo=PPOConfig(num_envs=4)))


def test_a_minibatch_needs_a_step():
    with pytest.raises(UserError, match=r"ppo\.num-minibatches must be at most 6, got 7"):
        check_settings(find_policy("walk"), replace(CONFIG, ppo=PPOConfig(num_envs=2, num_steps=3, num_minibatches=7)))

import numpy as np
import pytest

from agility_ref.evaluate import EvaluationConfig, evaluate, evaluation_env
from agility_ref.selector import Hierarchy, oracle_hierarchy
from agility_ref.task import EnvConfig
from agility_ref.terrain import SKILLS, make_course
from agility_ref.trace import Trace, play

SHORT = EnvConfig(episode_seconds=0.6)
FEW = EvaluationConfig(episodes=3, seed=1)


def trace_of(hierarchy, environment="climb-gap"):
    return play(hierarchy, evaluation_env(environment, FEW, SHORT), environment, FEW.seed)


@pytest.mark.parametrize("environment", ["climb-gap", "beam"])
def test_a_trace_is_the_evaluation_step_by_step(five_skills, environment):
    hierarchy = Hierarchy("leaper", tuple(five_skills.values()), lambda o, env: np.full(len(o), 3))
    trace, evaluation = trace_of(hierarchy, environment), evaluate(hierarchy, environment, FEW, SHORT)
    np.testing.assert_array_equal(trace.waypoint_fraction, evaluation.waypoint_fraction)
    steps = max(evaluation.episode_length)
    np.testing.assert_array_equal(trace.skill[:steps], evaluation.skill[:steps])
    np.testing.assert_array_equal(trace.oracle[:steps], evaluation.oracle[:steps])
    assert trace.courses == evaluation_env(environment, FEW).world.courses


def test_shapes_and_ends(five_skills):
    class Jump(Hierarchy):
        """Leaves the lane in the third step, on the first course only."""

        def act(self, observation, env):
            self.step = getattr(self, "step", 0) + 1
            if self.step == 3:
                env._qpos[0, 1] = 5.0
            return super().act(observation, env)

    trace = trace_of(Jump("jump", tuple(five_skills.values()), lambda o, env: np.full(len(o), 1)))
    assert trace.skill.shape == trace.oracle.shape == (30, 3)
    assert trace.position.shape == trace.velocity.shape == (30, 3, 3)
    np.testing.assert_array_equal(trace.skill[:, 0], [1] * 3 + [-1] * 27)
    assert not trace.wrong[3:, 0].any()  # nothing is wrong after the end
    assert trace.skills == tuple(SKILLS) and trace.dt == 0.02


def test_velocity_moves_the_position(five_skills):
    trace = trace_of(oracle_hierarchy("oracle", five_skills))
    moved = np.diff(trace.position[:10], axis=0) / trace.dt
    between = (trace.velocity[:9] + trace.velocity[1:10]) / 2
    np.testing.assert_allclose(moved[..., :2], between[..., :2], atol=0.4)  # contacts act between two steps
    assert np.corrcoef(moved[..., 0].ravel(), between[..., 0].ravel())[0, 1] > 0.8


def test_the_oracle_is_never_wrong(five_skills):
    assert not trace_of(oracle_hierarchy("oracle", five_skills)).wrong.any()


def test_spans_name_the_obstacles_of_each_course():
    courses = [make_course("gap", 0.5, 0), make_course("climb-gap", 0.5, 0), make_course("walk", 0.5, 0)]
    nothing = np.zeros((0, 3))
    trace = Trace("p", "mixed", SKILLS, 0.02, courses, nothing, nothing, nothing, nothing, np.zeros(3))
    leaps = trace.spans("leap")
    assert leaps.shape == (3, 6, 2)  # six gaps at most
    np.testing.assert_allclose(leaps[0], [(o.x0, o.x1) for o in courses[0].obstacles])
    np.testing.assert_array_equal(np.isfinite(leaps[:, :, 0]).sum(axis=1), [6, 2, 0])
    np.testing.assert_array_equal(np.isfinite(trace.spans("climb-up")[:, :, 0]).sum(axis=1), [0, 2, 0])
    assert trace.spans("beam").shape == (3, 0, 2)

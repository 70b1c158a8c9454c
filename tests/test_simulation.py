import numpy as np
import pytest

from agility_ref.go1 import DEFAULT_DOF_POS, PhysicsConfig
from agility_ref.simulation import Simulation
from agility_ref.terrain import make_course

CONDITIONS = [(1.0, 0.0), (0.6, 2.0)]  # friction, payload [kg]


@pytest.fixture
def simulation():
    courses = [make_course("walk", 0.5, 0), make_course("gap", 0.5, 1)]
    return Simulation(courses, 3, PhysicsConfig(), CONDITIONS, num_threads=1)


def start(simulation, ids, course):
    qpos = np.tile(simulation.home, (len(ids), 1))
    qpos[:, 0] = 1.0
    simulation.place(ids, course, qpos)
    simulation.ctrl[ids] = DEFAULT_DOF_POS


def test_each_course_has_its_friction_and_payload(simulation):
    light, heavy = simulation.models
    assert heavy.body_mass.sum() - light.body_mass.sum() == pytest.approx(2.0)
    assert set(light.geom_friction[:, 0]) != set(heavy.geom_friction[:, 0])


def test_a_robot_that_is_put_back_starts_as_if_nothing_had_been(simulation):
    everyone, course = np.arange(3), np.array([0, 1, 1])
    start(simulation, everyone, course)
    simulation.step(20)
    first = simulation.qpos.copy(), simulation.qvel.copy()
    simulation.ctrl[:] += 0.5
    simulation.step(20)
    assert np.abs(simulation.qpos - first[0]).max() > 0.01
    start(simulation, everyone, course)
    assert not simulation.qvel.any()
    simulation.step(20)
    np.testing.assert_array_equal(simulation.qpos, first[0])
    np.testing.assert_array_equal(simulation.qvel, first[1])


def test_robots_that_stay_are_not_disturbed(simulation):
    start(simulation, np.arange(3), np.array([0, 1, 1]))
    simulation.step(5)
    before = simulation.qpos.copy()
    start(simulation, np.array([1]), np.array([0]))
    np.testing.assert_array_equal(simulation.qpos[[0, 2]], before[[0, 2]])
    assert (simulation.qpos[1] != before[1]).any()


def test_failed_simulations_are_reported_and_counted(simulation, failing_batch):
    start(simulation, np.arange(3), np.array([0, 0, 0]))
    simulation.batch = failing_batch(simulation.batch)
    assert simulation.step(2).tolist() == [False, False, True]
    assert simulation.errors == 1


def test_diverged_simulations_are_reported_once(simulation):
    # MuJoCo puts a state that blows up back to the start of the model and only warns.
    start(simulation, np.arange(3), np.array([0, 0, 0]))
    simulation.qvel[1, 8] = 1e12
    assert simulation.step(2).tolist() == [False, True, False]
    assert simulation.errors == 1
    start(simulation, np.array([1]), np.array([0]))
    assert not simulation.step(2).any()

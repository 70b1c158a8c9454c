from agility_ref.errors import UserError
from agility_ref.go1 import DEFAULT_DOF_POS, PhysicsConfig, make_model
from agility_ref.simulation import Placement, Simulation, bounding_volumes
from agility_ref.terrain import COURSE_KINDS, make_course

import mujoco
import numpy as np
import pytest
from mujoco import batch

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


def test_failed_simulations_are_reported(simulation, failing_batch):
    start(simulation, np.arange(3), np.array([0, 0, 0]))
    simulation.batch = failing_batch(simulation.batch)
    assert simulation.step(2).tolist() == [False, False, True]


def test_diverged_simulations_are_reported_once(simulation):
    # MuJoCo puts a state that blows up back to the start of the model and only warns.
    start(simulation, np.arange(3), np.array([0, 0, 0]))
    simulation.qvel[1, 8] = 1e12
    assert simulation.step(2).tolist() == [False, True, False]
    start(simulation, np.array([1]), np.array([0]))
    assert not simulation.step(2).any()


@pytest.fixture(scope="module")
def models():
    courses = [make_course(kind, 0.7, seed) for seed, kind in enumerate(COURSE_KINDS)]
    num_boxes = max(len(course.boxes) for course in courses)
    return [
        make_model(course, num_boxes=num_boxes, friction=0.6 + 0.1 * k, payload=0.3 * k)
        for k, course in enumerate(courses)
    ]


def simulations(models):
    made = batch.Batch(models[0], len(models))
    made.reset(keyframe=0, stage=mujoco.mjtStage.mjSTAGE_NONE)
    return made


def run(made, steps=60):
    """Let the robots trot on the spot towards +x; return all states."""
    rng, ctrl, states = np.random.default_rng(0), made.bind("ctrl"), []
    made.bind("qvel")[:, 0] = 1.5
    for _ in range(steps):
        ctrl[:] = DEFAULT_DOF_POS + rng.normal(0.0, 0.3, ctrl.shape)
        made.step(nstep=2)
        states.append(made.state.copy())
    return np.array(states)


def test_same_bits_as_a_model_a_course(models):
    own, shared = simulations(models), simulations(models)
    own.set_models(models)
    Placement(shared, models).place(np.arange(len(models)), np.arange(len(models)))
    np.testing.assert_array_equal(run(own), run(shared))


def test_a_robot_can_move_to_another_course(models):
    own, shared = simulations(models), simulations(models)
    order = np.roll(np.arange(len(models)), 1)
    own.set_models([models[k] for k in order])
    placement = Placement(shared, models)
    placement.place(np.arange(len(models)), np.arange(len(models)))
    for robot in reversed(range(len(models))):
        placement.place(np.array([robot]), order[[robot]])
    np.testing.assert_array_equal(run(own), run(shared))


def test_one_course_needs_no_fields(models):
    assert Placement(simulations(models[:1]), models[:1])._fields == []


def test_the_compilers_own_tree_is_reproduced(models):
    for model in models:
        np.testing.assert_allclose(bounding_volumes(model, model), model.bvh_aabb, atol=1e-12)


def test_volumes_hold_everything_below_them(models):
    tree = models[0]
    first, count = tree.body_bvhadr[0], tree.body_bvhnum[0]
    for model in models:
        volumes = bounding_volumes(tree, model)[first : first + count]
        low, high = volumes[:, :3] - volumes[:, 3:], volumes[:, :3] + volumes[:, 3:]
        for node in range(count):
            geom, children = tree.bvh_nodeid[first + node], tree.bvh_child[first + node]
            below = [children] if geom < 0 else []
            for inner in below:
                assert (low[node] <= low[inner] + 1e-9).all() and (high[node] >= high[inner] - 1e-9).all()
            if geom >= 0:
                np.testing.assert_allclose(high[node] - low[node], 2 * model.geom_size[geom], atol=1e-9)
                np.testing.assert_allclose((high[node] + low[node]) / 2, model.geom_pos[geom], atol=1e-9)


def test_threads_can_be_set_from_outside(monkeypatch):
    asked, real = [], batch.Batch
    monkeypatch.setattr(batch, "Batch", lambda model, n, threads: asked.append(threads) or real(model, n, threads))
    for text in ("0", "2"):
        monkeypatch.setenv("AGILITY_REF_THREADS", text)
        Simulation([make_course("walk", 0.5, 0)], 1, PhysicsConfig(), CONDITIONS[:1])
    assert asked == [0, 2]
    for text in ("many", "-1", "", "99999999999"):
        monkeypatch.setenv("AGILITY_REF_THREADS", text)
        with pytest.raises(UserError, match="AGILITY_REF_THREADS"):
            Simulation([make_course("walk", 0.5, 0)], 1, PhysicsConfig(), CONDITIONS[:1])

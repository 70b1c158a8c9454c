from agility_ref.errors import UserError
from agility_ref.go1 import make_model
from agility_ref.pictures.mjcf import write_mjcf
from agility_ref.terrain import COURSE_KINDS, make_course

import mujoco
import numpy as np
import pytest


@pytest.fixture
def load(tmp_path):
    """Return a function that writes a course and reads it as anyone would."""

    def make(kind, d=0.5):
        write_mjcf(make_course(kind, d), tmp_path / "course.xml")
        assert [path.name for path in tmp_path.iterdir()] == ["course.xml"]
        return mujoco.MjModel.from_xml_path(str(tmp_path / "course.xml"))

    return make


@pytest.mark.parametrize("kind", COURSE_KINDS)
def test_the_file_has_what_a_viewer_shows(load, kind):
    model = load(kind)
    assert model.nlight == 1 and model.key("home").id == 0
    assert model.cam_mode[model.camera("track").id] == mujoco.mjtCamLight.mjCAMLIGHT_TRACK
    assert (model.geom_matid >= 0).all()
    assert {model.material(i).name for i in model.geom_matid} >= {"side", "shell", "leg_FR", "waypoint"}


@pytest.mark.parametrize("kind", ["climb", "beam"])
def test_the_robot_moves_as_the_one_that_policies_train_on(load, kind):
    ours, theirs = load(kind), make_model(make_course(kind, 0.5))
    states = []
    for model in (ours, theirs):
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        rng = np.random.default_rng(0)
        for _ in range(50):
            data.ctrl[:] = model.key_ctrl[0] + rng.uniform(-0.3, 0.3, 12)
            mujoco.mj_step(model, data, 2)
        states.append(data.qpos.copy())
    assert np.abs(states[1] - theirs.key_qpos[0]).max() > 0.1
    np.testing.assert_allclose(*states, atol=1e-3)  # the file rounds its numbers


def test_a_missing_folder(tmp_path):
    with pytest.raises(UserError, match="no folder"):
        write_mjcf(make_course("gap", 0.5), tmp_path / "nowhere" / "gap.xml")

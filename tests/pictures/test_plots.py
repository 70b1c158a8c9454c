import xml.etree.ElementTree as ElementTree
from pathlib import Path

from agility_ref.cli.main import PLOTS, main
from agility_ref.evaluate import EvaluationConfig
from agility_ref.go1 import FOOT_RADIUS, make_model
from agility_ref.pictures import gait, pictures, plots
from agility_ref.pictures.record import record
from agility_ref.pictures.scene import (
    LOOK_GROUP,
    Robot,
    draw_ground,
    find_edges,
    ground_along,
    make_scene,
    stretches,
    support_points,
    waypoint_heights,
)
from agility_ref.policy import Policy
from agility_ref.selector import Single, oracle_hierarchy
from agility_ref.stats import iqm
from agility_ref.terrain import COURSE_KINDS, make_course
from agility_ref.training import weights
from agility_ref.training.progress import read_progress
from agility_ref.world import height_map

import mujoco
import numpy as np
import pytest
from made import random_arrays
from PIL import Image

CONFIG = EvaluationConfig(difficulty=0.3)
COLUMNS = ("steps", "wall_seconds", "steps_per_second", "reward", "waypoint_fraction", "level")
SKILLS = ("walk", "climb-up", "climb-down", "leap", "beam")


@pytest.fixture(scope="module")
def bank():
    meta = {"act_dim": 12}
    return {
        name: Policy.from_arrays(random_arrays(k, gain=100.0), {"policy": name, **meta})
        for k, name in enumerate(SKILLS)
    }


@pytest.fixture(scope="module")
def single(bank):
    return record(Single("walk", bank["walk"]), "climb", CONFIG)[0]


@pytest.fixture(scope="module")
def hierarchical(bank):
    return record(oracle_hierarchy("oracle", bank), "climb-gap", CONFIG, (0, 1), 2)


def write_progress(folder: Path, offset=0.0, rows=40) -> Path:
    folder.mkdir(parents=True)
    path = folder / "progress.csv"
    lines = [",".join(COLUMNS)]
    for k in range(rows):
        values = dict.fromkeys(COLUMNS, 1.0) | {"steps": 1000 * (k + 1), "wall_seconds": 0.5 * k + 1}
        values |= {"reward": k + offset, "waypoint_fraction": k / rows, "level": k / rows}
        lines.append(",".join(str(values[name]) for name in COLUMNS))
    path.write_text("\n".join(lines) + "\n")
    return path


# --- the scene and its silhouettes --------------------------------------------------------


@pytest.mark.parametrize("kind", COURSE_KINDS)
def test_dressing_changes_nothing_that_moves(kind):
    """Same joints, masses, contacts: a recorded qpos can be replayed, and physics would agree."""
    course = make_course(kind, 0.6, 0)
    plain, dressed = make_model(course), make_scene(course)
    assert (plain.nq, plain.nv, plain.nu, plain.nbody) == (dressed.nq, dressed.nv, dressed.nu, dressed.nbody)
    assert np.array_equal(plain.jnt_qposadr, dressed.jnt_qposadr)
    assert np.allclose(plain.body_mass, dressed.body_mass)
    looks = dressed.geom_group == LOOK_GROUP
    assert looks.sum() > 50
    assert (dressed.geom_contype[looks] == 0).all() and (dressed.geom_conaffinity[looks] == 0).all()
    assert (~looks).sum() == plain.ngeom


def test_proportions_of_a_go1():
    """Unitree's data sheet: 0.645 x 0.28 x 0.40 m; our home pose crouches, knees to the rear."""
    model = make_scene(make_course("walk", 0.0, 0))
    data = mujoco.MjData(model)
    data.qpos[:] = model.key_qpos[0]
    mujoco.mj_kinematics(model, data)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for geom in np.flatnonzero((model.geom_group == LOOK_GROUP) & (model.geom_bodyid > 0)):
        rotation = data.geom_xmat[geom].reshape(3, 3)
        for axis in np.eye(3):
            for sign in (1, -1):
                local = support_points(model.geom_type[geom], model.geom_size[geom], sign * axis[None] @ rotation)
                point = (data.geom_xpos[geom] + local[0] @ rotation.T) * np.abs(axis)
                at = np.argmax(axis)
                low[at], high[at] = min(low[at], point[at]), max(high[at], point[at])
    length, width, height = high - low
    assert 0.60 < length < 0.70 and 0.24 < width < 0.36 and 0.33 < height < 0.42
    assert low[2] == pytest.approx(0.0, abs=0.005)  # the feet stand on the ground


def test_support_points_lie_on_the_shape():
    angle = np.linspace(0, 2 * np.pi, 7, endpoint=False) + 0.1
    d = np.column_stack([np.cos(angle), 0.3 * np.ones(7), np.sin(angle)])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    size = np.array([0.3, 0.2, 0.1])
    ellipsoid = support_points(mujoco.mjtGeom.mjGEOM_ELLIPSOID, size, d)
    assert np.allclose(((ellipsoid / size) ** 2).sum(axis=1), 1.0)
    box = support_points(mujoco.mjtGeom.mjGEOM_BOX, size, d)
    assert np.allclose(np.abs(box), size)
    # h(d) = max over the shape of d . p: no point of the capsule reaches farther
    capsule = support_points(mujoco.mjtGeom.mjGEOM_CAPSULE, size, d)
    assert np.allclose((capsule * d).sum(axis=1), size[0] + size[1] * np.abs(d[:, 2]))
    # of the cylinder likewise: radius times the part of d across its axis, half length times the part along it
    cylinder = support_points(mujoco.mjtGeom.mjGEOM_CYLINDER, size, d)
    across = np.hypot(d[:, 0], d[:, 1])
    assert np.allclose((cylinder * d).sum(axis=1), size[0] * across + size[1] * np.abs(d[:, 2]))


def test_silhouette_feet_are_where_the_recording_says(single):
    robot = Robot(single.course)
    t = len(single) // 2
    polygons, colours = robot.silhouettes(single.qpos[t])
    assert len(polygons) == len(colours) == len(robot.geoms)
    lowest = min(p[:, 1].min() for p in polygons)
    # foot_pos is the sites' at the start of the last physics step, 10 ms earlier
    assert lowest <= single.foot_pos[t, :, 2].min() - FOOT_RADIUS + 0.05


def test_edges_of_known_courses():
    gap = make_course("gap", 0.5, 0)
    edges = find_edges(height_map(gap))
    across = [e for e in edges if e.x0 == e.x1]
    assert len(across) == 12 and len(edges) == 12  # two banks of six gaps, across the lane
    assert all(e.top == 0.0 and e.y1 - e.y0 == pytest.approx(4.0) for e in across)
    assert find_edges(height_map(make_course("walk", 1.0, 0))) == []  # tiles differ by less
    beam = find_edges(height_map(make_course("beam", 0.5, 0)))
    assert sum(e.y0 == e.y1 for e in beam) == 12  # two sides of six beams


def test_waypoints_stand_on_the_ground():
    course = make_course("climb-up", 1.0, 0)
    assert waypoint_heights(course)[[0, 1, 6]] == pytest.approx([0.0, 0.45, 2.7])


# --- saving -------------------------------------------------------------------------------


def test_png_and_svg_carry_command_and_versions(tmp_path):
    figure, axes = plots.new_figure()
    axes[0, 0].plot([1, 2])
    png, svg = plots.save_figure(figure, tmp_path / "deep" / "x.png", "agility-ref plot x --d ½")
    with Image.open(png) as image:
        assert image.text["Description"] == "agility-ref plot x --d ½"
        assert "mujoco 4" in image.text["Software"]
        assert image.size[0] > 700
    text = svg.read_text()
    ElementTree.fromstring(text)
    assert "agility-ref plot x" in text and "agility_ref " in text
    assert sorted(p.name for p in png.parent.iterdir()) == ["x.png", "x.svg"]


def test_the_same_figure_is_the_same_file(tmp_path):
    def draw(name):
        figure, axes = plots.new_figure()
        axes[0, 0].plot([1, 2, 0])
        return [p.read_bytes() for p in plots.save_figure(figure, tmp_path / name / "x.png", "c")]

    assert draw("a") == draw("b")


# --- learning curves ----------------------------------------------------------------------


def test_band_is_iqm_and_covers_the_seeds():
    curves = np.array([[1.0, 2.0, np.nan], [2.0, 4.0, 5.0], [3.0, 9.0, 5.0]])
    middle, low, high = plots.band(curves)
    assert middle[:2] == pytest.approx([iqm([1, 2, 3]), iqm([2, 4, 9])])
    assert np.isnan([middle[2], low[2], high[2]]).all()
    assert (low[:2] >= [1, 2]).all() and (high[:2] <= [3, 9]).all() and (low[:2] < high[:2]).all()
    apart = plots.band(np.array([[1.0, np.nan], [np.nan, 2.0]]))  # no step that both seeds have
    assert np.isnan(apart).all()
    alone = plots.band(np.array([[1.0, 2.0]]))
    assert all(np.array_equal(part, [1.0, 2.0]) for part in alone)


def test_smooth_is_a_mean_over_the_window():
    steps = np.arange(5.0)
    assert plots.smooth(steps, steps**2, np.array([2.0, 9.0]), 2.0) == pytest.approx([14 / 3, np.nan], nan_ok=True)


def test_learning_curves_draw_every_seed_and_policy(tmp_path):
    found = {
        p: [read_progress(write_progress(tmp_path / p / f"seed{k}", k)) for k in range(2)] for p in ("leap", "gen-3")
    }
    point = {"steps": 40_000, "waypoint_fraction": 0.9, "reward": 30.0}
    figure = plots.learning_curves(found, {"leap": [point]})
    left = figure.axes[0]
    assert len(left.lines) == 2 * (2 + 1) + 1  # a thin line a seed, a bold one a policy, a diamond
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["leap, 2 seeds", "gen-3, 2 seeds"]
    assert left.child_axes and "wall time" in left.child_axes[0].get_xlabel()


def test_learning_curve_during_training(tmp_path):
    progress = write_progress(tmp_path / "run")
    assert plots.learning_curve(progress, tmp_path / "run" / "learning_curve.png", "leap")
    assert (tmp_path / "run" / "learning_curve.svg").exists()
    other = tmp_path / "other.csv"
    other.write_text("round,cross_entropy\n0,1.0\n")
    assert not plots.learning_curve(other, tmp_path / "no.png", "ps-sl-5")
    other.write_text("steps,reward\n")
    assert not plots.learning_curve(other, tmp_path / "no.png", "empty")
    assert not (tmp_path / "no.png").exists()


def test_one_row_of_progress_is_enough(tmp_path):
    progress = write_progress(tmp_path / "run", rows=1)
    assert plots.learning_curve(progress, tmp_path / "x.png", "leap")
    plots.save_figure(plots.learning_curves({"leap": [read_progress(progress)]}), tmp_path / "y.png", "c")


def test_learning_curves_show_the_level(tmp_path):
    figure = plots.learning_curves({"leap": [read_progress(write_progress(tmp_path / "leap" / "seed0"))]})
    labels = [axis.get_ylabel() for axis in figure.axes]
    assert labels == ["waypoint fraction, exploring", "level / top level", "return per episode"]


# --- pictures -----------------------------------------------------------------------------


def test_instants_are_regular_and_apart(single):
    chosen = pictures.instants(single, 0.5, 0.3)
    assert chosen[0] == 0
    xy = single.qpos[chosen, :2]
    assert (np.hypot(*np.diff(xy, axis=0).T)[:-1] >= 0.3).all()
    assert all(t % round(0.5 / single.dt) == 0 for t in chosen[:-1])


def test_strobe_draws_terrain_to_scale(single, tmp_path):
    figure = pictures.strobe(single)
    for axis in figure.axes:
        box = axis.get_position()
        width, height = box.width * figure.get_figwidth(), box.height * figure.get_figheight()
        x, z = np.ptp(axis.get_xlim()), np.ptp(axis.get_ylim())
        assert width / x == pytest.approx(height / z)
    plots.save_figure(figure, tmp_path / "x.png", "c")


def test_stretches_cover_the_array():
    assert stretches(np.array([3, 3, 1, 1, 1, 3])) == [(0, 2), (2, 5), (5, 6)]
    assert stretches(np.array([[0, 1], [0, 1], [0, 2]])) == [(0, 2), (2, 3)]
    assert stretches(np.array([7])) == [(0, 1)]


def test_beams_show_their_sides_and_steps_have_none():
    def area(kind):
        """Area of the sides that are drawn [m^2]."""
        course = make_course(kind, 0.5, 0)
        _, axes = plots.new_figure()
        draw_ground(axes[0, 0], ground_along(course, *course.waypoints.T), height_map(course), -1.0)
        x, y = axes[0, 0].collections[1].get_paths()[0].vertices.T
        return abs((x[:-1] * y[1:] - x[1:] * y[:-1]).sum()) / 2

    beams = make_course("beam", 0.5, 0).obstacles
    assert area("beam") == pytest.approx(0.2 * sum(o.x1 - o.x0 for o in beams))
    assert area("climb-up") == pytest.approx(0.0, abs=1e-9)


def test_violations_are_drawn_where_they_happened(single):
    from dataclasses import replace

    on_edge = np.zeros_like(single.foot_on_edge)
    on_edge[3, 2] = True
    figure = pictures.strobe(replace(single, foot_on_edge=on_edge))
    crosses = [line for line in figure.axes[0].lines if line.get_marker() == "x" and len(line.get_xdata())]
    assert len(crosses) == 1
    assert crosses[0].get_xdata()[0] == single.foot_pos[3, 2, 0]
    assert crosses[0].get_color() == pictures.VIOLATION


def test_oracle_map_has_a_lane_a_course_and_a_robot_an_episode(hierarchical, tmp_path):
    figure = pictures.oracle_map(hierarchical)
    assert len(figure.axes) == 2
    for axis in figure.axes:
        robots = [line for line in axis.lines if line.get_color() == pictures.ROBOT]
        assert len(robots) == 2
        assert "100 % of the choices are the oracle's" in axis.get_title(loc="left")
    plots.save_figure(figure, tmp_path / "x.png", "c")


@pytest.mark.parametrize("which", ["single", "hierarchical"])
def test_every_picture_of_every_kind_of_policy(which, request, tmp_path):
    episode = request.getfixturevalue(which)
    episode = episode if which == "single" else episode[0]
    for k, draw in enumerate((pictures.strobe, gait.episode_panel, lambda e: pictures.oracle_map([e]))):
        png, _ = plots.save_figure(draw(episode), tmp_path / f"{k}.png", "c")
        with Image.open(png) as image:
            assert len(np.unique(np.asarray(image.convert("L")))) > 20  # not blank


def test_panel_totals_are_the_rewards(single):
    figure = gait.episode_panel(single)
    texts = [t.get_text() for axis in figure.axes for t in axis.texts]
    for values in single.reward_terms.values():
        assert f"{values.sum():+.2f}" in texts


def test_gallery_names_its_dimensions():
    figure = pictures.course_gallery(("climb-up", "gap", "beam"))
    assert len(figure.axes) == 12
    texts = " ".join(t.get_text() for axis in figure.axes for t in axis.texts)
    for dimension in ("0.10 m", "0.45 m", "0.10 m wide", "0.80 m wide", "1.00 m\ndeep", "0.60 m", "0.12 m"):
        assert dimension in texts


# --- the command line ---------------------------------------------------------------------


@pytest.fixture
def trained(tmp_path, monkeypatch, finished_run):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("agility_ref.training.weights.shipped", lambda *key: None)
    for name in SKILLS:
        finished_run(tmp_path / "runs" / "full", name)
    return tmp_path


@pytest.mark.parametrize("command", [
    "strobe walk --environment gap --difficulty 0.2",
    "strobe oracle --environment climb-gap --period 1",
    "episode leap --environment gap --start 0 --seconds 1",
    "oracle-map oracle --environment beam --courses 1 --robots 2",
    "skills", "courses",
])  # fmt: skip
def test_plot_commands_write_what_they_print(trained, capsys, command):
    assert main(["plot", *command.split()]) == 0
    printed = capsys.readouterr().out.strip().split(", ")
    assert len(printed) == 2 and all((trained / name).is_file() for name in printed)
    with Image.open(trained / printed[0]) as image:
        assert image.text["Description"] == f"agility-ref plot {command}"


def test_a_picture_says_which_weights_act(trained, capsys):
    assert main(["plot", "strobe", "oracle", "--environment", "walk"]) == 0
    paths = [f"runs/full/{skill}/seed0/policy.npz" for skill in SKILLS]
    assert capsys.readouterr().err.splitlines() == [f"weights {path}" for path in paths]


def test_plot_curves_with_evaluation(trained, capsys):
    write_progress(trained / "more")
    folder = trained / "runs" / "full" / "leap" / "seed0"
    (trained / "more" / "progress.csv").rename(folder / "progress.csv")
    assert main(["plot", "curves", str(folder), "--evaluate", "gap", "--episodes", "2"]) == 0
    assert (trained / "curves.png").is_file()


def test_plot_curves_of_shipped_weights(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    files = [str(weights.FOLDER / weights.file_name("full", name, 0)) for name in ("walk", "gen-3")]
    drawn = []
    monkeypatch.setattr(plots, "learning_curves", lambda *args: drawn.append(args) or plots.new_figure()[0])
    assert main(["plot", "curves", *files]) == 0
    ((curves, points),) = drawn
    assert list(curves) == ["walk", "gen-3"] and points == {}
    assert curves["walk"][0]["steps"][-1] > 1_990_000 and "level" in curves["gen-3"][0]


@pytest.mark.parametrize("command, expected", [
    ("strob walk", ["strob", "strobe", "progress.csv"]),
    ("strobe walkk --environment gap", ["unknown policy 'walkk'", "walk"]),
    ("strobe walk --environment gaps", ["unknown environment 'gaps'", "gap"]),
    ("strobe walk --environment gap --course -1", ["courses", "-1"]),
    ("oracle-map walk --environment gap --robots 0", ["robots must be", "0"]),
    ("strobe walk --environment gap --period 0", ["period must be above 0, got 0.0"]),
    ("strobe walk --environment gap --period nan", ["period must be above 0, got nan"]),
    ("episode walk --environment gap --seconds 0", ["seconds must be above 0, got 0.0"]),
    ("episode walk --environment gap --start 50", ["start must lie within the episode, 0 to", "got 50"]),
    ("episode walk --environment gap --start -1", ["start must lie within the episode", "got -1"]),
    ("strobe walk --environment gap --out walk.pdf", [".png", "'walk.pdf'"]),
    ("courses --seed -1", ["seed must be a number of at least 0, not -1"]),
    ("courses --out runs/full/walk/seed0/policy.npz/x.png", ["policy.npz"]),
    ("curves", ["run folder"]),
    ("curves nowhere", ["nowhere", "progress.csv"]),
    ("curves runs/full/walk/seed0/policy.npz", ["policy.npz", "not shipped weights"]),
])  # fmt: skip
def test_bad_plots_are_one_line(trained, capsys, command, expected):
    assert main(["plot", *command.split()]) == 2
    out, err = capsys.readouterr()
    assert err.startswith("agility-ref: ") and err.count("\n") == 1 and out == ""
    assert all(text in err for text in expected), err


def test_plot_help_names_every_picture(capsys):
    assert main(["plot", "--help"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in PLOTS)

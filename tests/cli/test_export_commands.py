import os

from agility_ref.cli.main import main
from agility_ref.files import read_npz, write_npz

import mujoco
import numpy as np
import pytest


@pytest.fixture
def refuses(capsys, monkeypatch, tmp_path):
    """Return a function that runs a command and checks for one line and exit status 2."""
    monkeypatch.chdir(tmp_path)

    def check(command, *expected):
        assert main(command.split()) == 2
        out, err = capsys.readouterr()
        assert err.startswith("agility-ref: ") and err.count("\n") == 1 and out == "", err
        for text in expected:
            assert text in err

    return check


def test_export_of_a_run_by_name_and_by_file(finished_run, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    folder = finished_run(tmp_path / "runs", "walk", gain=1.0)
    assert main(["export", "walk", "--format", "npz", "--runs", "runs"]) == 0
    assert "wrote walk.npz: walk from runs/walk/seed0/policy.npz" in capsys.readouterr().out
    assert main(["export", str(folder / "policy.npz"), "--format", "npz", "--out", "b.npz"]) == 0
    with np.load("walk.npz") as a, np.load("b.npz") as b:
        for name in a.files:
            np.testing.assert_array_equal(a[name], b[name])


def test_a_file_does_not_say_where_its_export_goes(finished_run, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    path = finished_run(tmp_path / "runs", "walk") / "policy.npz"
    arrays, meta = read_npz(path)
    write_npz(
        path, arrays, {key: meta[key] for key in meta if key != "schema"} | {"policy": f"{tmp_path}/else/\x1bwhere"}
    )
    (tmp_path / "else").mkdir()
    assert main(["export", str(path), "--format", "npz"]) == 0
    assert not list((tmp_path / "else").iterdir()) and (tmp_path / "where.npz").exists()
    assert "\x1b" not in capsys.readouterr().out


def test_export_mjcf(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["export-mjcf", "--environment", "beam", "--difficulty", "0.2"]) == 0
    assert capsys.readouterr().out.startswith("wrote beam.xml;")
    assert mujoco.MjModel.from_xml_path("beam.xml").nu == 12


@pytest.mark.parametrize("command, expected", [
    ("export walkk", ["unknown policy 'walkk'", "walk"]),
    ("export walk --format onx", ["unknown format 'onx'", "onnx"]),
    ("export oracle", ["oracle has no network", "climb-up"]),
    ("export nowhere.npz", ["no checkpoint at nowhere.npz"]),
    ("export walk --preset quick --format npz --out no/where.npz", ["no folder no"]),
    ("export-mjcf --environment clim", ["unknown environment 'clim'", "climb"]),
    ("export-mjcf --difficulty 1.5", ["difficulty of climb is from -0.2 to 1, not 1.5"]),
    ("export-mjcf --out no/where.xml", ["no folder no"]),
])  # fmt: skip
def test_bad_input_is_one_line(refuses, command, expected):
    refuses(command, *expected)


def test_a_policy_is_not_overwritten_by_its_export(refuses, finished_run, tmp_path):
    path = finished_run(tmp_path / "runs", "walk") / "policy.npz"
    before = path.read_bytes()
    refuses(f"export {path} --format npz --out {path}", "the policy itself")
    assert path.read_bytes() == before


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
@pytest.mark.parametrize("command", ["export-mjcf --out locked/x.xml", "export walk --format npz --out locked/x.npz"])
def test_a_read_only_folder(refuses, tmp_path, command):
    (tmp_path / "locked").mkdir(mode=0o500)
    refuses(command, "Permission denied")

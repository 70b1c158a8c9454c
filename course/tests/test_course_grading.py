"""Whatever is handed in costs its own points only, and its row says what was wrong."""

import csv
import json
import zipfile
from xml.etree import ElementTree

from course.__main__ import main
from course.assignment import find
from course.release import release, starter

import pytest

CLAIMS = "hw6/claims.py"
IQM = "    ordered = np.sort(np.ravel(scores))\n"


def submission(folder, path=CLAIMS, before="", iqm=""):
    """Write the model solution of hw6 with something done at import, or in iqm."""
    release(find("hw6"), folder, solution=True)
    text = (folder / path).read_text(encoding="utf-8")
    text = text.replace("from collections.abc", before + "from collections.abc", 1)
    (folder / path).write_text(text.replace(IQM, iqm + IQM, 1), encoding="utf-8")


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return {row["student"]: row for row in csv.DictReader(file)}


def grade(tmp_path, *flags):
    assert main(["grade", "hw6", str(tmp_path / "in"), "--csv", str(tmp_path / "g.csv"), "--seeds", "9", *flags]) == 0
    return rows(tmp_path / "g.csv")


def test_what_cannot_be_run_is_named_and_never_executed(tmp_path):
    folder = tmp_path / "in"
    (folder / "empty").mkdir(parents=True)
    submission(folder / "syntax", before="def f(:\n")
    submission(folder / "missing", before="import no_such_package\n")
    submission(folder / "other")
    adapters = folder / "other" / "adapters.py"
    adapters.write_text(adapters.read_text().replace('"hw6"', '"hw2"') + "\nopen('executed', 'w')\n")
    (folder / "lost").mkdir()
    (folder / "lost" / "notes.txt").write_text("my laptop broke")
    submission(folder / "mangled")
    (folder / "mangled" / "hw6" / "__init__.py").unlink()
    (folder / "mangled" / "hw6" / "__init__.py").mkdir()
    with zipfile.ZipFile(folder / "climbs.zip", "w") as archive:
        archive.writestr("hw6/adapters.py", "ASSIGNMENT = 'hw6'\n")
        archive.writestr("../../out.py", "1\n")
    (folder / "torn.zip").write_bytes(b"PK\x03\x04 and nothing more")
    submission(folder / "good")
    found = grade(tmp_path)
    assert found.pop("good")["score"] == "100.0"
    notes = {student: row["note"] for student, row in found.items()}
    assert len(notes) == 8 and not any("\n" in note for note in notes.values())
    assert {float(row["score"]) for row in found.values()} == {0.0}
    assert notes["empty"] == "the submission is empty"
    assert "claims.py line" in notes["syntax"] and "invalid syntax" in notes["syntax"]
    assert "No module named 'no_such_package'" in notes["missing"]
    assert notes["other"] == "these are files of hw2, not of hw6"
    assert notes["lost"].startswith("no adapters.py among 1 files")
    assert "keep the layout" in notes["mangled"]
    assert notes["climbs"] == "the zip has a path that climbs out: ../../out.py"
    assert notes["torn"].startswith("not a zip that can be unpacked")
    assert not list(tmp_path.rglob("executed")) and not list(tmp_path.rglob("out.py"))


def test_what_misbehaves_costs_its_own_points_only(tmp_path):
    folder = tmp_path / "in"
    submission(
        folder / "a-deletes",
        iqm="    import os, shutil\n    shutil.rmtree(os.path.dirname(__file__), ignore_errors=True)\n",
    )
    submission(folder / "b-prints", iqm="    print('all work and no play\\n' * 1_000_000)\n")
    submission(folder / "c-dies", iqm="    import os\n    os._exit(7)\n")
    submission(folder / "d-hungry", iqm="    bytearray(10**12)\n")
    submission(folder / "e-exits", iqm="    exit()\n")
    submission(folder / "good")
    found = grade(tmp_path)
    assert found["good"]["score"] == "100.0" and found["good"]["note"] == ""
    assert found["a-deletes"]["score"] == "100.0", "only a copy was deleted"
    assert (folder / "a-deletes" / CLAIMS).exists()
    assert float(found["b-prints"]["score"]) >= 80
    assert found["c-dies"]["note"] == "the process ended with status 7"
    assert "MemoryError" in found["d-hungry"]["note"] and found["d-hungry"]["score"] == "80.0"
    assert "SystemExit" in found["e-exits"]["note"] and found["e-exits"]["score"] == "80.0"


def test_a_hanging_submission_is_stopped(tmp_path):
    submission(tmp_path / "in" / "hangs", before="while True:\n    pass\n")
    found = grade(tmp_path, "--seconds", "4")
    assert found["hangs"]["note"] == "stopped after 4 s" and float(found["hangs"]["score"]) == 0


def test_a_zip_alone_gets_all_three_files(tmp_path):
    submission(tmp_path / "anna" / "my homework", iqm="    return 1\n")
    with zipfile.ZipFile(tmp_path / "anna.zip", "w") as archive:
        for path in (tmp_path / "anna").rglob("*.py"):
            archive.write(path, path.relative_to(tmp_path / "anna"))
    names = {flag: str(tmp_path / f"out{flag}") for flag in ("--csv", "--junit", "--gradescope")}
    assert main(["grade", "hw6", str(tmp_path / "anna.zip"), "--seeds", "9", *sum(names.items(), ())]) == 0
    row = rows(tmp_path / "out--csv")["anna"]
    assert row["score"] == "80.0" and row["test_iqm_by_hand"] == "0.0"
    results = json.loads((tmp_path / "out--gradescope").read_text())
    assert results["score"] == 80 and results["tests"][0]["name"] == "test_iqm_by_hand"
    assert "the middle half of 0 ... 7 is 2, 3, 4, 5" in results["tests"][0]["output"]
    suite = ElementTree.parse(tmp_path / "out--junit").getroot().find("testsuite")
    assert suite.get("name") == "pytest" and int(suite.get("failures")) == 2


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["grade", "hw9", "."], "unknown assignment 'hw9'"),
        (["grade", "hw6", "nowhere"], "nowhere does not exist"),
        (["grade", "hw6", "bare"], "bare holds no submission"),
        (["release", "hw6", "--out", "full"], "full exists already"),
    ],
)
def test_mistakes_of_the_instructor_are_one_line(arguments, says, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bare").mkdir()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.py").touch()
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1


def test_a_mark_without_its_partner_is_refused():
    with pytest.raises(ValueError, match="END SOLUTION without its partner"):
        starter("x = 1\n### END SOLUTION\n")
    with pytest.raises(ValueError, match="BEGIN SOLUTION without its partner"):
        starter("### BEGIN SOLUTION\n### BEGIN SOLUTION\n")
    with pytest.raises(ValueError, match="BEGIN SOLUTION without its partner"):
        starter("### BEGIN SOLUTION\n")

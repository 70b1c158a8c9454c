import os

from agility_ref.errors import UserError
from agility_ref.files import (
    MAX_TEXT,
    parse_json,
    read_csv,
    read_json,
    read_text,
    remove_partials,
    replacing,
    write_csv,
    write_text,
)

import pytest


def test_a_file_is_replaced_as_a_whole(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "old")
    with replacing(path, "w") as file:
        file.write("new")
        file.flush()
        assert path.read_text() == "old" and len(list(tmp_path.iterdir())) == 2
    assert path.read_text() == "new" and list(tmp_path.iterdir()) == [path]


def test_a_file_that_fails_leaves_what_was_there(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "old")
    with pytest.raises(ZeroDivisionError), replacing(path, "w") as file:
        file.write(str(1 / 0))
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


def test_two_writers_of_one_file_have_temporary_names_of_their_own(tmp_path):
    path = tmp_path / "a.txt"
    with replacing(path, "w") as first:
        with replacing(path, "w") as second:
            second.write("second")
        first.write("first")
    assert path.read_text() == "first" and list(tmp_path.iterdir()) == [path]


def test_others_may_read_what_is_written(tmp_path):
    umask = os.umask(0o022)
    write_text(tmp_path / "a.txt", "a")
    os.umask(umask)
    assert (tmp_path / "a.txt").stat().st_mode & 0o777 == 0o644


def test_what_a_dead_process_left_is_removed_and_nothing_else(tmp_path):
    for name in ("policy.npz", "policy.12-ab.partial.npz", "notes.partial.txt"):
        (tmp_path / name).touch()
    remove_partials(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"policy.npz", "notes.partial.txt"}


def test_text_is_bounded_and_utf8(tmp_path):
    path = tmp_path / "a.txt"
    with open(path, "wb") as file:
        file.truncate(MAX_TEXT + 1)
    with pytest.raises(UserError, match="longer than 64 MB"):
        read_text(path)
    path.write_bytes(b"ab\xff")
    with pytest.raises(UserError, match=r"not UTF-8 text \(invalid start byte at byte 2\)"):
        read_text(path)
    with pytest.raises(UserError, match="no file at"):
        read_text(tmp_path)


@pytest.mark.parametrize("text", [
    "", "[1]", "null", '{"a": NaN}', '{"a": -Infinity}', '{"a": 1e999}', '{"a": 1' + "0" * 30 + "}", '{"a": ' + "[" * 100_000,
    '{"a": ' + "9" * 10_000 + "}",
])  # fmt: skip
def test_json_is_one_object_of_finite_numbers(tmp_path, text):
    with pytest.raises(ValueError):
        parse_json(text)
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(UserError, match=r"a\.json is damaged"):
        read_json(tmp_path / "a.json")


def test_json_is_read(tmp_path):
    (tmp_path / "a.json").write_text('{"a": [1, 2.5e3, "x", null, true], "b": {}}')
    assert read_json(tmp_path / "a.json") == {"a": [1, 2500.0, "x", None, True], "b": {}}


def test_a_table_is_read_as_it_was_written(tmp_path):
    rows = [{"a": "1", "b": "x, y"}, {"a": "2", "b": 'said "so"'}]
    write_csv(tmp_path / "a.csv", rows)
    assert read_csv(tmp_path / "a.csv", ("b",)) == rows


@pytest.mark.parametrize(
    "text, kept", [("a,b\n1,2\n3,4\n", 2), ("a,b\n1,2\n3,4", 1), ("a,b\n1,2\n3,", 1), ("a,b\n", 0), ("a,b", 0), ("", 0)]
)
def test_a_row_without_its_end_is_left_out(tmp_path, text, kept):
    (tmp_path / "a.csv").write_text(text)
    assert len(read_csv(tmp_path / "a.csv")) == kept


@pytest.mark.parametrize(
    "text", ["a,b\n1\n", "a,b\n1,2,3\n", "a,a\n1,2\n", "a,c\n1,2\n", 'a,b\n"1,2\n', 'a,b\n"1"x,2\n']
)
def test_a_damaged_table_is_named(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(UserError, match=r"a\.csv is damaged"):
        read_csv(tmp_path / "a.csv", ("a", "b"))

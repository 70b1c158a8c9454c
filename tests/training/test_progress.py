import io

from agility_ref.errors import UserError
from agility_ref.training.progress import EPISODE, PROGRESS, ProgressLog, attempt, read_progress

import numpy as np
import pytest


def a_log(folder, episodes=(), done=0):
    return ProgressLog("walk", folder, [], np.reshape(episodes, (-1, len(EPISODE))), done, 1000, 2, quiet=True)


def test_averages_go_on_where_they_were(tmp_path):
    """10 new episodes among 190 of before: the oldest ten have left the last 200."""
    log = a_log(tmp_path, [[9.0, 1, 0, 0.0]] * 10 + [[2.0, 100, 4, 25.0]] * 190)
    episode = {"reward": 0.0, "length": 50, "waypoints": 8, "edge": 0.0}
    log.add(dict.fromkeys(PROGRESS, 0.0) | {"steps": 96, "episodes": [episode] * 10}, 0.0, 0.0, {})
    figures = {key: float(value) for key, value in log.rows[-1].items()}
    assert figures["reward"] == pytest.approx(1.9)  # (190 2 + 10 0) / 200
    assert figures["episode_length"] == pytest.approx(195)  # 2 (190 100 + 10 50) / 200
    assert figures["waypoint_fraction"] == pytest.approx(0.525)  # (190 4 + 10 8) / 200 / 8
    assert figures["edge_violation"] == pytest.approx(23.75 / 97.5, rel=1e-5)  # 25 feet an episode, 190 of 200
    np.testing.assert_array_equal(log.last_episodes()[[0, -1]], [[2, 100, 4, 25], [0, 50, 8, 0]])


def test_the_bar_of_a_warm_start_begins_where_it_left_off(tmp_path):
    assert a_log(tmp_path, done=500).bar.n == 500


@pytest.mark.parametrize("stream", [None, io.StringIO()])
def test_without_a_terminal_there_is_no_bar(tmp_path, monkeypatch, stream):
    monkeypatch.setattr("sys.stderr", stream)
    assert ProgressLog("walk", tmp_path, [], np.zeros((0, 4)), 0, 1000, 2, quiet=False).bar.disable


@pytest.mark.parametrize(
    "text", ["a,b\n1\n3,4\n", "a,b\n1,2,3\n", "a,b\n1,x\n", "a,b\n1,\n", "a,b\n1,inf\n", "a,b\n1,nan\n"]
)
def test_a_damaged_progress_is_named(tmp_path, text):
    (tmp_path / "progress.csv").write_text(text)
    with pytest.raises(UserError, match=r"progress\.csv is damaged"):
        read_progress(tmp_path / "progress.csv")


def test_a_picture_that_fails_is_a_warning(capsys):
    assert attempt(lambda data, out: None, "rows", "a.png") and not capsys.readouterr().err
    assert not attempt(lambda data, out: 1 / 0, "rows", "a.png")
    assert capsys.readouterr().err == "warning: no a.png: ZeroDivisionError: division by zero\n"

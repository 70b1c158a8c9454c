import csv
import math

import numpy as np
import pytest

from agility_ref import table1
from agility_ref.evaluate import METRICS, Evaluation, EvaluationConfig
from agility_ref.policies import TABLE_ROWS
from agility_ref.runs import TrainConfig
from agility_ref.table1 import ENVIRONMENT_LABELS, PAPER_LABELS, format_value, markdown, paper_cells, summarise, text

OURS = {
    "reward": (1.0, 2.0), "episode_length": (300.4, 50.0),
    "waypoint_fraction": (0.5, 0.25), "edge_violation": (0.011, 0.2),
}  # fmt: skip


@pytest.fixture
def cells():
    """The paper's cells with one of ours filled in."""
    cells = paper_cells()
    cells["Gap", "Leap"]["ours"] = OURS
    return cells


def evaluation(policy="walk", environment="gap", n=2, **metrics):
    values = {m: np.asarray(metrics.get(m, np.zeros(n)), float) for m in METRICS}
    return Evaluation(policy, environment, EvaluationConfig(episodes=n), **values, fell=np.zeros(n, bool),
                      difficulty=np.zeros(n), skill=None, oracle=None)  # fmt: skip


# --- the paper's figures ---------------------------------------------------------------


def test_43_cells():
    cells = paper_cells()
    assert len(cells) == 43
    missing = [(e, p) for e in ENVIRONMENT_LABELS.values() for p in PAPER_LABELS.values() if (e, p) not in cells]
    assert missing == [("Beam", "Climb")]


def test_every_cell_has_a_row_and_a_column():
    for environment, policy in paper_cells():
        assert environment in ENVIRONMENT_LABELS.values()
        assert policy in [PAPER_LABELS[name] for name in TABLE_ROWS]


def test_known_cells():
    cells = paper_cells()
    assert cells["Climb", "Climb"]["paper"]["waypoint_fraction"] == (0.99, 0.07)
    assert cells["Gap", "PS-SL-5"]["paper"]["reward"] == (20.82, 7.25)
    assert cells["Climb+Gap", "CD"]["paper"]["edge_violation"] == (1.09, 0.59)


def test_dashes_are_nan():
    cells = paper_cells()
    assert all(math.isnan(x) for x in cells["Beam", "PS-RL-3"]["paper"]["reward"])
    assert all(math.isnan(x) for x in cells["Gap", "Oracle"]["paper"]["edge_violation"])
    dashes = [m for c in cells.values() for m, v in c["paper"].items() if math.isnan(v[0])]
    # the three hierarchies have no edge violation on any of four terrains, and one reward is missing
    assert sorted(dashes) == ["edge_violation"] * 12 + ["reward"]


def test_nothing_of_ours_is_in_the_paper():
    assert all(cell["ours"] is None for cell in paper_cells().values())


# --- summary ---------------------------------------------------------------------------


def test_summarise_pools_the_episodes_of_all_seeds():
    pooled = summarise([evaluation(reward=[1.0, 3.0]), evaluation(reward=[5.0, 7.0])])
    # mean 4; deviations -3 -1 1 3: sqrt((9 + 1 + 1 + 9) / 4) = sqrt 5
    assert pooled["reward"] == pytest.approx((4.0, 5**0.5))
    assert set(pooled) == set(METRICS)


# --- output ----------------------------------------------------------------------------


@pytest.mark.parametrize("value, metric, printed", [
    ((1.234, 0.5), "reward", "1.23 ± 0.50"),
    ((300.4, 50.0), "episode_length", "300 ± 50"),
    ((0.5, 0.25), "waypoint_fraction", "0.50 ± 0.25"),
    (None, "reward", "-"),
    ((math.nan, math.nan), "edge_violation", "-"),
])  # fmt: skip
def test_format_value(value, metric, printed):
    assert format_value(value, metric) == printed


def test_markdown_has_a_row_a_cell(cells):
    lines = markdown(cells).splitlines()
    assert len(lines) == 2 + 43
    assert len({line.count("|") for line in lines}) == 1
    leap = next(line for line in lines if line.startswith("| Gap | Leap |"))
    assert "1.00 ± 2.00 | 17.78 ± 9.36" in leap
    assert "0.50 ± 0.25 | 0.86 ± 0.18" in leap


def test_text_has_a_line_a_cell(cells):
    lines = text(cells).splitlines()
    assert len(lines) == 1 + 43
    assert sum("Climb+Gap" in line for line in lines) == 1  # named once, above its block


def test_csv_of_filled_and_missing_cells(cells, tmp_path):
    table1.write_csv(cells, tmp_path / "table1.csv")
    rows = {(r["environment"], r["policy"]): r for r in csv.DictReader(open(tmp_path / "table1.csv"))}
    assert len(rows) == 43
    assert float(rows["Gap", "Leap"]["reward_mean_ours"]) == 1.0
    assert float(rows["Gap", "Leap"]["waypoint_fraction_std_paper"]) == 0.18
    assert rows["Gap", "CU"]["reward_mean_ours"] == ""
    assert rows["Beam", "PS-RL-3"]["reward_mean_paper"] == ""


def test_write_all(cells, tmp_path):
    paths = table1.write_all(cells, tmp_path / "new" / "folder", "A title")
    assert [p.name for p in paths] == ["table1.csv", "table1.md", "table1.png"]
    assert paths[1].read_text().startswith("# A title\n")
    assert paths[2].read_bytes().startswith(b"\x89PNG")


# --- computing -------------------------------------------------------------------------


def test_compute_without_weights_says_what_is_missing(tmp_path, monkeypatch):
    monkeypatch.setattr("agility_ref.weights.shipped", lambda *key: None)
    cells, missing = table1.compute(EvaluationConfig(episodes=1), TrainConfig(out=str(tmp_path)))
    assert all(cell["ours"] is None for cell in cells.values())
    assert len(missing) == len(set(missing)) > 0
    assert all("agility-ref train" in line for line in missing)


def test_compute_fills_the_cells_that_have_weights(tmp_path, monkeypatch, finished_run):
    monkeypatch.setattr("agility_ref.weights.shipped", lambda *key: None)
    monkeypatch.setattr(table1, "evaluate", lambda policy, environment, config: evaluation(policy.name, environment))
    for name in ("walk", "climb"):
        finished_run(tmp_path, name)
    seen = []
    cells, _ = table1.compute(
        EvaluationConfig(episodes=2), TrainConfig(out=str(tmp_path)), lambda *cell: seen.append(cell)
    )
    filled = {key for key, cell in cells.items() if cell["ours"]}
    assert filled == {(e, "Walk") for e in ENVIRONMENT_LABELS.values()} | {
        (e, "Climb") for e in ENVIRONMENT_LABELS.values() if e != "Beam"
    }
    assert len(seen) == 7

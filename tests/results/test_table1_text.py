import csv
import math
import re

from agility_ref.evaluate import METRICS, EvaluationConfig
from agility_ref.results.table1 import (
    NOTES,
    Row,
    Summary,
    csv_line,
    format_value,
    latex,
    markdown,
    paper_cells,
    table_rows,
    text,
    title,
    write_all,
)

import pytest

OURS = Summary(
    mean_std={"reward": (1.0, 2.0), "episode_length": (300.4, 50.0),
              "waypoint_fraction": (0.5, 0.25), "edge_violation": (0.011, 0.2)},
    iqm={"reward": (1.5, -0.5, 2.5), "episode_length": (310.0, 300.0, 320.0),
         "waypoint_fraction": (0.52, 0.41, 0.63), "edge_violation": (0.01, 0.0, 0.02)},
    success=(0.25, 0.1, 0.4), steps=4_560_000, seeds=(0, 2),
)  # fmt: skip
PUBLISHED = Summary(OURS.mean_std, {}, None, 1_000_000, (0,))


def fill(ours):
    """The table with ours filled in for Leap and the two selectors on Gap."""
    filled = ("Leap", "PS-RL-3 (env)", "PS-RL-3 (oracle)")
    return [
        Row(r.environment, r.policy, r.paper, ours if r.environment == "Gap" and r.policy in filled else None)
        for r in table_rows({})
    ]


@pytest.fixture
def rows():
    return fill(OURS)


@pytest.mark.parametrize("value, metric, printed", [
    ((1.234, 0.5), "reward", "1.23 ± 0.50"),
    ((300.4, 50.0), "episode_length", "300 ± 50"),
    ((0.5, 0.25), "waypoint_fraction", "0.50 ± 0.25"),
    (None, "reward", "-"),
    ((math.nan, math.nan), "edge_violation", "-"),
])  # fmt: skip
def test_format_value(value, metric, printed):
    assert format_value(value, metric) == printed


@pytest.mark.parametrize("config, expected", [
    (EvaluationConfig(), "Table 1, preset full, 64 episodes per cell, training seeds 0, 2"),
    (EvaluationConfig(256, protocol="as-published"),
     "Table 1, preset full, 256 robots per cell, counted as-published, training seeds 0, 2"),
    (EvaluationConfig(8, preset="quick", difficulty=0.3, clean=True),
     "Table 1, preset quick, 8 episodes per cell, difficulty 0.3, without noise and pushes, training seeds 0, 2"),
])  # fmt: skip
def test_title(rows, config, expected):
    assert title(config, rows) == expected


def test_title_without_weights():
    assert title(EvaluationConfig(), fill(None)) == "Table 1, preset full, 64 episodes per cell"


def test_markdown_has_a_line_a_row_in_both_tables(rows):
    lines = markdown(rows).splitlines()
    for start, columns in ((0, 8), (lines.index("## How sure") + 2, 7)):
        table = lines[start : start + 2 + 59]
        assert all(line.startswith("|") and line.count("|") == columns + 3 for line in table)
    found = [line for line in lines if line.startswith("| Gap | Leap |")]
    assert "1.00 ± 2.00 | 17.78 ± 9.36" in found[0] and "0.50 ± 0.25 | 0.86 ± 0.18" in found[0]
    assert "1.50 [-0.50, 2.50] | 310 [300, 320] | 0.52 [0.41, 0.63]" in found[1]
    assert found[1].endswith("| 0.25 [0.10, 0.40] | 4.6 M | 0, 2 |")
    assert sum(line.startswith("| Gap | CU | - | 5.38 ± 2.48 |") for line in lines) == 1


def test_text_has_a_line_a_row(rows):
    lines = text(rows).splitlines()
    assert len(lines) == 1 + 59 + 2 + 1 + 59
    assert sum("Climb+Gap" in line for line in lines) == 2  # named once, above its block
    assert len({len(line) for line in lines[:52]}) == 1 and len({len(line) for line in lines[-52:]}) == 1


def test_as_published_has_one_table():
    rows = fill(PUBLISHED)
    assert len(text(rows).splitlines()) == 1 + 59
    assert "How sure" not in markdown(rows)
    assert latex(rows, "x").count(r"\begin{table*}") == 1


def test_csv_of_filled_and_missing_rows(rows, tmp_path):
    write_all(rows, tmp_path, "t")
    with open(tmp_path / "table1.csv", newline="") as file:
        read = {(r["environment"], r["policy"]): r for r in csv.DictReader(file)}
    assert len(read) == 59
    leap = read["Gap", "Leap"]
    assert float(leap["reward_mean_ours"]) == 1.0 and float(leap["waypoint_fraction_std_paper"]) == 0.18
    assert [float(leap[f"reward_{k}"]) for k in ("iqm", "low", "high")] == [1.5, -0.5, 2.5]
    assert [float(leap[f"success_{k}"]) for k in ("rate", "low", "high")] == [0.25, 0.1, 0.4]
    assert leap["steps"] == "4560000" and leap["seeds"] == "0 2"
    assert read["Gap", "CU"]["reward_mean_ours"] == read["Gap", "CU"]["steps"] == ""
    assert read["Beam", "PS-RL-3"]["reward_mean_paper"] == ""
    assert read["Gap", "PS-RL-3 (env)"]["reward_mean_paper"] == ""


def test_csv_holds_all_of_the_papers_figures(rows):
    figures = {(r.environment, r.policy): csv_line(r) for r in rows if r.paper}
    for key, paper in paper_cells().items():
        for m in METRICS:
            for k, value in zip(("mean", "std"), paper[m], strict=True):
                printed = figures[key][f"{m}_{k}_paper"]
                assert printed == "" if math.isnan(value) else float(printed) == value


# --- LaTeX -----------------------------------------------------------------------------


def tabulars(source):
    return re.findall(r"\\begin\{tabular\}\{(\w+)\}\n(.*?)\\end\{tabular\}", source, re.S)


@pytest.mark.parametrize("ours, tables", [(OURS, 2), (PUBLISHED, 1), (None, 1)])
def test_latex_is_well_formed(ours, tables):
    source = latex(fill(ours), "100 % of_it & {more} #1 $")
    plain = re.sub(r"%.*", "", re.sub(r"\\[\\&%$#_{}]", "", source))  # without escapes and comments
    depth = 0
    for character in plain:
        depth += {"{": 1, "}": -1}.get(character, 0)
        assert depth >= 0
    assert depth == 0 and plain.count("$") % 2 == 0
    # every environment that begins ends, in order
    stack = []
    for word, name in re.findall(r"\\(begin|end)\{([a-z*]+)\}", source):
        if word == "begin":
            stack.append(name)
        else:
            assert stack.pop() == name
    assert stack == []
    assert source.isascii()
    # commands of LaTeX itself and of booktabs
    known = {
        "begin", "end", "centering", "caption", "label", "scriptsize", "setlength", "tabcolsep", "toprule", "midrule",
        "bottomrule", "cmidrule", "multicolumn", "pm", "usepackage",
    }  # fmt: skip
    assert set(re.findall(r"\\([a-z]+)", source)) <= known
    assert len(tabulars(source)) == tables


def test_latex_rows_have_as_many_columns_as_the_table(rows):
    for columns, body in tabulars(latex(rows, "c")):
        lines = [line for line in body.splitlines() if line.endswith(r"\\")]
        assert len(lines) >= 52
        for line in lines:
            spans = sum(int(k) - 1 for k in re.findall(r"\\multicolumn\{(\d)\}", line))
            assert len(re.findall(r"(?<!\\)&", line)) + 1 + spans == len(columns)
        assert body.count(r"\midrule") == 4  # below the heads, and between four terrains


def test_latex_holds_the_figures(rows):
    source = latex(rows, "c")
    assert r"Gap & Leap & $1.00 \pm 2.00$ & $17.78 \pm 9.36$ & $300 \pm 50$ & $549 \pm 255$" in source
    assert r"$1.50 [-0.50, 2.50]$ & $310 [300, 320]$ & $0.52 [0.41, 0.63]$" in source
    assert r"$0.25 [0.10, 0.40]$ & $4.6$ M & $0, 2$ \\" in source and r"\% WP" in source
    assert r"Gap & PS-RL-3 (env) & $1.00 \pm 2.00$ & -- &" in source


# --- files -----------------------------------------------------------------------------


@pytest.mark.parametrize("ours", [OURS, PUBLISHED, None])
def test_write_all(ours, tmp_path):
    paths = write_all(fill(ours), tmp_path / "new" / "folder", "A title")
    assert [p.name for p in paths] == ["table1.csv", "table1.md", "table1.tex", "table1.png"]
    assert paths[1].read_text().startswith("# A title\n")
    assert paths[2].read_text().startswith("% Needs \\usepackage{booktabs}.\n\\begin{table*}")
    assert paths[3].read_bytes().startswith(b"\x89PNG")
    assert not list(paths[0].parent.glob("*.partial*"))


def test_every_note_is_used(rows):
    page = markdown(rows)
    assert all(note in page for note in NOTES)

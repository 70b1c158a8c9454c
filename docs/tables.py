"""Write the tables that stand in the pages but are made from files:  python docs/tables.py

README.md         the waypoints, from docs/full/table1.csv (a copy of what ``make table1`` writes into results/)
docs/cluster.md   costs and training times, from agility_ref/weights/manifest.json
docs/tutorials.md the scripts and their titles, from tutorials/

Each stands between a begin and an end mark.  The tests hold the pages to the files.
"""

import csv
import re
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "workflow"))

import costs  # noqa: E402

POLICIES = ("Walk", "Climb", "Leap", "Beam", "Oracle", "PS-RL-3", "PS-SL-5", "GEN-3", "GEN-5", "Distilled")


def cell(row: dict | None, ours: str, paper: str) -> str:
    """Return ours and, in brackets, the paper's figure; "-" where there is no row."""
    if row is None or not row[ours]:
        return "-"
    return f"{float(row[ours]):.2f}" + (f" ({float(row[paper]):.2f})" if row[paper] else "")


def waypoint_table(path: Path = ROOT / "docs" / "full" / "table1.csv") -> str:
    """Return the waypoint fractions of a table1.csv as Markdown: one line per terrain, one column per policy."""
    with path.open(newline="") as file:
        rows = {(row["environment"], row["policy"]): row for row in csv.DictReader(file)}
    lines = ["| waypoints | " + " | ".join(POLICIES) + " |", "|---" * (len(POLICIES) + 1) + "|"]
    for terrain in dict.fromkeys(terrain for terrain, _ in rows):
        columns = ("waypoint_fraction_mean_ours", "waypoint_fraction_mean_paper")
        cells = [cell(rows.get((terrain, policy)), *columns) for policy in POLICIES]
        lines.append(f"| {terrain} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def tutorial_table() -> str:
    """Return the tutorials with their titles as Markdown, in their order."""
    lines = ["| script | what it is about |", "|---|---|"]
    for script in sorted((ROOT / "tutorials").glob("[0-9]*.py")):
        title = re.search(r"^# # (.+)$", script.read_text(encoding="utf-8"), re.M)[1]
        lines.append(f"| `python tutorials/{script.name}` | {title} |")
    return "\n".join(lines) + "\n"


TABLES = (  # page, mark, what stands there
    ("README.md", "results", waypoint_table),
    ("docs/cluster.md", "costs", costs.cost_table),
    ("docs/cluster.md", "minutes", costs.minutes_table),
    ("docs/tutorials.md", "tutorials", tutorial_table),
)


def with_table(text: str, mark: str, table: str) -> str:
    """Return the text with the table between its begin and end marks."""
    return re.sub(rf"(<!-- {mark}:begin.*?-->\n).*?(<!-- {mark}:end -->)", rf"\g<1>{table}\g<2>", text, flags=re.S)


if __name__ == "__main__":
    for name, mark, make in TABLES:
        page = ROOT / name
        page.write_text(with_table(page.read_text(encoding="utf-8"), mark, make()), encoding="utf-8")

"""Write the table of results in README.md from docs/full/table1.csv:  python docs/tables.py.

``make table1`` makes that CSV (in ``results/``, from where it is copied here); a test holds the README to it.
"""

import csv
import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
POLICIES = ("Walk", "Climb", "Leap", "Beam", "Oracle", "PS-RL-3", "PS-SL-5", "GEN-3", "GEN-5", "Distilled")


def cell(row: dict | None, ours: str, paper: str) -> str:
    """Return ours and, in brackets, the paper's figure; "-" where there is no row."""
    if row is None or not row[ours]:
        return "-"
    return f"{float(row[ours]):.2f}" + (f" ({float(row[paper]):.2f})" if row[paper] else "")


def waypoint_table(path: Path) -> str:
    """Return the waypoint fractions of a table1.csv as a Markdown table: one line per terrain, one column per policy."""
    with path.open(newline="") as file:
        rows = {(row["environment"], row["policy"]): row for row in csv.DictReader(file)}
    lines = ["| waypoints | " + " | ".join(POLICIES) + " |", "|---" * (len(POLICIES) + 1) + "|"]
    for terrain in dict.fromkeys(terrain for terrain, _ in rows):
        columns = ("waypoint_fraction_mean_ours", "waypoint_fraction_mean_paper")
        cells = [cell(rows.get((terrain, policy)), *columns) for policy in POLICIES]
        lines.append(f"| {terrain} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def with_table(text: str, table: str) -> str:
    """Return the text with the table between its results:begin and results:end marks."""
    return re.sub(r"(<!-- results:begin.*?-->\n).*?(<!-- results:end -->)", rf"\g<1>{table}\g<2>", text, flags=re.S)


if __name__ == "__main__":
    readme = ROOT / "README.md"
    readme.write_text(with_table(readme.read_text(), waypoint_table(ROOT / "docs" / "full" / "table1.csv")))

import configparser
import importlib.util
import re
from pathlib import Path

from agility_ref.observation import OBSERVATION, observation_slices
from agility_ref.rewards import TERMS, RewardConfig

import pytest
from test_layout import CORE

ROOT = Path(__file__).parent.parent
PAGES = ["README.md", "benchmarks/README.md", *(f"docs/{p.name}" for p in (ROOT / "docs").glob("*.md"))]


def test_observation_table_is_that_of_the_code():
    table = (ROOT / "docs" / "environment.md").read_text()
    rows = re.findall(r"^\| (\d+) \| (\d+) \| `(\w+)` \| (\d+) \| ([\d.]+) \|", table, re.M)
    documented = [(int(a), int(b), name, int(size), float(noise)) for a, b, name, size, noise in rows]
    assert documented == [(part.start, part.stop, n, *OBSERVATION[n]) for n, part in observation_slices().items()]


def test_reward_table_is_that_of_the_code():
    table = (ROOT / "docs" / "environment.md").read_text().partition("<!-- rewards:begin")[2]
    rows = re.findall(r"^\| `(\w+)` \| (\S+) \| \S+ \| (.+) \|$", table, re.M)
    assert {name: float(weight) for name, weight, _ in rows} == vars(RewardConfig())
    for name, _, formula in rows:
        assert formula.replace("&#124;", "|") == TERMS[name].__doc__.splitlines()[0].rstrip(".")


@pytest.mark.parametrize("page", PAGES)
def test_files_that_the_pages_link_to_exist(page):
    path = ROOT / page
    for target in re.findall(r"\]\(([^)#:]+)\)", path.read_text()):
        assert (path.parent / target).exists(), f"{page} links to {target}"


@pytest.mark.parametrize("page", PAGES)
def test_tables_are_whole(page):
    """Every block of rows has a header, a ruler and as many cells in all rows: a blank line within breaks a table."""
    for block in re.findall(r"(?:^\|.*\n)+", (ROOT / page).read_text() + "\n", re.M):
        header, ruler, *rows = [len(re.findall(r"(?<!\\)\|", line)) for line in block.splitlines()]
        assert re.fullmatch(r"[-| :]+", block.splitlines()[1]) and {header, *rows} == {ruler}, block[:200]


def test_the_reading_order_is_the_core():
    names = re.findall(r"^\| `(\w+)\.py` \|", (ROOT / "README.md").read_text(), re.M)
    assert tuple(names) == CORE


def test_the_table_of_the_readme_is_that_of_the_csv():
    spec = importlib.util.spec_from_file_location("tables", ROOT / "docs" / "tables.py")
    tables = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tables)
    readme = (ROOT / "README.md").read_text()
    table = tables.waypoint_table(ROOT / "docs" / "full" / "table1.csv")
    assert table.count("\n") == 2 + 4 and tables.with_table(readme, table) == readme


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 150


def test_every_extra_has_its_line():
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg")
    table = (ROOT / "docs" / "installation.md").read_text().partition("<!-- extras:begin")[2]
    assert set(setup["options.extras_require"]) <= set(re.findall(r"^\| `(\w+)` \|", table, re.M))

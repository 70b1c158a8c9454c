import configparser
import importlib.util
import pydoc
import re
import shlex
from pathlib import Path

from agility_ref.cli.main import parse
from agility_ref.errors import UserError
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


def test_the_lock_has_a_hash_for_every_version_that_is_pinned():
    """requirements.lock is for the core and the tests; it holds no address, and agrees with constraints.txt."""
    lines = [line for line in (ROOT / "requirements.lock").read_text().splitlines() if not line.startswith("#")]
    locked = dict(re.fullmatch(r"([a-z0-9-]+)==(\S+) --hash=sha256:[0-9a-f]{64}", line).groups() for line in lines)
    pinned = dict(re.findall(r"^([a-z0-9-]+)==(\S+)$", (ROOT / "constraints.txt").read_text(), re.M))
    metadata = configparser.ConfigParser()
    metadata.read(ROOT / "setup.cfg")
    wanted = metadata["options"]["install_requires"] + "\n" + metadata["options.extras_require"]["test"]
    for name in re.findall(r"^\s*([a-z0-9-]+)>=", wanted, re.M):
        assert locked[name].partition("+")[0] == pinned[name]
    assert all(locked[name].partition("+")[0] == pinned[name] for name in locked.keys() & pinned)


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


def test_tables_made_from_files_are_up_to_date():
    """Else: python docs/tables.py"""
    spec = importlib.util.spec_from_file_location("tables", ROOT / "docs" / "tables.py")
    tables = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tables)
    for page, mark, make in tables.TABLES:
        text, table = (ROOT / page).read_text(), make()
        assert table in text and tables.with_table(text, mark, table) == text, (page, mark)


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 150


def test_every_extra_has_its_line():
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg")
    table = (ROOT / "docs" / "installation.md").read_text().partition("<!-- extras:begin")[2]
    assert set(setup["options.extras_require"]) <= set(re.findall(r"^\| `(\w+)` \|", table, re.M))


def test_the_core_brings_in_six_packages():
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg")
    required = re.findall(r"^[\w-]+", setup["options"]["install_requires"], re.M)
    page = (ROOT / "docs" / "installation.md").read_text()
    assert len(required) == 6 and f"brings in six others: {', '.join(required[:-1])} and {required[-1]}." in page


@pytest.mark.parametrize("page", PAGES)
def test_names_of_the_package_that_the_pages_quote_exist(page):
    for name in re.findall(r"`(agility_ref\.[\w.]+)`", (ROOT / page).read_text()):
        assert pydoc.locate(name) is not None, f"{page} names {name}"


def test_a_link_that_leads_nowhere_is_found(tmp_path):
    spec = importlib.util.spec_from_file_location("links", ROOT / "docs" / "links.py")
    links = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(links)
    (tmp_path / "b.html").write_text("<p id='here'></p>")
    (tmp_path / "a.html").write_text(
        "<a href='b.html#here'></a><a href='b.html#there'></a><a href='c.html'></a><img src='d.png'>"
        "<a href='#nowhere'></a><a href='https://example.org/x'></a>"
    )
    assert links.broken_links(tmp_path) == [
        f"a.html links to {target}" for target in ("#nowhere", "b.html#there", "c.html", "d.png")
    ]


def commands_of(page):
    """Return what a page tells the reader to type, from blocks and from running text."""
    text = (ROOT / page).read_text().replace("\\\n", " ")
    blocks = [line for block in re.findall(r"^```\n(.*?)^```", text, re.M | re.S) for line in block.splitlines()]
    inline = re.findall(r"`(agility-ref [^`]+)`", re.sub(r"^```.*?^```", "", text, flags=re.M | re.S))
    found = [re.sub(r"^\.venv/bin/", "", line) for line in (*blocks, *inline)]
    found = [re.sub(r"--seed K\b", "--seed 0", line) for line in found if re.match(r"agility-ref \S+ \S", line)]
    found = [re.sub(r" [>|&;].*", "", line) for line in found]  # what the shell does with it
    return [shlex.split(line, comments=True)[1:] for line in found]


@pytest.mark.parametrize("page", PAGES)
def test_commands_of_the_pages_are_understood(page):
    for words in commands_of(page):
        if words[0] == "plot" and "/" in words[1]:
            words.insert(1, "run")  # what the folder of a run stands for
        try:
            parse(words)
        except UserError as wrong:
            pytest.fail(f"{page}: agility-ref {shlex.join(words)}: {wrong}")
        except SystemExit as left:  # as --help does, with status 0
            assert not left.code, f"{page}: agility-ref {shlex.join(words)}"

import re
from pathlib import Path

import pytest

from agility_ref.observation import OBSERVATION, observation_slices

ROOT = Path(__file__).parent.parent


def test_observation_table_is_that_of_the_code():
    table = (ROOT / "docs" / "environment.md").read_text()
    rows = re.findall(r"^\| (\d+) \| (\d+) \| `(\w+)` \| (\d+) \| ([\d.]+) \|", table, re.M)
    documented = [(int(a), int(b), name, int(size), float(noise)) for a, b, name, size, noise in rows]
    assert documented == [(part.start, part.stop, n, *OBSERVATION[n]) for n, part in observation_slices().items()]


@pytest.mark.parametrize("page", ["README.md", *(f"docs/{p.name}" for p in (ROOT / "docs").glob("*.md"))])
def test_files_that_the_pages_link_to_exist(page):
    path = ROOT / page
    for target in re.findall(r"\]\(([^)#:]+)\)", path.read_text()):
        assert (path.parent / target).exists(), f"{page} links to {target}"

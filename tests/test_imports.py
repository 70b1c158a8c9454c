"""Programs import the package before numpy, for it sets how numpy computes; if they do not, it says so."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import agility_ref

import pytest

ROOT = Path(__file__).parent.parent
PROGRAMS = sorted(
    p for folder in ("tutorials", "benchmarks", "examples", "tests") for p in (ROOT / folder).rglob("*.py")
)
HARMLESS = {*sys.stdlib_module_names, "pytest", *(p.stem for p in PROGRAMS)}  # which load no numpy by themselves


def imported(path):
    """First part of the name of everything that a file imports at its top level, in order."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module.partition(".")[0]


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: str(path.relative_to(ROOT)))
def test_the_package_is_imported_before_numpy(path):
    others = [name for name in imported(path) if name not in HARMLESS]
    assert others[:1] in ([], ["agility_ref"]), f"{path} imports {others[0]} before agility_ref"


def warnings_of(program, **settings):
    """What Python says on its standard error when it runs a program with these variables set and none of ours."""
    environment = {k: v for k, v in os.environ.items() if k not in agility_ref._SETTINGS} | settings
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    return [line for line in done.stderr.splitlines() if "Warning" in line]


def test_imported_too_late_it_warns_once():
    (warning,) = warnings_of("import numpy\nimport agility_ref\nimport agility_ref.terrain")
    assert "after numpy" in warning and "put it first" in warning


def test_imported_first_or_with_its_settings_made_it_is_silent():
    assert warnings_of("import agility_ref\nimport numpy") == []
    assert warnings_of("import numpy\nimport agility_ref", **agility_ref._SETTINGS) == []

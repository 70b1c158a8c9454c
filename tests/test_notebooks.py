"""The tutorials as scripts and as notebooks: both run, print the same, and show their figures."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

jupytext = pytest.importorskip("jupytext")
nbclient = pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")

TUTORIALS = Path(__file__).parent.parent / "tutorials"
QUICK = ("01", "02")
CHECKED = ("01", "02", "04", "06", "08")  # 03, 05 and 07 would make the checks some minutes longer
LEFT_OUT = re.compile(r"^(figure: .*|time: \d+ s)$")  # where a script wrote a picture, and how long it took


def printed(text):
    """What a tutorial said, line by line, but for paths and times."""
    return [line for line in text.splitlines() if not LEFT_OUT.match(line)]


def run_script(script, folder):
    """Return what a script prints."""
    done = subprocess.run(
        [sys.executable, script], cwd=folder, env=os.environ | {"MPLBACKEND": "Agg"}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def run_notebook(script, folder):
    """Return what the same cells print in a notebook, and how many pictures they show."""
    notebook = jupytext.read(script)
    nbclient.NotebookClient(notebook, timeout=None, resources={"metadata": {"path": str(folder)}}).execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    text = "".join(o.text for o in outputs if o.output_type == "stream" and o.name == "stdout")
    return text, sum("image/png" in o.get("data", {}) for o in outputs)


@pytest.mark.parametrize("number", [pytest.param(n, marks=[] if n in QUICK else [pytest.mark.slow]) for n in CHECKED])
def test_script_and_notebook_say_the_same(number, tmp_path):
    (script,) = TUTORIALS.glob(f"{number}_*.py")
    said = run_script(script, tmp_path)
    figures = sorted((tmp_path / "figures").glob(f"{number}_*.png"))
    assert figures
    text, pictures = run_notebook(script, tmp_path)
    assert printed(text) == printed(said)
    assert pictures == len(figures)


def test_every_tutorial_opens_as_a_notebook():
    for script in sorted(TUTORIALS.glob("[0-9]*.py")):
        notebook = jupytext.read(script)
        assert notebook.metadata["kernelspec"]["name"] == "python3"
        assert {cell.cell_type for cell in notebook.cells} == {"markdown", "code"}, script
        text = "\n".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
        assert text.count("<details>") == text.count("</details>") >= 2, f"{script}: answers that are not folded"
        assert text.count("$$") % 2 == 0, f"{script}: a formula that does not end"

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

TUTORIALS = sorted((Path(__file__).parent.parent / "tutorials").glob("[0-9]*.py"))
QUICK = ("01_", "02_")


@pytest.mark.parametrize("script", [
    pytest.param(path, id=path.stem, marks=[] if path.name.startswith(QUICK) else [pytest.mark.slow])
    for path in TUTORIALS
])  # fmt: skip
def test_tutorial_runs_as_a_script(script, tmp_path):
    done = subprocess.run(
        [sys.executable, script], cwd=tmp_path, env=os.environ | {"MPLBACKEND": "Agg"},
        capture_output=True, text=True, timeout=900,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    if script.name.startswith("02_"):  # Newton: feet that stand still carry the weight
        carried = [float(share) for share in re.findall(r"the feet carry ([\d.]+) of the weight", done.stdout)]
        assert carried == pytest.approx([1.0] * 3, abs=0.01)

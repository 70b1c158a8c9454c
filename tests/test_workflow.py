"""The workflow on the local executor with tiny budgets; its graph for Slurm as a dry run."""

import importlib
import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

from agility_ref.policy import Policy
from agility_ref.results.cells import cell_path
from agility_ref.results.table1 import table_lines
from agility_ref.training.policies import POLICIES

import pytest

ROOT = Path(__file__).parent.parent
WORKFLOW = ROOT / "workflow"
TINY = {
    "presets": ["quick"], "seeds": [0], "policies": ["leap"], "environments": ["gap"], "episodes": 2,
    "steps": {"walk": 512, "leap": 1024}, "flags": "--ppo.num-envs 16 --curriculum.num-levels 2 --curriculum.variants 1",
}  # fmt: skip


def snakemake(folder, *arguments, config=None, profile="default"):
    """Run Snakemake on our Snakefile in a folder of its own; return the finished process."""
    pytest.importorskip("snakemake", reason="needs the extra sweep")
    if config is not None:
        (folder / "config.json").write_text(json.dumps(config))
    command = [
        sys.executable, "-m", "snakemake", "--snakefile", WORKFLOW / "Snakefile", "--directory", folder,
        "--profile", WORKFLOW / "profiles" / profile, *arguments,
    ]  # fmt: skip
    if (folder / "config.json").exists():
        command += ["--configfile", folder / "config.json"]
    paths = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return subprocess.run(command, env=os.environ | {"PYTHONPATH": paths}, capture_output=True, text=True, timeout=900)


def ran(process):
    """Return how many jobs of each rule ran, or would run."""
    assert process.returncode == 0, process.stderr[-3000:]
    counts = re.findall(r"^([a-z][\w-]*) +(\d+)$", process.stdout + process.stderr, re.M)
    return {rule: int(count) for rule, count in counts if rule != "total"}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("workflow")
    return folder, snakemake(folder, "--cores", "2", "table1", config=TINY)


def test_the_table_is_trained_and_played(built):
    folder, process = built
    assert ran(process) == {"walk": 1, "leap": 1, "cell": 1, "table": 1, "table1": 1}
    table = (folder / "results" / "quick" / "table1.csv").read_text().splitlines()
    assert [line.split(",")[1] for line in table if line.endswith(",0")] == ["Leap"]
    assert cell_path(folder / "results" / "quick" / "cells", "leap", "gap", 0).exists()
    marker = (folder / "runs" / "quick" / "leap" / "seed0" / "DIGEST").read_text()
    policy = Policy.load(folder / "runs" / "quick" / "leap" / "seed0" / "policy.npz")
    assert marker == f"leap {policy.digest()}\n" and policy.meta["start"] == 512


def test_a_finished_table_has_nothing_to_do(built):
    assert ran(snakemake(built[0], "--cores", "2", "--dry-run", "table1")) == {}


def test_what_is_missing_is_made_again_from_where_it_was(built):
    """A lost marker alone: the run goes on from its checkpoint, ends with the same weights, and no cell is played again."""
    run = built[0] / "runs" / "quick" / "walk" / "seed0"
    before, progress = (run / "DIGEST").read_text(), (run / "progress.csv").read_text()
    (run / "DIGEST").unlink()
    process = snakemake(built[0], "--cores", "2", "weights")
    assert ran(process) == {"walk": 1, "leap": 1, "weights": 1}
    assert (run / "DIGEST").read_text() == before and (run / "progress.csv").read_text() == progress
    assert ran(snakemake(built[0], "--cores", "2", "--dry-run", "table1")) == {}


def test_other_weights_below_make_everything_above_anew(built):
    run = built[0] / "runs" / "quick"
    leap = (run / "leap" / "seed0" / "DIGEST").read_text()
    process = snakemake(built[0], "--cores", "2", "table1", config=TINY | {"steps": {"walk": 768, "leap": 1024}})
    assert ran(process) == {"walk": 1, "leap": 1, "cell": 1, "table": 1, "table1": 1}
    assert Policy.load(run / "leap" / "seed0" / "policy.npz").meta["start"] == 768
    assert (run / "leap" / "seed0" / "DIGEST").read_text() != leap


def test_slurm_would_run_the_whole_table(tmp_path):
    pytest.importorskip("snakemake_executor_plugin_slurm")
    jobs = ran(snakemake(tmp_path, "--dry-run", "table1", profile="slurm"))
    trained = [name for name, spec in POLICIES.items() if spec.method != "oracle" and name != "post-gen"]
    cells = {(e, "ps-rl-3-oracle" if name == "ps-rl-3" else name) for e, name in table_lines() if name != "post-gen"}
    assert jobs == dict.fromkeys(trained, 3) | {"cell": 3 * len(cells), "table": 1, "table1": 1}


def test_costs_at_a_given_speed(monkeypatch):
    monkeypatch.syspath_prepend(str(WORKFLOW))
    costs = importlib.import_module("costs")
    monkeypatch.setitem(POLICIES, "walk", replace(POLICIES["walk"], budget=(1_200_000, 0)))
    monkeypatch.setitem(POLICIES, "leap", replace(POLICIES["leap"], budget=(4_800_000, 0)))
    minutes = costs.training_minutes("quick", speed=2000.0)
    assert minutes["walk"] == pytest.approx(10.0)  # 1.2 M / (60 * 2000)
    assert minutes["leap"] == pytest.approx(30.0)  # (4.8 M - 1.2 M of walk) / (60 * 2000)
    assert not {"oracle", "post-gen"} & set(minutes)
    # a 10 min, then b 30 min and c 20 min: one core takes 60, two wait for a and then for b
    jobs = {("a",): (10.0, ()), ("b",): (30.0, (("a",),)), ("c",): (20.0, (("a",),))}
    assert (costs.schedule(jobs, 1), costs.schedule(jobs, 2)) == (60.0, 40.0)


@pytest.mark.parametrize("words, says", [
    ("cell.py fly gap --preset quick --seed 0 --episodes 1 --runs runs --results results", "unknown policy 'fly'"),
    ("table.py fly:gap --preset quick --seeds 0 --episodes 1 --runs runs --results results", "unknown policy 'fly'"),
    ("costs.py --preset fast", "invalid choice: 'fast'"),
])  # fmt: skip
def test_mistakes_are_one_line_after_the_usage(tmp_path, words, says):
    script, *rest = words.split()
    process = subprocess.run([sys.executable, WORKFLOW / script, *rest], cwd=tmp_path, capture_output=True, text=True)
    assert process.returncode == 2 and "Traceback" not in process.stderr
    assert process.stderr.splitlines()[-1].startswith(f"{script}: error: ") and says in process.stderr.splitlines()[-1]


def test_unknown_policy_is_named(tmp_path):
    process = snakemake(tmp_path, "--dry-run", "table1", config=TINY | {"policies": ["fly"]})
    assert process.returncode != 0 and "unknown policy" in process.stdout + process.stderr

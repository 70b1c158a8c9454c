"""Quick forms of benchmarks/crash_test.py, fuzz_files.py and fuzz_commands.py, and what a machine may do to a run."""

import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))

import crash_test
import fuzz_files

ROOT = Path(__file__).parent.parent


POLITE = [pytest.param(how, marks=pytest.mark.slow) for how in (signal.SIGINT, signal.SIGTERM)]


@pytest.mark.parametrize("how", [signal.SIGKILL, *POLITE])
def test_killed_and_resumed_training_is_training(tmp_path, how):
    counts = crash_test.crash_training(tmp_path, 2, how, iterations=60, seed=int(how))
    assert counts["kills"] == 2 and counts["lost iterations"] <= 2


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_killed_fifty_times(tmp_path, how):
    assert crash_test.crash_training(tmp_path, 50, how, iterations=500, seed=int(how))["kills"] == 50


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_a_killed_table_is_the_table(tmp_path, how):
    assert crash_test.crash_table(tmp_path, 5, how, seed=0)["kills"] == 5


def test_damaged_files_are_refused_or_as_good_as_new(tmp_path):
    counts = fuzz_files.fuzz(400, 5, tmp_path)
    assert counts.total() == 400
    assert {kind for kind, _, outcome in counts if outcome == "refused"} >= {
        "checkpoint",
        "progress",
        "manifest",
        "config",
    }
    assert {kind for kind, _, outcome in counts if outcome == "loaded"} >= {"checkpoint", "cell"}


@pytest.mark.parametrize("lines", [12, pytest.param(2000, marks=pytest.mark.slow)])
def test_whatever_is_typed_ends_with_an_exit_status(lines):
    """In a process of its own, for it sets alarms and watches what is written for good."""
    command = [sys.executable, ROOT / "benchmarks" / "fuzz_commands.py", "--lines", str(lines), "--seconds", "0.3"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=5 * lines + 300)
    assert done.returncode == 0, done.stderr
    assert f"{lines} of {lines};" in done.stdout


def run(*arguments, **options):
    """Run the command line in a process of its own."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)} | options.pop("env", {})
    command = [sys.executable, "-m", "agility_ref", *arguments]
    return subprocess.run(command, env=environment, stderr=subprocess.PIPE, text=True, timeout=300, **options)


W = (
    "train walk --preset quick --ppo.num-envs 8 --ppo.num-steps 4 --ppo.hidden 8 --curriculum.num-levels 2 "
    "--curriculum.variants 1 --steps 64 --out runs"
).split()


def test_a_hostile_environment_is_none_of_training_business(tmp_path):
    """A notebook's backend, a matplotlibrc that needs LaTeX, no graphics, no home, no locale, no output, a name that is no text."""
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\nbackend: qtagg\nfont.family: Nowhere\n")
    hostile = {
        "MPLBACKEND": "module://matplotlib_inline.backend_inline", "MATPLOTLIBRC": str(tmp_path / "matplotlibrc"),
        "MUJOCO_GL": "nonsense", "HOME": "/nonexistent", "LC_ALL": "C", "PYTHONIOENCODING": "ascii",
    }  # fmt: skip
    out = b"\xff\xfe"
    done = run(*W[:-1], out, cwd=tmp_path, env=hostile, preexec_fn=lambda: os.close(1))
    assert done.returncode == 0 and "Traceback" not in done.stderr and "warning" not in done.stderr
    folder = tmp_path / os.fsdecode(out) / "walk" / "seed0"
    assert (folder / "DONE").exists() and (folder / "learning_curve.png").read_bytes().startswith(b"\x89PNG")


SLOW = pytest.mark.slow


@pytest.mark.parametrize("bytes_left", [pytest.param(0, marks=SLOW), 3000, pytest.param(20_000, marks=SLOW)])
def test_a_full_disk_is_one_line_and_the_last_policy_stays(tmp_path, bytes_left):
    """A limit on the size of files, which fails as a full disk or a quota does: in the middle of a write."""

    def limit():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (bytes_left, bytes_left))

    done = run(*W, cwd=tmp_path, stdout=subprocess.DEVNULL, preexec_fn=limit)
    lines = [line for line in done.stderr.splitlines() if line.startswith("agility-ref:")]
    assert done.returncode == 2 and len(lines) == 1 and "Traceback" not in done.stderr
    assert not list(tmp_path.rglob("*.partial*"))


def test_a_read_only_folder_is_one_line(tmp_path):
    if os.geteuid() == 0:
        (tmp_path / "runs").write_text("a file where a folder is to be made")  # root may write anywhere
    else:
        tmp_path.chmod(0o555)
    done = run(*W, cwd=tmp_path, stdout=subprocess.DEVNULL)
    tmp_path.chmod(0o755)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and done.stderr.startswith("agility-ref: ")

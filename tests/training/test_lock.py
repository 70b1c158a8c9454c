import os
import signal
import subprocess
import sys
import threading
import time

from agility_ref.errors import UserError
from agility_ref.training import lock
from agility_ref.training.lock import lock_path, locked

import pytest

HOLD = """
import sys, time
from agility_ref.training.lock import locked
with locked(sys.argv[1]):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def other(tmp_path):
    """A process that holds the lock of tmp_path / "run"."""
    process = subprocess.Popen([sys.executable, "-c", HOLD, tmp_path / "run"], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.wait()


def test_another_process_is_kept_out_and_named(tmp_path, other):
    with (
        pytest.raises(UserError, match=rf"run is being written by another process \({other.pid}\)"),
        locked(tmp_path / "run"),
    ):
        pass
    with locked(tmp_path / "other run"):
        pass


def test_a_process_that_was_killed_holds_nothing(tmp_path, other):
    other.send_signal(signal.SIGKILL)
    other.wait()
    assert lock_path(tmp_path / "run").exists()
    with locked(tmp_path / "run"):
        pass
    assert not list(tmp_path.iterdir())


def test_waiting_is_said_and_ends_when_the_other_does(tmp_path, other, capsys, monkeypatch):
    monkeypatch.setattr(lock, "POLL_SECONDS", 0.01)
    threading.Timer(0.1, other.kill).start()
    with locked(tmp_path / "run", wait=True, quiet=False):
        assert other.wait() == -signal.SIGKILL
    assert f"({other.pid}): waiting for it" in capsys.readouterr().out


def test_a_lock_ends_with_its_block_also_when_that_fails(tmp_path):
    with pytest.raises(ZeroDivisionError), locked(tmp_path / "run"):
        assert lock_path(tmp_path / "run").read_text() == str(os.getpid())
        1 / 0  # noqa: B018
    assert not list(tmp_path.iterdir())
    with locked(tmp_path / "run"):
        pass


def test_one_at_a_time(tmp_path, monkeypatch):
    """Eight threads that take, hold and delete the lock in turn never hold it together."""
    monkeypatch.setattr(lock, "POLL_SECONDS", 0.001)
    inside, most, turns = [], [], []

    def work():
        for _ in range(20):
            with locked(tmp_path / "run", wait=True):
                inside.append(1)
                most.append(len(inside))
                time.sleep(0.0002)
                inside.pop()
            turns.append(1)

    threads = [threading.Thread(target=work) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(turns) == 160 and max(most) == 1


def test_a_file_system_without_locks_keeps_nobody_out(tmp_path, monkeypatch):
    def unsupported(file):
        raise OSError(lock.NO_LOCKS[0], "no locks available")

    monkeypatch.setattr(lock, "_lock", unsupported)
    with locked(tmp_path / "run"), locked(tmp_path / "run"):
        pass

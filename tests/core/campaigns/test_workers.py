"""Workers end when they should: what users do to a campaign in several processes."""

import errno
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread

import pytest

from gonio_mi.campaigns import execution
from gonio_mi.cli import main

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")

# Seconds after which a test is taken to hang, on a machine however busy.
HANGS = 300

# Measured at once at normal incidence; at any other angle it waits.
PLUGIN = """
import os
import time
import mitsuba as mi

class Waiting(mi.BSDF):
    def __init__(self, props):
        super().__init__(props)
        self.diffuse = mi.load_dict({"type": "diffuse"})
        self.m_components = [self.diffuse.flags(0)]
        self.m_flags = self.diffuse.flags()

    def sample(self, ctx, si, sample1, *arguments):
        # not in the trial with a single ray
        if len(sample1) > 1 and si.wi.z[0] < 0.99:
            open(f"waiting_{os.getpid()}", "w").close()
            time.sleep(600)
        return self.diffuse.sample(ctx, si, sample1, *arguments)

    def to_string(self):
        return "Waiting"

class Raising(Waiting):
    def sample(self, *arguments):
        raise ZeroDivisionError("no weight")

mi.register_bsdf("test_waiting", Waiting)
mi.register_bsdf("test_raising", Raising)
"""

COMMAND = """
import sys
from gonio_mi.cli import main

if __name__ == "__main__":
    sys.exit(main())
"""


@pytest.fixture
def started(tmp_path):
    """A campaign of two workers that wait, in a folder with a file signal.py."""
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "command.py").write_text(COMMAND)
    (tmp_path / "plugin.py").write_text(PLUGIN)
    (tmp_path / "signal.py").write_text("raise ImportError('not mine')")
    angles = ("--theta-i", "0", "30", "50", "70", "80", "-q")
    settings = ("--rays", "100", "--batches", "2", "--plugin", "plugin.py")
    kept = ("--workers", "2", "--folder", "kept")
    command = [sys.executable, "bin/command.py", "measure", "test_waiting"]
    how = {"stderr": subprocess.PIPE, "text": True, "start_new_session": True}
    command += [*angles, *settings, *kept]
    process = subprocess.Popen(command, cwd=tmp_path, **how)
    with process:
        try:
            end = time.monotonic() + HANGS
            while len(list(tmp_path.glob("waiting_*"))) < 2 or not finished(tmp_path):
                assert process.poll() is None, process.stderr.read()
                assert time.monotonic() < end, "it does not come so far"
                time.sleep(0.02)
            yield process
        finally:
            if alive(process.pid):
                os.killpg(process.pid, signal.SIGKILL)


def finished(folder):
    return [path.name for path in folder.glob("kept/*.npz")]


def alive(group):
    """Processes of a group, without those that have ended and wait to be buried."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, its_group = path.read_text().rpartition(")")[2].split()[:3]
        except OSError:  # it ended meanwhile
            continue
        if int(its_group) == group and state != "Z":
            found.append(int(path.parent.name))
    return found


def ends(group):
    """Whether all processes of a group have ended before a test hangs."""
    end = time.monotonic() + HANGS
    while alive(group) and time.monotonic() < end:
        time.sleep(0.02)
    return not alive(group)


def test_no_worker_outlives_its_parent(started):
    """SIGKILL, of which the parent knows nothing; and no worker read signal.py."""
    assert len(alive(started.pid)) >= 3
    os.kill(started.pid, signal.SIGKILL)
    started.wait()
    assert ends(started.pid)


def test_ctrl_c(started, tmp_path):
    """To all processes, as a terminal sends it: they end, what is done is kept."""
    os.killpg(started.pid, signal.SIGINT)
    _, err = started.communicate(timeout=HANGS)
    assert started.returncode == 2
    assert err == (
        "gonio-mi: interrupted: kept holds what was finished; the same command carries "
        "on\n"
    )
    assert finished(tmp_path) == ["000000_theta_i_0_phi_i_0.npz"]
    assert ends(started.pid)


def test_errors_of_workers_are_one_sentence(tmp_path, capsys):
    plugin = tmp_path / "plugin.py"
    plugin.write_text(PLUGIN)
    raising = ["test_raising", "--plugin", str(plugin)]
    for specimen, words in (
        (["diffuse", "--seed", "-1"], "seed must be at least 0, got -1"),
        (raising, f"{plugin}, line 25, in sample: ZeroDivisionError: no weight"),
    ):
        arguments = ["--theta-i", "0", "--rays", "100", "--workers", "1"]
        assert main(["measure", *specimen, *arguments]) == 1
        err = capsys.readouterr().err
        assert err.startswith("gonio-mi: ")
        assert words in err
        assert err.count("\n") == 1


def test_threads_start_processes_one_after_another(monkeypatch):
    """The environment is that of before, though two threads change it."""
    monkeypatch.delenv(execution.SAFE_PATH, raising=False)
    other_is_there, leave = Event(), Event()
    lock = execution._environment

    @contextmanager
    def awaited():
        other_is_there.set()
        with lock:
            yield

    def starts():
        with execution._spawning():
            other_is_there.set()
            leave.wait(HANGS)

    other = Thread(target=starts, daemon=True)
    with execution._spawning():
        monkeypatch.setattr(execution, "_environment", awaited())
        other.start()
        assert other_is_there.wait(HANGS)
    leave.set()
    other.join(HANGS)
    assert not other.is_alive()
    assert execution.SAFE_PATH not in os.environ


def test_full_shared_memory_is_named(monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(execution, "_Workers", full)
    message = "workers need semaphores in shared memory: No space.*/dev/shm"
    with pytest.raises(OSError, match=message), execution.workers(2):
        pass

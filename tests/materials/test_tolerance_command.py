"""``gonio-mi measure --tolerance`` that is interrupted or killed, and carried on.

All is exact.
"""

import signal
import subprocess
import sys

import pytest

import gonio_mi as gonio
from gonio_mi import cli
from gonio_mi.campaigns import tasks
from gonio_mi.materials import whole_bsdf

# Directions that are begun before Ctrl-C, a part of all that the command measures, and
# those that confirm the material.
BEGUN, UNSEEN = 15, 8

COMMAND = ["measure", "roughconductor:alpha=0.5", "--tolerance", "0.2", "--theta-max"]
COMMAND += ["60", "--collector", "projected:6x16", "--estimator", "weighted", "-q"]

# Looks for mirror peaks, of few rays, before anything else: they are not kept.
PROBES = 2

# The command in a process of its own, killed as it begins a direction amid the work.
KILLED = f"""
import os, signal, sys
from gonio_mi.cli import main
from gonio_mi.campaigns import tasks
from gonio_mi.materials import whole_bsdf

measure, calls = tasks.measure_each, []
whole_bsdf.N_UNSEEN = {UNSEEN}

def one(*args, **kwargs):
    calls.append(1)
    if len(calls) == {BEGUN}:
        os.kill(os.getpid(), signal.SIGKILL)
    return measure(*args, **kwargs)

tasks.measure_each = one
sys.exit(main())
"""


@pytest.fixture(autouse=True, scope="module")
def few_unseen():
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(whole_bsdf, "N_UNSEEN", UNSEEN)
        yield


@pytest.fixture
def sigint():
    """React to Ctrl-C as Python does, even if a shell in the background ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def counted(monkeypatch, interrupted=None, by=signal.SIGINT):
    """List of the directions that are begun; the one of that number is interrupted."""
    measure, calls = tasks.measure_each, []

    def one(*args, **kwargs):
        calls.append(1)
        if len(calls) == interrupted:
            signal.raise_signal(by)
        return measure(*args, **kwargs)

    monkeypatch.setattr(tasks, "measure_each", one)
    return calls


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    """The record, and how many directions were begun for it."""
    path = tmp_path_factory.mktemp("whole") / "metal.npz"
    with pytest.MonkeyPatch.context() as monkeypatch:
        calls = counted(monkeypatch)
        assert cli.main([*COMMAND, "-o", str(path)]) == 0
    assert [one.name for one in path.parent.iterdir()] == ["metal.npz"]
    return gonio.load(path), len(calls)


@pytest.fixture
def whole(uninterrupted):
    return uninterrupted[0]


def same(path, whole):
    """Whether the same command, carried on, gives the same; nothing else is left."""
    assert cli.main([*COMMAND, "-o", str(path)]) == 0
    found = gonio.load(path)
    assert found.tallies == whole.tallies
    assert found.settings["campaign"] == whole.settings["campaign"]
    assert [one.name for one in path.parent.iterdir()] == [path.name]


@pytest.mark.usefixtures("sigint")
def test_ctrl_c(tmp_path, uninterrupted, monkeypatch, capsys):
    """Each direction is measured once, but for the one that was interrupted."""
    whole, of_all = uninterrupted
    calls = counted(monkeypatch, BEGUN)
    path = tmp_path / "metal.npz"
    with pytest.raises(SystemExit) as ended:
        cli.main([*COMMAND, "-o", str(path)])
    assert ended.value.code == 2
    said = "holds what was finished; the same command carries on\n"
    assert capsys.readouterr().err == f"gonio-mi: interrupted: {path}.parts {said}"
    assert len(calls) == BEGUN
    assert len(list(tmp_path.rglob("0*.npz"))) == BEGUN - 1 - PROBES
    same(path, whole)
    assert not capsys.readouterr().err
    assert len(calls) - BEGUN == of_all - (BEGUN - 1) + PROBES


def test_what_sigterm_ends_says_so(tmp_path, monkeypatch, capsys):
    before = signal.getsignal(signal.SIGTERM)
    counted(monkeypatch, 5, signal.SIGTERM)
    path = tmp_path / "metal.npz"
    with pytest.raises(SystemExit) as ended:
        cli.main([*COMMAND, "-o", str(path)])
    assert ended.value.code == 143
    assert f"gonio-mi: interrupted: {path}.parts holds" in capsys.readouterr().err
    assert len(list(tmp_path.rglob("0*.npz"))) == 4 - PROBES
    assert signal.getsignal(signal.SIGTERM) == before


def test_a_kill(tmp_path, whole):
    path = tmp_path / "metal.npz"
    command = [sys.executable, "-c", KILLED, *COMMAND, "-o", path]
    assert subprocess.run(command).returncode == -signal.SIGKILL
    assert len(list(tmp_path.rglob("0*.npz"))) == BEGUN - 1 - PROBES
    assert not path.exists()
    same(path, whole)


def test_parts_of_another_specimen_are_told_of(tmp_path, capsys):
    """They stay, for whoever carries on; after Ctrl-C nothing is said of one's own."""
    path, other = tmp_path / "metal.npz", tmp_path / "metal.npz.parts/glass_0123abcd"
    (other / "rays_000").mkdir(parents=True)
    assert cli.main([*COMMAND, "-o", str(path)]) == 0
    said = "holds parts of another specimen, whose campaign was not finished: remove"
    assert f"gonio-mi: {other} {said}" in capsys.readouterr().err
    assert list(other.parent.iterdir()) == [other]


def test_what_is_refused_leaves_nothing(tmp_path, capsys):
    command = ["measure", "diffuse", "--tolerance", "0.2", "--collector", "klems"]
    assert cli.main([*command, "-o", str(tmp_path / "a.npz")]) == 1
    assert "rings with at least 8 equal sectors" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())

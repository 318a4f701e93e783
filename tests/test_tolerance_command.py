"""``gonio-mi measure --tolerance`` that is interrupted or killed, and carried on.

All is exact.
"""

import signal
import subprocess
import sys
import time

import pytest

import gonio_mi as gonio
from gonio_mi import cli
from gonio_mi.instrument import campaign_tasks

COMMAND = ["measure", "roughconductor:alpha=0.5", "--tolerance", "0.2", "--theta-max"]
COMMAND += ["60", "--collector", "projected:6x16", "--estimator", "weighted", "-q"]

PROGRAM = "import sys; from gonio_mi.cli import main; sys.exit(main())"

pytestmark = pytest.mark.usefixtures("mono")


@pytest.fixture
def sigint():
    """React to Ctrl-C as Python does, even if a shell in the background ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "metal.npz"
    assert cli.main([*COMMAND, "-o", str(path)]) == 0
    assert [one.name for one in path.parent.iterdir()] == ["metal.npz"]
    return gonio.load(path)


def same(path, whole):
    """Whether the same command, carried on, gives the same; nothing else is left."""
    assert cli.main([*COMMAND, "-o", str(path)]) == 0
    found = gonio.load(path)
    assert found.tallies == whole.tallies
    assert found.settings["campaign"] == whole.settings["campaign"]
    assert [one.name for one in path.parent.iterdir()] == [path.name]


@pytest.mark.usefixtures("sigint")
def test_ctrl_c(tmp_path, whole, monkeypatch, capsys):
    measure, calls = campaign_tasks.measure_each, []

    def interrupted(*args, **kwargs):
        calls.append(1)
        if len(calls) == 25:
            signal.raise_signal(signal.SIGINT)
        return measure(*args, **kwargs)

    monkeypatch.setattr(campaign_tasks, "measure_each", interrupted)
    path = tmp_path / "metal.npz"
    with pytest.raises(SystemExit) as ended:
        cli.main([*COMMAND, "-o", str(path)])
    assert ended.value.code == 2
    said = "holds what was finished; the same command carries on\n"
    assert capsys.readouterr().err == f"gonio-mi: interrupted: {path}.parts {said}"
    kept = len(list(tmp_path.rglob("0*.npz")))
    assert 10 < kept < 25
    again = len(calls)
    same(path, whole)
    of_all = whole.settings["campaign"]["measured"]
    # what was measured with other patches, at first, is not kept
    assert len(calls) - again <= of_all - kept + 12


def test_a_kill(tmp_path, whole):
    path = tmp_path / "metal.npz"
    with subprocess.Popen([sys.executable, "-c", PROGRAM, *COMMAND, "-o", path]) as one:
        while one.poll() is None and len(list(tmp_path.rglob("0*.npz"))) < 14:
            time.sleep(0.01)
        one.kill()
    assert one.returncode == -signal.SIGKILL
    assert not path.exists()
    same(path, whole)


def test_what_is_refused_leaves_nothing(tmp_path, capsys):
    command = ["measure", "diffuse", "--tolerance", "0.2", "--collector", "klems"]
    assert cli.main([*command, "-o", str(tmp_path / "a.npz")]) == 1
    assert "rings with at least 8 equal sectors" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())

"""Annotations hold, as far as pyproject.toml asks for them; and mypy would see."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

USER = """\
import gonio_mi.collector

reveal_type(gonio_mi.collector.subdivision("klems"))
gonio_mi.collector.subdivision(30)
"""


@pytest.fixture(scope="module")
def mypy(tmp_path_factory):
    pytest.importorskip("mypy")
    cache = tmp_path_factory.mktemp("mypy")

    def run(*arguments):
        command = [sys.executable, "-m", "mypy", "--cache-dir", str(cache), *arguments]
        environment = os.environ | {"MYPYPATH": str(ROOT)}
        return subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, text=True
        )

    return run


def test_types(mypy):
    found = mypy()
    assert found.returncode == 0, found.stdout + found.stderr


def test_twin_sees_a_wrong_type(mypy, tmp_path):
    """In code of a user, to whom ``py.typed`` shows the annotations."""
    file = tmp_path / "user.py"
    file.write_text(USER)
    found = mypy(str(file))
    assert found.returncode == 1
    assert 'Revealed type is "gonio_mi.collector.hemisphere.Subdivision"' in (
        found.stdout
    )
    assert '"subdivision" has incompatible type "int"' in found.stdout


def test_annotations_are_packaged():
    assert (ROOT / "gonio_mi" / "py.typed").exists()

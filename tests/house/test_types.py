"""Annotations hold, as far as pyproject.toml asks for them; and mypy would see."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

USER = """\
import gonio_mi.collector

reveal_type(gonio_mi.collector.subdivision("klems"))
gonio_mi.collector.subdivision(30)
"""


def test_types(tmp_path):
    """In the package; twin: in code of a user a wrong one is seen.

    To whom ``py.typed`` shows the annotations. Both in one run, which takes long.
    """
    pytest.importorskip("mypy")
    user = tmp_path / "user.py"
    user.write_text(USER)
    command = [sys.executable, "-m", "mypy", "--no-incremental"]
    found = subprocess.run(
        [*command, "gonio_mi", str(user)],
        cwd=ROOT,
        env=os.environ | {"MYPYPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    lines = found.stdout.splitlines()
    said = [line for line in lines if line.startswith(str(user))]
    assert len(said) == 2
    assert 'Revealed type is "gonio_mi.collector.hemisphere.Subdivision"' in said[0]
    assert '"subdivision" has incompatible type "int"' in said[1]
    assert set(lines) - set(said) == {lines[-1]}, found.stdout + found.stderr
    assert lines[-1].startswith("Found 1 error in 1 file (checked ")
    assert found.returncode == 1


def test_annotations_are_packaged():
    assert (ROOT / "gonio_mi" / "py.typed").exists()

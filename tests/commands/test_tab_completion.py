"""Tab completes commands, options and files, by the script of shtab. All is exact."""

import shutil
import subprocess
import sys

import pytest

pytest.importorskip("shtab")
BASH = shutil.which("bash")

# As bash calls it: the words, and the number of the one that is completed.
COMPLETE = """
source ./script
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _shtab_gonio_mi; echo "${COMPREPLY[*]}"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder of the script, and of a file."""
    place = tmp_path_factory.mktemp("shell")
    command = [sys.executable, "-m", "shtab", "-s", "bash", "gonio_mi.cli.parser"]
    script = subprocess.run(command, capture_output=True, check=True).stdout
    (place / "script").write_bytes(script)
    (place / "scene.xml").touch()
    return place


@pytest.mark.skipif(BASH is None, reason="needs bash")
@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("mea", "measure"),
        ("measure --theta", "--theta-i --theta-max"),
        ("measure scen", "scene.xml"),
        ("measure diffuse --theta-i 45 -o scen", "scene.xml"),
        ("bsdf scene.xml --basis klems-", "klems-half klems-quarter"),
        ("measure nothing-of-this-name", ""),
    ],
)
def test_tab_completes(words, offered, folder):
    command = [BASH, "-c", COMPLETE, "bash", "gonio-mi", *words.split()]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.stdout.split() == offered.split(), done.stderr

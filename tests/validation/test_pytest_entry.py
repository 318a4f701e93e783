"""pytest examines the BSDFs that its settings name, in a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
FOLDER = str(TESTS / "references")
PLUGIN = f"""
import sys
sys.path.insert(0, {FOLDER!r})
import broken_bsdfs
broken_bsdfs.register()
"""
QUICK = "--plugin mine.py --effort quick --variant llvm_ad_mono"
SETTINGS = f"""
[pytest]
gonio_bsdfs =
    lambert {QUICK}
    weight_with_cosine {QUICK}
    lambert --no-such-option
"""
# Whatever is installed, this checkout is tested.
THIS = (
    "-p",
    "no:gonio_mi",
    "-p",
    "gonio_mi.validation.pytest_entry",
    "-p",
    "no:cacheprovider",
)


@pytest.fixture
def run(tmp_path):
    (tmp_path / "mine.py").write_text(PLUGIN)
    (tmp_path / "pytest.ini").write_text(SETTINGS)
    (tmp_path / "test_other.py").write_text("def test_other():\n    pass\n")

    def run(*words):
        command = [sys.executable, "-m", "pytest", *THIS, *words]
        # where pytest does not shorten its summary
        root = str(TESTS.parent)
        environment = {**os.environ, "PYTHONPATH": root, "CI": "true"}
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True
        )
        return done.returncode, done.stdout

    return run


def test_lines_are_tests(run):
    """The first line of a failure is the verdict, in the summary too."""
    code, out = run("-rA")
    assert code == 1
    assert "2 failed, 2 passed" in out
    summary = {line.split(" - ")[0]: line for line in out.splitlines() if "::" in line}
    wrong = next(x for name, x in summary.items() if "FAILED ::weight_with" in name)
    assert "weight_with_cosine: FAILS: biases images" in wrong
    other = next(x for name, x in summary.items() if "no-such-option" in name)
    assert "unrecognized arguments: --no-such-option" in other
    assert f"PASSED ::lambert {QUICK}" in out
    assert "pytest_entry.py" not in out


def test_processes_of_xdist_know_the_lines(run):
    assert "1 failed" in run("-n", "1", "-k", "no-such")[1]


def test_only_what_is_asked_for(run, tmp_path):
    """Single files and tests leave the lines out, and say so; folders do not."""
    said = "gonio_bsdfs: 3 not validated, since only files or tests were selected"
    (tmp_path / "tests").mkdir()
    (tmp_path / "test_other.py").rename(tmp_path / "tests" / "test_other.py")
    for word in ("tests/test_other.py", "tests/test_other.py::test_other"):
        out = run("--collect-only", "-vv", word)[1]
        assert "<Validation" not in out
        assert said in out
    for word in ("tests", ".", "./tests/"):
        out = run("--collect-only", word)[1]
        assert out.count("<Validation") == 3
        assert said not in out

"""The files that ``-m "not slow"`` leaves out, and those of workflows, are there."""

import re
from pathlib import Path

TESTS = Path(__file__).parents[1]


def test_every_slow_file_exists():
    text = (TESTS / "conftest.py").read_text()
    names = re.search(r'^SLOW = """(.*?)"""', text, re.MULTILINE | re.DOTALL)[1].split()
    assert names
    files = {path.stem.removeprefix("test_") for path in TESTS.rglob("test_*.py")}
    assert not set(names) - files


def test_every_file_of_the_workflows_exists():
    workflows = sorted(TESTS.parent.glob(".github/workflows/*.yml"))
    text = "".join(path.read_text() for path in workflows)
    names = re.findall(r"tests/\S+\.py", text)
    assert names
    assert not [name for name in names if not (TESTS.parent / name).is_file()]

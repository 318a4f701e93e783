"""The quick tests, which everybody runs, touch each room and each promise of README."""

import re
from functools import cache
from pathlib import Path

import durations
import pytest

TESTS = Path(__file__).parents[1]
README = (TESTS.parent / "README.md").read_text(encoding="utf-8")
ANNEXES = ("analysis", "exchange", "materials", "validation")


FUNCTION = re.compile(
    r"""^(?:@pytest\.mark\.promise\("(?P<words>[^"]+)"\)\n)?def (?P<name>test_\w+)""",
    re.MULTILINE,
)


@cache
def functions():
    """Words of README that a test function promises, or None; by its name."""
    return {
        f"{path.relative_to(TESTS).as_posix()}::{found['name']}": found["words"]
        for path in TESTS.rglob("test_*.py")
        for found in FUNCTION.finditer(path.read_text(encoding="utf-8"))
    }


def quick(stored):
    """Quick test functions."""
    known = functions()
    return {
        name: words
        for name, words in known.items()
        if not durations.is_slow(stored.get(name, 0.0), words)
    }


def plain(text):
    return " ".join(text.split())


def untouched(stored):
    """Rooms, and parts of README that promise something, without a quick test."""
    tests = quick(stored)
    rooms = [x.name for x in (TESTS / "core").iterdir() if x.name != "__pycache__"]
    folders = [f"core/{room}/" for room in rooms] + [f"{one}/" for one in ANNEXES]
    bare = [one for one in folders if not any(name.startswith(one) for name in tests)]
    asked = plain(README.partition("## Is my plugin right?")[2].partition("## How")[0])
    before, *parts = re.split(r"(?=\* \*\*)", asked)
    promised = [words for words in tests.values() if words]
    assert len(parts) == asked.count("* **") > 1
    return bare + [
        part
        for part in (before, *parts)
        if not any(words in part for words in promised)
    ]


def test_each_room_and_promise_has_quick_tests():
    assert not untouched(durations.read())


def test_twin_slow_tests_do_not_count():
    assert untouched(dict.fromkeys(functions(), 1.0))


def test_promises_are_words_of_readme():
    words = {one for one in functions().values() if one}
    assert not [one for one in words if one not in plain(README)]


def test_every_duration_is_of_a_test():
    assert not durations.read().keys() - functions().keys()


@pytest.mark.parametrize(
    ("seconds", "said"), [(0.4, 0), (0.51, 1), (0.9, 0), (2.1, 1), (0.45, 1)]
)
def test_durations_that_are_wrong_are_told(seconds, said):
    """By more than twice: of the first two nothing is stored, of the others 1 s.

    What has no entry may take half a second.
    """
    taken = durations.Taken()
    taken.add("tests/house/test_a.py::test_b[c]", seconds)
    stored = {} if seconds in (0.4, 0.51) else {"house/test_a.py::test_b": 1.0}
    assert len(taken.wrong(stored)) == said
    assert len(taken.wrong(stored, {*stored})) == (seconds > 0.5 and said)


def test_a_slower_machine_is_no_news():
    """By the median of what is stored; a single one that differs is told."""
    taken, stored = durations.Taken(), {}
    for number in range(21):
        stored[f"test_a.py::test_{number}"] = 1.0
        taken.add(f"tests/test_a.py::test_{number}", 3.0 if number else 9.0)
    assert taken.wrong(stored) == ["test_a.py::test_0: 3.00 s, stored 1.00 s"]


def test_every_file_of_the_workflows_exists():
    workflows = sorted(TESTS.parent.glob(".github/workflows/*.yml"))
    text = "".join(path.read_text() for path in workflows)
    names = re.findall(r"tests/\S+\.py", text)
    assert names
    assert not [name for name in names if not (TESTS.parent / name).is_file()]

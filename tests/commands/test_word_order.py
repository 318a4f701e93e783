"""Options before and after SPECIMEN mean the same."""

import pytest

from gonio_mi.cli import parser
from gonio_mi.commands.parser import UsageError

AFTER = "measure diffuse --theta-i 0 30 --rays 1e4 -o a.npz b.exr"


def parsed(line):
    return vars(parser().parse_args(line.split()))


@pytest.mark.parametrize(
    "before",
    [
        "measure --theta-i 0 30 diffuse --rays 1e4 -o a.npz b.exr",
        "measure --rays 1e4 -o a.npz b.exr --theta-i 0 30 diffuse",
        "measure --theta-i 0 30 --rays 1e4 -o a.npz b.exr diffuse",
        "measure --theta-i 0 30 --rays=1e4 -o a.npz b.exr diffuse",
    ],
)
def test_specimen_stands_anywhere(before):
    assert parsed(before) == parsed(AFTER)


def test_words_that_are_no_pairs_are_the_scene():
    line = "measure -D alpha=0.3 beta=2 scene.xml --theta-i 45"
    assert parsed(line) == parsed("measure scene.xml -D alpha=0.3 beta=2 --theta-i 45")


def test_two_records_of_a_comparison():
    assert parsed("compare a.npz -o x.png b.npz") == parsed(
        "compare a.npz b.npz -o x.png"
    )


@pytest.mark.parametrize(
    "line",
    ["measure --theta-i 30 45", "measure --theta-i 45", "show --json", "compare a.npz"],
)
def test_twin_what_is_missing_is_said(line):
    """Values that an option can take stay its own."""
    with pytest.raises(UsageError, match="arguments are required"):
        parsed(line)

"""What long work says of itself where nobody looks at a terminal. All is exact."""

import io
import math
import re
import sys
import threading
import time
import warnings
from types import ModuleType

import pytest

import gonio_mi as gonio
from gonio_mi import progress
from gonio_mi.instrument import launcher


@pytest.fixture
def clock(monkeypatch):
    """A clock that is set by hand, and stands still otherwise."""
    now = [1000.0]
    # what other tests have left, by the true clock, and what this one leaves to them
    monkeypatch.setattr(progress._Lines, "alive", -math.inf)
    monkeypatch.setattr(progress._Lines, "written", -math.inf)
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(progress, "PAUSE", 30.0)
    return now


def test_a_line_once_a_while(clock, capsys):
    """However many bars there are; and none in what is short."""
    for number in range(4):
        name = f"round {number}"
        with progress.bar(True, total=4, unit="direction", desc=name) as report:
            for _ in range(4):
                clock[0] += 5
                report(1)
    said = [line.split(",")[0] for line in capsys.readouterr().err.splitlines()]
    assert said == ["round 1: 2 of 4 directions", "round 2: 4 of 4 directions"]
    clock[0] += 3600  # of something else
    with progress.bar(True, total=None, unit="ray", unit_scale=True) as report:
        report(1e6)
        assert not capsys.readouterr().err
        clock[0] += 31
        report(1e6)
    assert capsys.readouterr().err.startswith("2.00M rays")


def test_counts_are_whole_where_parts_are_reported(monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    with progress.bar(True, unit="point", mininterval=0) as report:
        report(1024 / 3)
    assert any(one.startswith("341point [") for one in terminal.drawn())


def test_a_line_while_nothing_is_reported(monkeypatch, capsys):
    """Of the first direction, which takes long."""
    monkeypatch.setattr(progress, "PAUSE", 0.02)
    before, said = {*threading.enumerate()}, ""
    with progress.bar(True, total=4, unit="direction", desc="slow"):
        while "\n" not in said:
            time.sleep(0.01)
            said += capsys.readouterr().err
    assert said.startswith("slow: 0 of 4 directions, ? left\n")
    while {*threading.enumerate()} - before:
        time.sleep(0.01)


def test_nothing_where_it_is_not_wanted(clock, capsys):
    with progress.bar(False, total=4) as report:
        clock[0] += 100
    assert report is None
    assert not capsys.readouterr().err


def test_nothing_where_there_is_no_standard_error(monkeypatch):
    """As of Python on Windows without a console."""
    monkeypatch.setattr(sys, "stderr", None)
    assert [*progress.counted(range(3), True)] == [0, 1, 2]


def test_many_rays_are_announced_once(clock):
    """When their speed is known, which the first ones, compiled, do not tell."""
    told = []
    report = progress.Announcement(told.append, 1e6)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for seconds in (3600, 9):
            clock[0] += seconds
            report(1000)
    clock[0] += 1
    said = (
        "2e\\+03 rays took 10 s; the other 9.97e\\+05 are expected to take 1.38 hours"
    )
    with pytest.warns(RuntimeWarning, match=said):
        report(1000)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        clock[0] += 1
        report(1000)
        short = progress.Announcement(None, 6e4)  # 590 seconds, after two
        for _ in range(60):
            short(1000)
            clock[0] += 10
    assert told == [1000] * 4


def test_a_measurement_announces_its_rays(monkeypatch):
    """If their number is fixed; twin: not if a precision is."""
    monkeypatch.setattr(progress, "MIN_ANNOUNCED", 0.0)
    monkeypatch.setattr(progress, "TRIAL", 0.0)
    monkeypatch.setattr(launcher, "MAX_LAUNCH", 1000)
    few = {"collector": "projected:2x2", "batches": 2}
    with pytest.warns(RuntimeWarning, match="rays took") as said:
        gonio.measure({"type": "diffuse"}, 0, rays=10_000, **few)
    assert len(said) == 1
    gonio.measure({"type": "diffuse"}, 0, rel_err=0.05, **few)


def test_bars_only_where_they_are_drawn(monkeypatch, capsys):
    """In a notebook; not wherever somebody has imported what notebooks need."""
    monkeypatch.setitem(sys.modules, "ipykernel", ModuleType("ipykernel"))
    with progress.bar(True, total=1, unit="direction"):
        pass
    assert not capsys.readouterr().err
    stream = type("OutStream", (io.StringIO,), {"__module__": "ipykernel.iostream"})
    monkeypatch.setattr(sys, "stderr", drawn := stream())
    with progress.bar(True, total=1, unit="direction"):
        pass
    assert "0/1" in drawn.getvalue()


class Terminal(io.StringIO):
    """A terminal of 80 columns, and what was drawn in it."""

    def isatty(self):
        return True

    def drawn(self):
        """What stood in the line, one after the other."""
        return [one for one in re.split(r"[\r\n]", self.getvalue()) if one.strip()]


def test_a_bar_leaves_room_for_what_it_counts(monkeypatch):
    """All that a campaign says, whole; and of a longer text what fits.

    Also after lines of something that is not forgotten.
    """
    ended = progress.bar(True, total=3, unit="direction")
    with ended:
        pass
    for name, size in (("COLUMNS", "80"), ("LINES", "24")):
        monkeypatch.setenv(name, size)
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    long = "roughcon..., 120 measured, 12 of 24 segments open"
    for said, shown in ((long, long), ("word " * 20, "word " * 9 + "...")):
        with progress.bar(True, desc=said, total=120, unit="direction") as report:
            report(3)
        last = terminal.drawn()[-1]
        assert re.match(rf"{shown}: \|.{{5,}}\| \d+/120, [\d:?]+ left$", last)
        assert len(last) < 80

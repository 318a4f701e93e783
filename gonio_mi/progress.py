"""A progress bar on standard error, or lines where that is no terminal."""

import functools
import math
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import Any, TypeVar

from .errors import abridged, warn

T = TypeVar("T")

# Seconds between two lines, and the thread of Python's that keeps to them.
PAUSE, WATCH = 30.0, "gonio_mi progress"

# Seconds of further measuring that are announced, and those that tell the speed.
MIN_ANNOUNCED, TRIAL = 600.0, 10.0

# Columns of a terminal for the bar itself, counts and the time that is left.
COUNTS = 31


def bar(
    shown: bool, **how: Any
) -> AbstractContextManager[Callable[[float], Any] | None]:
    """Context of the function to report progress to; of None if it is not `shown`.

    It is not where there is no standard error. Where that is a file or a pipe, a line
    is written about every 30 seconds, however many bars there are one after the other.
    `how` are the arguments of :class:`tqdm.tqdm`.
    """
    if not shown or sys.stderr is None:
        return nullcontext()
    notebook = type(sys.stderr).__module__.startswith("ipykernel")
    in_place = sys.stderr.isatty() or notebook
    if not in_place:
        return _Lines(**how)
    said = how.get("desc")
    if said and how.get("total") is not None:
        import shutil  # slow to import

        columns = shutil.get_terminal_size((80, 24)).columns
        how["desc"] = abridged(said, max(columns - COUNTS, COUNTS))
        shape = "{desc}: |{bar}| {n_fmt}/{total_fmt}, {remaining} left"
        how.setdefault("bar_format", shape)
    return _Bar(**how)


def note(text: str) -> None:
    """Write a line on standard error, beside bars."""
    _drawn_bar().write(text, file=sys.stderr)


def counted(items: Collection[T], shown: bool, **how: Any) -> Iterator[T]:
    """Items, one after the other, in a :func:`bar` of how many are done."""
    with bar(shown, total=len(items), **how) as report:
        for item in items:
            yield item
            if report is not None:
                report(1)


class Announcement:
    """Function that reports rays, and warns once if the rest of them takes long.

    The first report tells no speed, for until then kernels were compiled.

    Parameters
    ----------
    report : callable, optional
        What is called with the rays of each report.
    total : float
        Rays in all.
    """

    def __init__(self, report: Callable[[float], Any] | None, total: float) -> None:
        self.report, self.left = report, total
        self.timed, self.started = 0.0, math.nan
        self.announced = False

    def __call__(self, rays: float) -> None:
        """Report so many more rays."""
        if self.report is not None:
            self.report(rays)
        self.left -= rays
        now = time.monotonic()
        if math.isnan(self.started):
            self.started = now
            return
        self.timed += rays
        elapsed = now - self.started
        if self.announced or elapsed < TRIAL or not self.timed:
            return
        seconds = self.left * elapsed / self.timed
        if seconds > MIN_ANNOUNCED:
            self.announced = True
            warn(
                f"{self.timed:.3g} rays took {elapsed:.0f} s; the other "
                f"{self.left:.3g} are expected to take {seconds / 3600:.3g} hours; "
                "fewer rays need less"
            )


class _Progress:
    """Context of the function to report to, which counts.

    Attributes
    ----------
    n : float
        Count, including the initial one.
    started : float
        Time of the monotonic clock.
    """

    def __init__(self, initial: float = 0, **how: Any) -> None:
        self.n, self.initial, self.how = initial, initial, how
        self.started = math.nan

    def __enter__(self) -> Callable[[float], Any]:
        self.started = time.monotonic()
        return self.report

    def report(self, n: float) -> None:
        """Add to the count, and update the display if it is due."""
        self.n += n
        self.show()

    def show(self) -> None:
        """Update the display if it is due."""
        raise NotImplementedError


class _Bar(_Progress):
    """Progress in place, drawn by tqdm once `delay` seconds have passed."""

    drawn: Any = None

    def __enter__(self) -> Callable[[float], Any]:
        report = super().__enter__()
        if not self.how.get("delay"):
            self.show()
        return report

    def show(self) -> None:
        """Draw it, in whole numbers of what is counted."""
        waited = time.monotonic() - self.started
        if self.drawn is None and waited >= self.how.get("delay", 0):
            how = {"leave": False, "miniters": 1, "initial": self.initial}
            self.drawn = _drawn_bar()(**how | self.how)
            self.drawn.start_t -= waited
            self.drawn.last_print_t -= waited
        if self.drawn is not None:
            self.drawn.update(round(self.n) - self.drawn.n)

    def __exit__(self, *_: object) -> None:
        if self.drawn is not None:
            self.drawn.close()


@functools.cache
def _drawn_bar() -> Any:
    """Class of tqdm's bars, which takes a tenth of a second to import."""
    from tqdm import tqdm

    class Bar(tqdm):
        monitor_interval = 0  # no thread of tqdm's own

    # of this process only: locks between processes are slow to import
    Bar.set_lock(threading.RLock())
    return Bar


class _Lines(_Progress):
    """Progress in lines, of which the first comes after a while.

    Attributes
    ----------
    written, alive : float
        When the last line was, and when any progress was heard of last, by the
        monotonic clock: after a pause as long as between lines the clock starts anew.
    """

    written = alive = -PAUSE

    def __enter__(self) -> Callable[[float], Any]:
        report = super().__enter__()
        if self.started - _Lines.alive > PAUSE:
            _Lines.written = self.started
        _Lines.alive = self.started
        self._ended = threading.Event()
        threading.Thread(target=self._watch, name=WATCH, daemon=True).start()
        return report

    def _watch(self) -> None:
        """Write also while nothing is reported."""
        while not self._ended.wait(PAUSE):
            self.show()

    def show(self) -> None:
        """Write a line, if it is time."""
        now = _Lines.alive = time.monotonic()
        if now - _Lines.written >= PAUSE:
            _Lines.written = now
            print(self._line(now - self.started), file=sys.stderr, flush=True)

    def _line(self, elapsed: float) -> str:
        """What is done, in words."""
        total, said = self.how.get("total"), self.how.get("desc") or ""
        shape = "{n_fmt} of {total_fmt} {unit}s, {remaining} left"
        if total is None:
            shape = "{n_fmt} {unit}s, {elapsed} so far"
        line: str = _drawn_bar().format_meter(
            round(self.n),
            total,
            elapsed,
            prefix=said,
            unit=self.how.get("unit", "it"),
            unit_scale=self.how.get("unit_scale", False),
            initial=self.initial,
            bar_format=f"{{desc}}: {shape}" if said else shape,
        )
        return line

    def __exit__(self, *_: object) -> None:
        self._ended.set()

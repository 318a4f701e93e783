"""A progress bar on standard error, or lines where that is no terminal."""

import math
import shutil
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import Any, TypeVar

from tqdm import tqdm

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

    Where standard error is a file or a pipe, a line is written about every 30 seconds,
    however many bars there are one after the other. `how` are the arguments of
    :class:`tqdm.tqdm`.
    """
    if not shown:
        return nullcontext()
    notebook = type(sys.stderr).__module__.startswith("ipykernel")
    in_place = sys.stderr.isatty() or notebook
    if not in_place:
        return _Lines(leave=False, **how)
    said = how.get("desc")
    if said and how.get("total") is not None:
        columns = shutil.get_terminal_size((80, 24)).columns
        how["desc"] = abridged(said, max(columns - COUNTS, COUNTS))
        shape = "{desc}: |{bar}| {n_fmt}/{total_fmt}, {remaining} left"
        how.setdefault("bar_format", shape)
    return _Bar(leave=False, miniters=1, **how)


def note(text: str) -> None:
    """Write a line on standard error, beside bars."""
    _Bar.write(text, file=sys.stderr)


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


class _Bar(tqdm):
    """Progress bar whose context is its function to report."""

    monitor_interval = 0  # no thread of tqdm's own

    def __enter__(self) -> Callable[[float], Any]:
        super().__enter__()
        return self.update

    @property
    def format_dict(self) -> dict[str, Any]:
        """What is shown, in whole numbers of what is counted."""
        return super().format_dict | {"n": round(self.n)}


# of this process only: locks between processes are slow to import
_Bar.set_lock(threading.RLock())


class _Lines(_Bar):
    """Progress in lines, of which the first comes after a while.

    Attributes
    ----------
    written, alive : float
        When the last line was, and when any progress was heard of last, by the
        monotonic clock: after a pause as long as between lines the clock starts anew.
    """

    written = alive = -PAUSE

    def __init__(self, **how: Any) -> None:
        self._ended = threading.Event()
        now = time.monotonic()
        if now - _Lines.alive > PAUSE:
            _Lines.written = now
        _Lines.alive = now
        shape = "{desc}{n_fmt} of {total_fmt} {unit}s, {remaining} left"
        if how.get("total") is None:
            shape = "{desc}{n_fmt} {unit}s, {elapsed} so far"
        if how.get("desc"):
            shape = shape.replace("{desc}", "{desc}: ")
        own = {"bar_format": shape, "mininterval": 0, "miniters": 1, "delay": 0}
        super().__init__(**how | own)

    def __enter__(self) -> Callable[[float], Any]:
        threading.Thread(target=self._watch, name=WATCH, daemon=True).start()
        return super().__enter__()

    def _watch(self) -> None:
        """Write also while nothing is reported."""
        while not self._ended.wait(PAUSE):
            self.display()

    def display(self, *_: Any, **__: Any) -> None:
        """Write a line, if it is time."""
        now = _Lines.alive = time.monotonic()
        if now - _Lines.written >= PAUSE:
            _Lines.written = now
            print(self, file=sys.stderr, flush=True)

    def close(self) -> None:
        """End; there is nothing to wipe out, and no place on a terminal is kept."""
        if not self._ended.is_set():
            self._decr_instances(self)
        self.disable = True
        self._ended.set()

"""CPU seconds, and repetitions in turns."""

import resource
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import median
from typing import Any


def cpu_seconds() -> float:
    """CPU seconds spent so far by all threads and by finished child processes."""
    own, children = (
        resource.getrusage(who)
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


def peak_memory() -> int:
    """Largest resident set of this process so far, in bytes (Linux)."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


@dataclass(frozen=True)
class Times:
    """Median CPU seconds of all threads, and seconds on the clock."""

    cpu: float
    wall: float


def in_turns(runs: Mapping[Any, Callable[[], Any]], repeats: int) -> dict[Any, Times]:
    """Median times of every run; all are warmed up, then repeated one after another.

    Parameters
    ----------
    runs : dict of str to callable
        Called without arguments.
    repeats : int

    Returns
    -------
    dict of str to Times
    """
    for run in runs.values():
        run()
    spent: dict[Any, list[tuple[float, float]]] = {name: [] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            cpu, wall = cpu_seconds(), time.perf_counter()
            run()
            spent[name].append((cpu_seconds() - cpu, time.perf_counter() - wall))
    return {
        name: Times(*(median(column) for column in zip(*times)))
        for name, times in spent.items()
    }


def speeds(times: Mapping[tuple[str, ...], Times], n: int) -> list[tuple[str, ...]]:
    """Rows of a table of speeds, relative to the first.

    Parameters
    ----------
    times : dict of tuple of str to Times
        The first cells of each row, and how long `n` rays or paths took.
    n : int

    Returns
    -------
    list of tuple of str
        Those cells, core-nanoseconds for each, millions a second, and the speed.
    """
    first = next(iter(times.values())).cpu
    return [
        (
            *cells,
            f"{1e9 * time.cpu / n:.4g}",
            f"{n / time.wall / 1e6:.3g}",
            f"{first / time.cpu:.2f}",
        )
        for cells, time in times.items()
    ]

"""How many threads Dr.Jit has."""

import contextlib
from collections.abc import Iterator

import drjit as dr


@contextlib.contextmanager
def thread_count(n: int | None) -> Iterator[None]:
    """Context with `n` threads of Dr.Jit; with those that there are for None or 0."""
    before = dr.thread_count()
    dr.set_thread_count(n or before)
    try:
        yield
    finally:
        dr.set_thread_count(before)


def two_threads() -> contextlib.AbstractContextManager[None]:
    """Context in which Dr.Jit has at least two threads.

    Mitsuba 3.9.1 reads and writes EXR files in Dr.Jit's threads other than the one that
    asks for it: where there is none, as on a single core, it waits for ever.
    """
    return thread_count(None if dr.thread_count() > 1 else 2)

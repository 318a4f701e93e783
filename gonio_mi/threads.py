"""Threads of Dr.Jit that Mitsuba needs to read files."""

import contextlib
from collections.abc import Iterator


@contextlib.contextmanager
def two_threads() -> Iterator[None]:
    """Context in which Dr.Jit has at least two threads.

    Mitsuba 3.9.1 reads and writes EXR files in Dr.Jit's threads other than the one that
    asks for it: where there is none, as on a single core, it waits for ever.
    """
    import drjit as dr

    before = dr.thread_count()
    if before > 1:
        yield
        return
    dr.set_thread_count(2)
    try:
        yield
    finally:
        dr.set_thread_count(before)

"""How many threads Dr.Jit has, and which of Python's it works for."""

import contextlib
import threading
from collections.abc import Iterator

import drjit as dr

from .progress import WATCH

# Dr.Jit records side effects, such as the sums of a tally, in one state for all
# threads: one at a time records and launches kernels, or changes what they depend on.
drjit_lock = threading.RLock()


@contextlib.contextmanager
def thread_count(n: int | None) -> Iterator[None]:
    """Context with `n` threads of Dr.Jit; with those that there are for None or 0.

    No other thread records meanwhile: what Dr.Jit has set aside for each of its threads
    as a sum was recorded would not do for more of them when it is evaluated.

    Dr.Jit 1.5 ends threads with Python's lock held. If one of them builds a plugin in
    Python for another thread's ``mi.load_file`` just then, both wait for ever.
    """
    with drjit_lock:
        before = dr.thread_count()
        try:
            dr.set_thread_count(n or before)
            yield
        finally:
            dr.set_thread_count(before)


def park_threads() -> None:
    """Let Dr.Jit's threads sleep, unless others of Python's might need them just then.

    Idle ones spin for 20 ms after a kernel; new ones sleep until there is work. To end
    one and make it anew takes up to 80 microseconds.
    """
    if sum(one.name != WATCH for one in threading.enumerate()) == 1:
        with thread_count(1):
            pass


@contextlib.contextmanager
def two_threads() -> Iterator[None]:
    """Context in which Dr.Jit has at least two threads.

    Mitsuba 3.9.1 reads and writes EXR files in Dr.Jit's threads other than the one that
    asks for it: where there is none, as on a single core, it waits for ever.
    """
    with drjit_lock, thread_count(max(2, dr.thread_count())):
        yield


def take_two_threads() -> None:
    """Let Dr.Jit have two threads from now on, if it has one: see :func:`two_threads`.

    For the constructors of plugins, which Mitsuba may call in Dr.Jit's threads: whoever
    ended one of these would wait for it, with Python's lock, for which it waits. Nor do
    they wait for the thread that loads them, which may hold `drjit_lock`.
    """
    if dr.thread_count() == 1:
        dr.set_thread_count(2)

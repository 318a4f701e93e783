"""How many threads Dr.Jit has, and which of Python's it works for."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING

import drjit as dr

if TYPE_CHECKING:
    import ctypes

# Dr.Jit records side effects, such as the sums of a tally, in one state for all
# threads: one at a time records and launches kernels, or changes what they depend on.
drjit_lock = threading.RLock()

# A process that was forked from this one has none of the threads that Dr.Jit counts.
_process = os.getpid()


@contextlib.contextmanager
def thread_count(n: int | None) -> Iterator[None]:
    """Context with `n` threads of Dr.Jit; with those that there are for None or 0.

    Nothing changes in a forked process, whose threads may be those of its parent.
    """
    with drjit_lock:
        before = dr.thread_count()
        if not n or n == before or _is_forked():
            yield
            return
        with _changed(before, n):
            yield


@contextlib.contextmanager
def two_threads() -> Iterator[None]:
    """Context in which Dr.Jit has at least two threads: see :func:`reads_files`."""
    with drjit_lock:
        alone = dr.thread_count() == 1 and not _is_forked()
        with _changed(1, 2) if alone else reads_files():
            yield


def reads_files() -> contextlib.AbstractContextManager[None]:
    """Context in which Mitsuba can read and write EXR files, in any thread.

    Mitsuba 3.9.1 does so in Dr.Jit's threads other than the one that asks for it: where
    there is none, as on a single core or after a fork, it waits for ever.

    For the constructors of plugins, too, which Mitsuba may call in Dr.Jit's threads:
    nothing waits for the thread that loads them, which may hold `drjit_lock`.
    """
    needed = _is_forked() or dr.thread_count() == 1
    return _helper() if needed else contextlib.nullcontext()


def _is_forked() -> bool:
    """Whether this process was forked from the one that has Dr.Jit's threads."""
    return os.getpid() != _process


@contextlib.contextmanager
def _changed(before: int, n: int) -> Iterator[None]:
    """Context with `n` threads of Dr.Jit instead of those `before`.

    No other thread may record meanwhile: what Dr.Jit has set aside for each of its
    threads as a sum was recorded would not do for more of them when it is evaluated.
    """
    try:
        _set_thread_count(n)
        yield
    finally:
        _set_thread_count(before)


@contextlib.contextmanager
def _helper() -> Iterator[None]:
    """Context in which a thread of Python's does what is left to Dr.Jit's.

    It never sleeps: in a forked process Dr.Jit may take a thread of the parent for
    awake, and wake no other.
    """
    import ctypes  # slow to import

    library, leave = _nanothread(), ctypes.create_string_buffer(2)
    is_over = ctypes.cast(ctypes.CDLL(None).strlen, ctypes.c_void_p)  # once not empty
    how = None, is_over, leave
    helper = threading.Thread(target=library.pool_work_until, args=how, daemon=True)
    helper.start()
    try:
        yield
    finally:
        leave[0] = b"1"
        helper.join()


def _nanothread() -> ctypes.CDLL:
    """The library whose threads are Dr.Jit's."""
    import ctypes
    from pathlib import Path

    (path,) = Path(dr.__file__).parent.glob("*nanothread.[sd][oyl]*")
    return ctypes.CDLL(str(path))


def _set_thread_count(n: int) -> None:
    """Let Dr.Jit have `n` threads from now on, after what it has recorded is computed.

    ``dr.set_thread_count`` of Dr.Jit 1.5 waits for threads with Python's lock held. One
    that needs it just then, to build a plugin in Python or to release an image that it
    has written, would wait for ever, too. What `ctypes` calls does not hold it.
    """
    dr.eval()
    dr.sync_thread()
    _nanothread().pool_set_size(None, n, 0)

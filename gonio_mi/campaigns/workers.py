"""Processes that measure: they end with the one that started them, however it died."""

import contextlib
import ctypes
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing.connection import Connection, wait
from typing import Any

# Linux' prctl(2): the signal that a process gets when its parent dies.
PR_SET_PDEATHSIG = 1

# Python 3.11 and later start without the current folder in their search path.
SAFE_PATH = "PYTHONSAFEPATH"


@contextlib.contextmanager
def workers(n: int) -> Iterator[ProcessPoolExecutor]:
    """Context of an executor of `n` processes on this machine.

    They end at once, whatever they are doing, when the context is left by an exception
    and when this process dies.
    """
    # what is forked from a process with threads may hang
    spawn = multiprocessing.get_context("spawn")
    ending, held = spawn.Pipe(duplex=False)
    arguments = (ending, os.getpid())
    with _spawning():  # Python's own tracker of semaphores
        pool = _Workers(n, spawn, initializer=_begin, initargs=arguments)
    try:
        yield pool
        pool.shutdown()
    finally:
        held.close()
        pool.shutdown(cancel_futures=True)
        ending.close()


class _Workers(ProcessPoolExecutor):
    """Executor whose processes, started as they are needed, are deaf to Ctrl-C."""

    def submit(self, *args: Any, **kwargs: Any) -> Future[Any]:
        with _spawning():
            return super().submit(*args, **kwargs)


@contextlib.contextmanager
def _spawning() -> Iterator[None]:
    """Context in which processes are started.

    Ctrl-C is not for them: this process answers it. They import none of the standard
    library's modules from the current folder.
    """
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    blocks = hasattr(signal, "pthread_sigmask")
    if blocks:
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        if before is None:
            del os.environ[SAFE_PATH]
        else:
            os.environ[SAFE_PATH] = before
        if blocks:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _begin(ending: Connection, parent: int) -> None:
    """Prepare a worker to end with its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        # also where a library holds Python's lock
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it died before
            os._exit(1)
    threading.Thread(target=_end_with, args=(ending,), daemon=True).start()


def _end_with(ending: Connection) -> None:
    """End this process when the other end of the pipe is closed."""
    wait([ending])
    os._exit(1)

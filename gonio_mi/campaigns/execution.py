"""Tasks of campaigns are executed: in this process or others, beside a folder.

Processes that measure end with the one that started them, however it died.
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import (
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    as_completed,
)
from contextlib import nullcontext
from dataclasses import dataclass
from itertools import groupby
from multiprocessing.connection import Connection, wait
from operator import attrgetter
from os import PathLike
from pathlib import Path
from typing import Any

from ..errors import SettingError, warn
from ..progress import bar
from ..results.provenance import DIGESTS
from ..results.record import Record
from ..specimen.specimen import Specimen
from .folder import CampaignFolder
from .tasks import TASKS, Task, check_picklable, run_task, tasks_of

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class ExecutionContext:
    """Where and how the tasks of a campaign are done.

    Attributes are the arguments of :func:`~gonio_mi.campaigns.campaign.campaign` of
    the same name; and for the progress bar of a round how many directions were
    `measured` in others before, and how many are `expected` in all rounds.
    """

    executor: Executor | int | None = None
    folder: str | PathLike[str] | None = None
    plugins: Sequence[str | PathLike[str]] = ()
    threads: int | None = None
    retries: int = 3
    progress: bool = False
    measured: int = 0
    expected: float = 0


def records_of(
    specimens: Mapping[str, Any],
    incidents: Sequence[tuple[float, float]],
    where: ExecutionContext,
    arguments: dict[str, Any],
    label: str | None = None,
) -> dict[str, Record]:
    """Stack of all incident directions for each specimen, by name.

    `label` stands beside the progress bar.
    """
    # what is neither kept nor shared out costs less in one part
    parts = 1 if where.executor is None and where.folder is None else TASKS
    plugins, threads = where.plugins, where.threads
    tasks = tasks_of(specimens, incidents, plugins, threads, arguments, parts)
    if where.executor is not None:
        check_picklable(tasks)
    folder = where.folder
    kept = None if folder is None else CampaignFolder(folder, tasks, incidents)
    with kept or nullcontext():
        done = _records(tasks, kept, where, label)
    return {
        str(name): Record.stack(
            done[task.number] for task in tasks if task.name == str(name)
        )
        for name in specimens
    }


def _records(
    tasks: Sequence[Task],
    folder: CampaignFolder | None,
    where: ExecutionContext,
    label: str | None,
) -> dict[int, Record]:
    """Records of all tasks by number: those of the folder, and the others measured."""
    done = {} if folder is None else folder.load(tasks)
    todo = [task for task in tasks if task.number not in done]
    if folder is not None and done:
        _check_specimens(tasks, done, folder.folder)
        logger.info("%d of %d tasks were finished before", len(done), len(tasks))
    n_done = where.measured + sum(len(record) for record in done.values())
    total = where.measured + sum(len(task.incidents) for task in tasks)
    total = max(total, round(where.expected))
    shown_as = {"total": total, "initial": n_done, "unit": "direction", "desc": label}
    with bar(where.progress, **shown_as) as report:

        def keep(task: Task, record: Record) -> None:
            """Write a finished task to the folder, if any, and count it."""
            if folder is not None:
                folder.save(task, record)
            done[task.number] = record
            if report is not None:
                report(len(record))

        _finish(todo, where.executor, where.retries, keep)
    return done


def _check_specimens(
    tasks: Sequence[Task], done: Mapping[int, Record], folder: Path
) -> None:
    """Raise ValueError if finished records are of specimens that have changed since."""
    names = {}
    for task in tasks:
        if task.number in done:
            if task.name not in names:
                names[task.name] = task.digests()
            for key, own in names[task.name].items():
                found = getattr(done[task.number].provenance, key)
                if found != own:
                    raise SettingError(
                        f"folder must hold this very campaign, but in {folder} "
                        f"{DIGESTS[key]} of {task.name} was another: its digest is "
                        f"{found} instead of {own}; take another folder"
                    )


def _finish(
    todo: Sequence[Task],
    executor: Executor | int | None,
    retries: int,
    keep: Callable[[Task, Record], None],
) -> None:
    """Run tasks and keep their records as they come; those of dead workers again."""
    if executor is None:
        for _, alike in groupby(todo, key=attrgetter("name")):
            loaded: list[Specimen] = []
            try:
                for task in alike:
                    keep(task, task.record(loaded))
            finally:
                loaded.clear()
        return
    for left in range(retries, -1, -1):
        pools: Any = workers if isinstance(executor, int) else nullcontext
        with pools(executor) as pool:
            todo, death = _shared_out(todo, pool, keep)
        if death is None:
            return
        if not left or isinstance(executor, Executor):
            raise death
        warn(f"a worker process died; {len(todo)} tasks are repeated")


def _shared_out(
    todo: Sequence[Task], pool: Executor, keep: Callable[[Task, Record], None]
) -> tuple[list[Task], BrokenExecutor | None]:
    """Keep what a pool measures; return the tasks of workers that died, and of what."""
    missing = {pool.submit(run_task, task): task for task in todo}
    lost, death = [], None
    try:
        for future in as_completed(list(missing)):
            try:
                record = future.result()
            except BrokenExecutor as error:
                death = error
                lost.append(missing.pop(future))
                continue
            keep(missing[future], record)
            del missing[future]
    finally:
        # after Ctrl-C or an error: what came meanwhile
        for future, task in missing.items():
            if not future.cancel() and future.done() and not future.exception():
                keep(task, future.result())
    return lost, death


# ---------------------------------------------------------------------------- processes

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
    try:
        with _spawning():  # Python's own tracker of semaphores
            pool = _Workers(n, spawn, initializer=_begin, initargs=arguments)
    except OSError as error:  # which names no file
        reason = f"workers need semaphores in shared memory: {error.strerror}"
        raise type(error)(error.errno, reason, "/dev/shm") from None
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


# All threads have the same environment.
_environment = threading.Lock()


@contextlib.contextmanager
def _spawning() -> Iterator[None]:
    """Context in which processes are started, by one thread at a time.

    Ctrl-C is not for them: this process answers it. They import none of the standard
    library's modules from the current folder.
    """
    with _environment:
        before = os.environ.get(SAFE_PATH)
        os.environ[SAFE_PATH] = "1"
        blocks = hasattr(signal, "pthread_sigmask")
        if blocks:
            mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            os.environ.pop(SAFE_PATH, None)
            if before is not None:
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

"""Campaigns: specimens times directions, in this process or in others, resumable."""

import logging
import multiprocessing
import os
import pickle
import warnings
from collections.abc import Mapping
from concurrent.futures import (
    BrokenExecutor,
    Executor,
    ProcessPoolExecutor,
    as_completed,
)
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from threading import Lock

import drjit as dr
import mitsuba as mi

from ..errors import checked_count
from ..progress import bar
from ..results.record import Record
from ..transport.digest import specimen_digest
from ..transport.specimen import Specimen
from .campaign_folder import CampaignFolder
from .incidence import incident_angles, lamp_digest
from .loading import check_variant, load_plugin_file, load_specimen, specimen_name
from .measurement import measure

__all__ = ["campaign"]

logger = logging.getLogger(__name__)

# Rays of one task, if there are directions enough for so many tasks: setting up a
# specimen is worth some 1e6 rays, but what is finished is kept, and shared out among
# workers, by task.
TASK_RAYS = 10**7
TASKS = 16
DEFAULT_RAYS = 10**6


def campaign(
    specimens,
    theta_i,
    phi_i=0.0,
    *,
    executor=None,
    folder=None,
    plugins=(),
    threads=None,
    retries=3,
    progress=False,
    **settings,
):
    """Measure specimens at many incident directions, here or elsewhere.

    Every direction has the bits that :func:`measure` gives it: whatever the executor,
    the number of its workers and their order.

    Parameters
    ----------
    specimens : mapping of str to specimen
        By name, what :func:`measure` takes; for other processes a dictionary or a path.
    theta_i, phi_i : float or sequence of float
        In degrees: all azimuths for the first angle, then for the second, and so on.
    executor : concurrent.futures.Executor or int, optional
        Where to measure: that many processes on this machine (scripts need the usual
        ``if __name__ == "__main__":``), or any executor such as Dask's
        ``client.get_executor()``. Default: this process.
    folder : path, optional
        Where finished tasks are kept, as records. Started again with the same
        arguments, a campaign that was killed measures only what is missing. Specimens
        whose files or data have changed since are refused, as far as their ``digest``
        shows it (:func:`gonio_mi.transport.digest.digest`).
    plugins : sequence of path
        Python files that register plugins, to be run in each worker first.
    threads : int, optional
        Threads of each worker. Default: all cores, or for `executor` an int its share.
    retries : int
        How often tasks are sent again whose worker died.
    progress : bool
        Show a progress bar on standard error.
    **settings
        All other arguments of :func:`measure`.

    Returns
    -------
    dict of Record
        A stack of all incident directions for each name.

    Raises
    ------
    TypeError, ValueError
        If a setting is out of its range, `folder` holds another campaign, or a specimen
        cannot be sent to another process.
    concurrent.futures.BrokenExecutor
        If workers keep dying. What is finished is in `folder`.
    """
    check_variant()
    if not isinstance(specimens, Mapping) or not specimens:
        raise TypeError(
            f"specimens must be a dictionary with at least one entry, got {specimens!r}"
        )
    incidents, _ = incident_angles(theta_i, phi_i)
    if None in incidents:
        raise ValueError("theta_i must be given for a campaign, got None")
    workers = executor if isinstance(executor, int) else None
    if workers is not None:
        checked_count("executor", workers)
        threads = threads or max(1, (os.cpu_count() or 1) // workers)
    tasks = _tasks(specimens, incidents, plugins, threads, settings)
    if executor is not None:
        _check_picklable(tasks)
    kept = None if folder is None else CampaignFolder(folder, tasks, incidents)
    done = {} if kept is None else kept.load(tasks)
    todo = [task for task in tasks if task.number not in done]
    if done:
        _check_specimens(tasks, done, folder)
        logger.info("%d of %d tasks were finished before", len(done), len(tasks))
    n_done = sum(len(record) for record in done.values())
    total = len(incidents) * len(specimens)
    with bar(progress, total=total, initial=n_done, unit="direction") as report:
        for task, record in _finished(todo, executor, retries):
            done[task.number] = record
            if kept is not None:
                kept.save(task, record)
            if report is not None:
                report(len(record))
    return {
        str(name): Record.stack(
            done[task.number] for task in tasks if task.name == str(name)
        )
        for name in specimens
    }


# ---------------------------------------------------------------------------- tasks


@dataclass(frozen=True)
class _Task:
    """Some directions of one specimen; all that another process needs."""

    number: int
    name: str
    specimen: object
    incidents: tuple
    variant: str
    plugins: tuple
    directory: str  # of relative paths
    threads: int | None
    settings: dict = field(hash=False)

    def run(self):
        """Measure, in any process: records of the directions, stacked."""
        with _here:  # threads of one process share Dr.Jit and the variant
            if mi.variant() != self.variant:
                mi.set_variant(self.variant)
            for path in self.plugins:
                load_plugin_file(path)
            with _threads(self.threads), warnings.catch_warnings():
                # what a campaign keeps is whole directions
                warnings.filterwarnings("ignore", "interrupted: ", RuntimeWarning)
                return Record.stack(map(self._measured, self.incidents))

    def _measured(self, incident):
        """Record of one direction; Ctrl-C is raised, even if there is part of it."""
        record = measure(self._located(), *incident, **self.settings)
        if record.settings.get("interrupted"):
            raise KeyboardInterrupt
        # the same wherever it is measured
        name = specimen_name(self.specimen, self.settings.get("parameters"))
        record.settings["specimen"] = name
        return record

    def digests(self):
        """Digests of the specimen and the emitter as they are now."""
        with _here:
            for path in self.plugins:
                load_plugin_file(path)
            scene = load_specimen(self._located(), self.settings.get("parameters"))
            return {
                "digest": specimen_digest(Specimen(scene)),
                "emitter_digest": lamp_digest(self.settings.get("emitter")),
            }

    def _located(self):
        """Return the specimen; if it is a file, its path from anywhere."""
        if isinstance(self.specimen, (str, os.PathLike)):
            return os.path.join(self.directory, self.specimen)
        return self.specimen


_here = Lock()


def _run(task):
    """Run a task; a function of the module, so that it can be sent."""
    return task.run()


@contextmanager
def _threads(n):
    """Context with `n` threads of Dr.Jit."""
    before = dr.thread_count()
    if n:
        dr.set_thread_count(n)
    try:
        yield
    finally:
        dr.set_thread_count(before)


def _tasks(specimens, incidents, plugins, threads, settings):
    """Tasks of a few directions each, in order."""
    rays = settings.get("rays") or DEFAULT_RAYS
    # the same whatever the executor: a folder may be carried on by another
    most = max(1, len(incidents) // TASKS)
    few = 1 if settings.get("rel_err") else max(1, min(int(TASK_RAYS // rays), most))
    plugins = tuple(os.path.abspath(path) for path in plugins)
    tasks = []
    for name, specimen in specimens.items():
        for first in range(0, len(incidents), few):
            some = tuple(incidents[first : first + few])
            tasks.append(
                _Task(
                    len(tasks),
                    str(name),
                    specimen,
                    some,
                    mi.variant(),
                    plugins,
                    os.getcwd(),
                    threads,
                    settings,
                )
            )
    return tasks


def _check_specimens(tasks, done, folder):
    """Raise ValueError if finished records are of specimens that have changed since."""
    names = {}
    for task in tasks:
        if task.number in done:
            if task.name not in names:
                names[task.name] = task.digests()
            for key, own in names[task.name].items():
                found = done[task.number].settings.get(key, own)
                if found is not None and found != own:
                    thing = "specimen" if key == "digest" else "emitter"
                    raise ValueError(
                        "folder must hold this very campaign, but in "
                        f"{os.fspath(folder)} the {thing} of {task.name} was another "
                        f"one: its digest is {found} instead of {own}"
                    )


def _check_picklable(tasks):
    """Raise ValueError for a specimen or setting that other processes cannot get."""
    for task in tasks:
        for label, value in {task.name: task.specimen, **task.settings}.items():
            try:
                pickle.dumps(value)
            except Exception:  # whatever the objects' classes raise
                raise ValueError(
                    f"{label} must be plain values or a path to be measured in another "
                    f"process, got {value!r:.80}"
                ) from None


# ------------------------------------------------------------------------ executing


def _finished(todo, executor, retries):
    """Tasks and their records as they come; those of dead workers are sent again."""
    if executor is None:
        yield from ((task, task.run()) for task in todo)
        return
    for attempt in range(retries + 1):
        missing = {task.number: task for task in todo}
        with _started(executor) as pool:
            futures = {pool.submit(_run, task): task for task in todo}
            try:
                for future in as_completed(futures):
                    task = futures[future]
                    try:
                        record = future.result()
                    except BrokenExecutor:
                        if attempt == retries or isinstance(executor, Executor):
                            raise
                        continue
                    del missing[task.number]
                    yield task, record
            finally:
                for future in futures:
                    future.cancel()
        todo = list(missing.values())
        if not todo:
            return
        warnings.warn(
            f"a worker died; {len(todo)} tasks are sent again",
            RuntimeWarning,
            stacklevel=3,
        )


def _started(executor):
    """Context of the executor; a new one of processes for their number."""
    if isinstance(executor, int):
        # what is forked from a process with threads may hang
        spawn = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(executor, mp_context=spawn)
    return nullcontext(executor)

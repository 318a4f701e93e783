"""Tasks of a campaign: directions of a specimen, measured here or elsewhere."""

from __future__ import annotations

import copyreg
import logging
import os
import pickle
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, as_completed
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from threading import Lock
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import SettingError, SpecimenError, frames, shown
from ..instrument.incidence import described_digest, emitter_scene
from ..instrument.loading import load_plugin_file, load_specimen
from ..instrument.measure import measure_each, whole
from ..instrument.specimen_text import specimen_name
from ..progress import bar
from ..results.record import Record
from ..settings import MeasurementSettings
from ..transport.digest import file_digest, plugins_digest
from ..transport.specimen import Specimen
from .folder import CampaignFolder
from .workers import workers

__all__ = ["Surroundings", "records_of"]

logger = logging.getLogger(__name__)

# Rays of one task, if there are directions enough for so many tasks: setting up a
# specimen is worth some 1e6 rays, but what is finished is kept, and shared out among
# workers, by task.
TASK_RAYS = 10**7
TASKS = 16

# Incident directions of a task whose integrals are found together.
INTEGRALS = 16


@dataclass(frozen=True)
class Surroundings:
    """Where and how the tasks of a campaign are done.

    Attributes are the arguments of :func:`~gonio_mi.campaigns.campaign.campaign` of
    the same name.
    """

    executor: Any = None
    folder: str | PathLike[str] | None = None
    plugins: Sequence[str | PathLike[str]] = ()
    threads: int | None = None
    retries: int = 3
    progress: bool = False


def records_of(
    specimens: Mapping[str, Any],
    incidents: Sequence[tuple[float, float]],
    where: Surroundings,
    arguments: dict[str, Any],
    said: str | None = None,
) -> dict[str, Record]:
    """Stack of all incident directions for each specimen, by name.

    `said` describes what is done, beside the progress bar.
    """
    tasks = _tasks(specimens, incidents, where.plugins, where.threads, arguments)
    if where.executor is not None:
        _check_picklable(tasks)
    folder = where.folder
    kept = None if folder is None else CampaignFolder(folder, tasks, incidents)
    with kept or nullcontext():
        done = _records(tasks, kept, where, said)
    return {
        str(name): Record.stack(
            done[task.number] for task in tasks if task.name == str(name)
        )
        for name in specimens
    }


def _records(
    tasks: Sequence[_Task],
    folder: CampaignFolder | None,
    where: Surroundings,
    said: str | None,
) -> dict[int, Record]:
    """Records of all tasks by number: those of the folder, and the others measured."""
    done = {} if folder is None else folder.load(tasks)
    todo = [task for task in tasks if task.number not in done]
    if folder is not None and done:
        _check_specimens(tasks, done, folder.folder)
        logger.info("%d of %d tasks were finished before", len(done), len(tasks))
    n_done = sum(len(record) for record in done.values())
    total = sum(len(task.incidents) for task in tasks)
    # a campaign of several rounds knows the time that is left of each only
    shown_as = {"total": total, "initial": n_done, "unit": "direction", "desc": said}
    with bar(where.progress, "this round", **shown_as) as report:

        def keep(task: _Task, record: Record) -> None:
            if folder is not None:
                folder.save(task, record)
            done[task.number] = record
            if report is not None:
                report(len(record))

        _finish(todo, where.executor, where.retries, keep)
    return done


# ---------------------------------------------------------------------------- tasks


@dataclass(frozen=True)
class _Task:
    """Some directions of one specimen; all that another process needs."""

    number: int
    name: str
    specimen: Any
    incidents: tuple[tuple[float, float], ...]
    variant: str
    plugins: tuple[Any, ...]  # of paths and digests
    directory: str  # of relative paths
    threads: int | None
    arguments: dict[str, Any] = field(hash=False)  # of `measure`, as they were given

    def run(self) -> Record:
        """Measure, in any process: records of the directions, stacked."""
        with _here:  # threads of one process share Dr.Jit and the variant
            mi.set_variant(self.variant)
            self._load_plugins()
            with _threads(self.threads):
                if MeasurementSettings.among(self.arguments).estimator.integrates:
                    return self._measured(self.incidents)  # with the same kernels
                return Record.stack(self._measured([one]) for one in self.incidents)

    def _measured(self, incidents: Sequence[tuple[float, float]]) -> Record:
        """Stack of some directions: what a campaign keeps is whole ones."""
        record = whole(measure_each, self._located(), incidents, **self.arguments)
        # the same wherever it is measured
        name = specimen_name(self.specimen, self.arguments.get("parameters"))
        return record.with_provenance(specimen=name)

    def digests(self) -> dict[str, str | None]:
        """Digests of the specimen and the emitter as they are now."""
        with _here:
            self._load_plugins()
            period = MeasurementSettings.among(self.arguments).period
            parameters = self.arguments.get("parameters")
            scene = load_specimen(self._located(), parameters, period)
            things, emitter = scene.shapes(), self.arguments.get("emitter")
            if emitter is not None:
                things += emitter_scene(None, emitter, None, "front").emitters()
            return {
                "digest": Specimen(scene).digest,
                "emitter_digest": described_digest(emitter),
                "plugin_digest": plugins_digest(things),
            }

    def _load_plugins(self) -> None:
        """Run the plugin files, if they are still those of the campaign."""
        for path, digest in self.plugins:
            load_plugin_file(path)
            if file_digest(path) != digest:
                raise SpecimenError(
                    f"plugin file {path} was edited while the campaign was at work: "
                    "what is finished is of the old one; start again in another folder"
                )

    def _located(self) -> Any:
        """Return the specimen; if it is a file, its path from anywhere."""
        if isinstance(self.specimen, (str, os.PathLike)):
            return os.path.join(self.directory, self.specimen)
        return self.specimen


_here = Lock()


def _run(task: _Task) -> Record:
    """Run a task; a function of the module, so that it can be sent."""
    try:
        return task.run()
    except Exception as error:
        failed: Any = error
        failed.frames = frames(error)  # the traceback itself is not sent back
        raise


@contextmanager
def _threads(n: int | None) -> Iterator[None]:
    """Context with `n` threads of Dr.Jit."""
    before = dr.thread_count()
    if n:
        dr.set_thread_count(n)
    try:
        yield
    finally:
        dr.set_thread_count(before)


def _tasks(
    specimens: Mapping[str, Any],
    incidents: Sequence[tuple[float, float]],
    plugins: Sequence[str | PathLike[str]],
    threads: int | None,
    arguments: dict[str, Any],
) -> list[_Task]:
    """Tasks of a few directions each, in order."""
    asked = MeasurementSettings.among(arguments)
    # the same whatever the executor: a folder may be carried on by another
    most = max(1, len(incidents) // TASKS)
    few = max(1, min(TASK_RAYS // asked.rays, most))
    if asked.estimator.integrates:
        few = INTEGRALS
    elif asked.rel_err or asked.noise:
        few = 1
    digests = tuple((os.path.abspath(path), file_digest(path)) for path in plugins)
    tasks: list[_Task] = []
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
                    digests,
                    os.getcwd(),
                    threads,
                    arguments,
                )
            )
    return tasks


def _check_specimens(
    tasks: Sequence[_Task], done: Mapping[int, Record], folder: Path
) -> None:
    """Raise ValueError if finished records are of specimens that have changed since."""
    things = {
        "digest": "the specimen",
        "emitter_digest": "the emitter",
        "plugin_digest": "the Python code",
    }
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
                        f"{things[key]} of {task.name} was another: its digest is "
                        f"{found} instead of {own}; take another folder"
                    )


def _check_picklable(tasks: Sequence[_Task]) -> None:
    """Raise ValueError for a specimen or setting that other processes cannot get."""
    copyreg.pickle(mi.ScalarTransform4f, _sent)  # of meshes, which cannot by themselves
    for task in tasks:
        for label, value in {task.name: task.specimen, **task.arguments}.items():
            try:
                pickle.dumps(value)
            except Exception:  # whatever the objects' classes raise
                raise SettingError(
                    f"{label} must be plain values or a path to be measured in another "
                    f"process, got {shown(value)}"
                ) from None


def _sent(transform: Any) -> tuple[Any, ...]:
    """What a transform is made of in another process."""
    return _received, (np.array(transform.matrix).tolist(), mi.variant())


def _received(matrix: list[list[float]], variant: str) -> Any:
    """Transform, in a process that may not have the variant of its task yet."""
    if mi.variant() is None:
        mi.set_variant(variant)
    return mi.ScalarTransform4f(matrix)


# ------------------------------------------------------------------------ executing


def _finish(
    todo: Sequence[_Task],
    executor: Any,
    retries: int,
    keep: Callable[[_Task, Record], None],
) -> None:
    """Run tasks and keep their records as they come; those of dead workers again."""
    if executor is None:
        for task in todo:
            keep(task, task.run())
        return
    for left in range(retries, -1, -1):
        with _started(executor) as pool:
            replaceable = left > 0 and not isinstance(executor, Executor)
            todo = _shared_out(todo, pool, keep, replaceable)
        if not todo:
            return
        warnings.warn(
            f"a worker died; {len(todo)} tasks are sent again",
            RuntimeWarning,
            stacklevel=4,
        )


def _shared_out(
    todo: Sequence[_Task],
    pool: Any,
    keep: Callable[[_Task, Record], None],
    replaceable: bool,
) -> list[_Task]:
    """Keep what a pool measures; return the tasks of workers that died."""
    missing = {pool.submit(_run, task): task for task in todo}
    lost = []
    try:
        for future in as_completed(list(missing)):
            try:
                record = future.result()
            except BrokenExecutor:
                if not replaceable:
                    raise
                lost.append(missing.pop(future))
                continue
            keep(missing[future], record)
            del missing[future]
    finally:
        # after Ctrl-C or an error: what came meanwhile
        for future, task in missing.items():
            if not future.cancel() and future.done() and not future.exception():
                keep(task, future.result())
    return lost


def _started(executor: Any) -> AbstractContextManager[Any]:
    """Context of the executor; a new one of processes for their number."""
    return workers(executor) if isinstance(executor, int) else nullcontext(executor)

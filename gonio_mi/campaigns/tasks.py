"""Tasks of a campaign: directions of a specimen, measured here or elsewhere."""

from __future__ import annotations

import contextlib
import copyreg
import os
import pickle
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import SettingError, SpecimenError, frames, shown
from ..estimators import METHODS
from ..instrument.incidence import described_digest, emitter_scene
from ..instrument.measure import measure_each
from ..kernels import launches_kernels
from ..results.record import Record
from ..settings import MeasurementSettings
from ..specimen.digest import file_digest, kinds_of, plugins_digest
from ..specimen.loading import load_plugin_file, specimen_of
from ..specimen.specimen import Specimen
from ..specimen.specimen_text import specimen_name
from ..threads import drjit_lock, thread_count
from ..variants import is_parallel

# Rays of one task, if there are directions enough for so many tasks: setting up a
# specimen is worth some 1e6 rays, but what is finished is kept, and shared out among
# workers, by task.
TASK_RAYS = 10**7
TASKS = 16

# Incident directions of a task, at most, where rays are asked for a precision: each may
# take minutes, but each task loads its specimen.
PRECISE = 4


@dataclass(frozen=True)
class Task:
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

    def record(self, loaded: list[Specimen]) -> Record:
        """Measure in any process; return the stack of all directions.

        The specimen is that in the list, or is loaded into it for the next task. The
        caller clears the list, so that the traceback of an error keeps no specimen.
        """
        # threads of one process share Dr.Jit and the variant
        with drjit_lock, _path_kept():
            mi.set_variant(self.variant)
            self._load_plugins()
            # releases the specimen from the frames of what is called, in an error
            with thread_count(self.threads), launches_kernels(is_parallel):
                if not loaded:
                    loaded.append(self._load())
                how, incidents = {"whole": True, **self.arguments}, self.incidents
                record = measure_each(loaded[0], incidents, **how)
        # the same in every folder and process
        name = specimen_name(self.specimen, self.arguments.get("parameters"))
        return record.with_provenance(specimen=name)

    def digests(self) -> dict[str, str | None]:
        """Current digests of the specimen, the emitter and their plugins."""
        with drjit_lock, _path_kept():
            self._load_plugins()
            specimen, emitter = self._load(), self.arguments.get("emitter")
            things = specimen.source.shapes()
            if emitter is not None:
                things += emitter_scene(None, emitter, None, "front").emitters()
            return {
                "digest": specimen.digest,
                "emitter_digest": described_digest(emitter),
                "plugin_digest": plugins_digest(kinds_of(things)),
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

    def _load(self) -> Specimen:
        """Load the specimen; a file, from any working directory."""
        specimen = self.specimen
        if isinstance(specimen, (str, os.PathLike)):
            specimen = os.path.join(self.directory, specimen)
        parameters, period = map(self.arguments.get, ("parameters", "period"))
        return specimen_of(specimen, parameters, period)


@contextlib.contextmanager
def _path_kept() -> Iterator[None]:
    """Restore the search path that plugin files change."""
    before = sys.path[:]
    try:
        yield
    finally:
        sys.path[:] = before


def run_task(task: Task) -> Record:
    """Run a task; a function of the module, so that it can be sent."""
    loaded: list[Specimen] = []
    try:
        return task.record(loaded)
    except Exception as error:
        failed: Any = error
        failed.frames = frames(error)  # the traceback itself is not sent back
        raise
    finally:
        loaded.clear()


def tasks_of(
    specimens: Mapping[str, Any],
    incidents: Sequence[tuple[float, float]],
    plugins: Sequence[str | PathLike[str]],
    threads: int | None,
    arguments: dict[str, Any],
    parts: int = TASKS,
) -> list[Task]:
    """Tasks of some directions each, in order: of a specimen `parts` at least."""
    asked = MeasurementSettings.among(arguments)
    # the same whatever the executor: a folder may be carried on by another
    most = max(1, len(incidents) // parts)
    few = max(1, min(TASK_RAYS // asked.rays, most))
    if task := METHODS[asked.estimator].task:
        few = task
    elif asked.rel_err or asked.noise:
        few = min(PRECISE, most)
    digests = tuple((os.path.abspath(path), file_digest(path)) for path in plugins)
    common = mi.variant(), digests, os.getcwd(), threads, arguments
    tasks: list[Task] = []
    for name, specimen in specimens.items():
        for first in range(0, len(incidents), few):
            some = tuple(incidents[first : first + few])
            tasks.append(Task(len(tasks), str(name), specimen, some, *common))
    return tasks


def check_picklable(tasks: Sequence[Task]) -> None:
    """Raise ValueError for a specimen or setting that cannot be pickled."""
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
    """Pickle a transform for another process."""
    return _received, (np.array(transform.matrix).tolist(), mi.variant())


def _received(matrix: list[list[float]], variant: str) -> Any:
    """Unpickle a transform, before the task has set its variant if need be."""
    if mi.variant() is None:
        mi.set_variant(variant)
    return mi.ScalarTransform4f(matrix)

"""The folder of a campaign: finished incident directions as files."""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import files
from ..errors import MAX_VALUE, FileFormatError, SettingError, abridged_apart
from ..files.writing import remove_forgotten
from ..results.record import Record
from ..specimen.loading import existing
from ..version import __version__
from .tasks import Task

logger = logging.getLogger(__name__)

FORMAT = "gonio-mi campaign"
VERSION = 2

# Of a setting that was not given.
LEFT_OUT = "left out"

TASKS = "[0-9]*_theta_i_*_phi_i_*.npz"


class CampaignFolder(contextlib.ExitStack):
    """The folder of a campaign: a description of it, and a record for each task.

    As a context it is locked; the lock dies with the process. What writers that were
    killed have left is removed in the end.

    Parameters
    ----------
    folder : path
    tasks : sequence of Task
    incidents : sequence of (float, float)
        All directions, in degrees.

    Raises
    ------
    ValueError
        If another campaign is at work in it, or if it holds finished tasks of another
        one, or something else.
    """

    def __init__(
        self,
        folder: str | PathLike[str],
        tasks: Sequence[Task],
        incidents: Sequence[tuple[float, float]],
    ) -> None:
        super().__init__()
        self.folder = Path(folder)
        self.common = {
            "variant": tasks[0].variant,
            "versions": {
                "gonio_mi": __version__,
                "mitsuba": mi.__version__,
                "drjit": dr.__version__,
            },
            "plugins": dict(tasks[0].plugins),
            "settings": {
                k: _distinct_text(v) for k, v in sorted(tasks[0].arguments.items())
            },
        }
        self.specimens = {task.name: _fingerprint(task.specimen) for task in tasks}
        self.incidents = [list(incident) for incident in incidents]

    def __enter__(self) -> CampaignFolder:
        super().__enter__()
        self.folder.mkdir(parents=True, exist_ok=True)
        try:
            self.enter_context(_locked(self.folder))
            self.callback(remove_forgotten, self.folder, 0)
            self._check()
        except BaseException:
            self.close()
            raise
        return self

    def load(self, tasks: Sequence[Task]) -> dict[int, Record]:
        """Records of the tasks that were finished before, by number.

        A damaged file is reported and left out.

        Raises
        ------
        ValueError
            If a file is not of its task.
        """
        done = {}
        for task in tasks:
            path = self._path(task)
            if path.exists():
                try:
                    record = files.load(path)
                except FileFormatError as error:
                    logger.warning("%s; it is measured again", error)
                    continue
                _check_same(path, record.provenance.task, self._described(task))
                done[task.number] = record.with_provenance(task=None)
        return done

    def save(self, task: Task, record: Record) -> None:
        """Keep the record of a task."""
        kept = record.with_provenance(task=self._described(task))
        kept.save(self._path(task))

    def _check(self) -> None:
        """Describe the campaign, or raise ValueError if the folder holds another."""
        path = self.folder / "campaign.json"
        described = {
            "format": FORMAT,
            "version": VERSION,
            **self.common,
            "specimens": self.specimens,
            "incidents": self.incidents,
        }
        # the power failed before it was on the disk
        content = path.read_bytes().strip(b"\0 \n") if path.exists() else b""
        if content:
            found = _campaign(path, content)
            if any(self.folder.glob(TASKS)):
                _check_same(path, found, described)
            elif found == described:
                return
        with files.replacing(path) as stream:
            stream.write(json.dumps(described, indent=1).encode())

    def _described(self, task: Task) -> dict[str, Any]:
        """All that determines the bits of a task, in JSON's types."""
        return {
            **self.common,
            "specimen": self.specimens[task.name],
            "incidents": [list(incident) for incident in task.incidents],
        }

    def _path(self, task: Task) -> Path:
        theta_i, phi_i = task.incidents[0]
        name = f"{task.number:06d}_theta_i_{theta_i:g}_phi_i_{phi_i:g}.npz"
        return self.folder / name


# -------------------------------------------------------------------------- locking


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Context in which no other campaign is at work in the folder."""
    with open(folder / ".lock", "a") as stream:
        try:
            _lock(stream.fileno())
        except (BlockingIOError, PermissionError):
            raise SettingError(
                f"folder must be free, but another campaign is at work in {folder}: "
                "wait until it has ended, or take another folder"
            ) from None
        except OSError as error:  # some network drives know no locks
            logger.warning("%s cannot be locked: %s", folder, error)
        yield


def _lock(descriptor: int) -> None:
    """Lock an open file until it is closed; raise OSError if it is locked."""
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


# --------------------------------------------------------------------- descriptions


def _campaign(path: Path, content: bytes) -> Any:
    """What a file campaign.json holds, or ValueError if it is of something else."""
    try:
        found = json.loads(content)
    except ValueError:
        found = None
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise SettingError(
            f"folder must hold a campaign or nothing, but {path} is something else: "
            "take another folder"
        )
    return found


def _check_same(path: Path, found: Any, own: dict[str, Any]) -> None:
    """Raise ValueError unless two descriptions agree."""
    remedy = f"take another folder, or remove {path.parent} to measure all again"
    if not isinstance(found, dict) or found.keys() != own.keys():
        raise SettingError(
            "folder must hold this very campaign, but another version of gonio-mi "
            f"wrote {path.name}: {remedy}"
        )
    for key in own:
        what, one, other = key, own[key], found[key]
        if key == "specimens" and one.keys() != other.keys():
            what, one, other = "specimen", ", ".join(one), ", ".join(other)
        while isinstance(one, dict) and isinstance(other, dict) and one != other:
            what = min(
                k for k in one.keys() | other.keys() if one.get(k) != other.get(k)
            )
            one, other = one.get(what, LEFT_OUT), other.get(what, LEFT_OUT)
        if one != other:
            one, other = abridged_apart([str(one), str(other)], MAX_VALUE)
            raise SettingError(
                f"folder must hold this very campaign, but {path.name} was measured "
                f"with {what} {other}, not {one}: {remedy}"
            )


def _distinct_text(value: Any) -> str:
    """Text that tells a setting from others, the same for 1e6 and 1000000."""
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{k}: {_distinct_text(v)}' for k, v in value.items())}}}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_distinct_text, value))}]"
    if isinstance(value, (bool, np.bool_)):
        return str(bool(value))
    if isinstance(value, Integral):
        return str(int(value))
    if isinstance(value, Real):
        number = float(value)
        return str(int(number)) if number.is_integer() else repr(number)
    # whose texts leave out digits, or pixels
    data = getattr(value, "matrix", value)
    if isinstance(data, (np.ndarray, mi.Bitmap)) or dr.is_array_v(data):
        data = np.ascontiguousarray(data)
        return f"{data.dtype} {data.shape} sha256:{_sha256(data.tobytes())}"
    return repr(value)


def _fingerprint(specimen: Any) -> str:
    """Text that tells a specimen from others: for a file, of its content too."""
    if isinstance(specimen, (str, os.PathLike)):
        content = existing(specimen).read_bytes()
        return f"{os.fspath(specimen)} sha256:{_sha256(content)}"
    return _distinct_text(specimen)


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def folder_name(name: str) -> str:
    """Name of the folder of a specimen, whose own name may be a path.

    What tells names apart that would be written alike is behind it.
    """
    digest = hashlib.blake2s(os.fsencode(name), digest_size=4).hexdigest()
    return f"{re.sub(r'[^A-Za-z0-9.,=+-]+', '_', name)[:80]}_{digest}"

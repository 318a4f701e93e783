"""Writing of files that appear whole or not at all."""

import contextlib
import errno
import io
import os
import stat
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

from ..errors import SettingError, SettingTypeError, shown

try:
    import fcntl
except ImportError:  # not a POSIX system
    fcntl = None  # type: ignore[assignment]

# A temporary file that nobody has locked and that is older than this many seconds was
# left behind by a process that was killed.
MAX_PARTIAL_AGE = 60.0
PREFIX, SUFFIX = ".gonio-", ".partial"


def check_output(path: str | os.PathLike[str], endings: Sequence[str]) -> None:
    """Raise one clear sentence unless `path` can be written: call it before measuring.

    Parameters
    ----------
    path : str or path
    endings : sequence of str
        What the name may end in.

    Raises
    ------
    ValueError
        For another ending.
    FileNotFoundError
        If the folder does not exist.
    OSError
        If the folder or an existing file cannot be written.
    """
    checked_ending(path, endings)
    target = _target(path)
    if not target.parent.is_dir():
        raise FileNotFoundError(f"there is no folder {target.parent} for {path}")
    if target.is_dir():
        raise IsADirectoryError(f"{path} is a folder, not a file")
    if os.path.exists(path) and not os.access(path, os.W_OK):
        raise PermissionError(f"the file {path} is write-protected")
    if takes_a_stream(path):
        return
    trial = _partial(target)
    try:
        trial.touch(exist_ok=False)
    except OSError as error:
        raise type(error)(
            f"the folder {target.parent} cannot be written to: {error.strerror}"
        ) from None
    trial.unlink(missing_ok=True)  # another writer may have taken it for forgotten


def checked_ending(path: str | os.PathLike[str], endings: Sequence[str]) -> str:
    """Return the ending of `path` in lower case, or raise ValueError or TypeError."""
    if not isinstance(path, (str, os.PathLike)):
        raise SettingTypeError(f"path must be text or a path, got {shown(path)}")
    ending = Path(path).suffix.lower()
    if ending not in endings:
        raise SettingError(
            f"the file name must end in {' or '.join(endings)}, got {str(path)!r} "
            f"with the ending {ending!r}"
        )
    return ending


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Context of a binary stream; on success its content replaces the file `path`.

    It is written to a temporary name in the same folder, which takes the place of the
    file, with its permissions, when all of it is on the disk; the temporary file is
    removed if anything is raised, and those of killed processes are removed too. A
    named pipe or a character device gets the content at the end.

    Raises
    ------
    OSError
        If it cannot be written: it names the file.
    """
    try:
        if takes_a_stream(path):
            content = io.BytesIO()
            yield content
            with open(path, "wb") as stream:
                stream.write(content.getbuffer())
        else:
            yield from _replaced(_target(path))
    except OSError as error:
        if error.errno is None or error.filename is not None:
            raise
        raise type(error)(error.errno, error.strerror, os.fspath(path)) from error


def _replaced(target: Path) -> Iterator[BinaryIO]:
    """Stream whose content replaces a regular file."""
    remove_forgotten(target.parent)
    partial = _partial(target)
    try:
        with open(partial, "xb") as stream:
            _is_locked(stream)
            if target.exists() and hasattr(os, "fchmod"):
                os.fchmod(stream.fileno(), stat.S_IMODE(target.stat().st_mode))
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
            if fcntl is not None:  # while nobody can take it for a forgotten one
                os.replace(partial, target)
        if fcntl is None:  # where open files keep their names
            os.replace(partial, target)
    except BaseException:  # Ctrl-C too
        partial.unlink(missing_ok=True)
        raise
    _sync_folder(target.parent)


def takes_a_stream(path: str | os.PathLike[str]) -> bool:
    """Whether `path` is a pipe or a character device; OSError for other devices."""
    try:
        mode = os.stat(path).st_mode
    except OSError:
        return False
    if stat.S_ISBLK(mode) or stat.S_ISSOCK(mode):
        raise OSError(errno.EINVAL, "neither a file nor a pipe", os.fspath(path))
    return stat.S_ISFIFO(mode) or stat.S_ISCHR(mode)


def _is_locked(stream: BinaryIO) -> bool:
    """Try to lock a temporary file; return whether another process holds the lock."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # or a file system without locks
        return True
    return False


def remove_forgotten(folder: Path, age: float = MAX_PARTIAL_AGE) -> None:
    """Remove the temporary files of processes that were killed, of this age in s."""
    for partial in folder.glob(f"{PREFIX}*{SUFFIX}"):
        with contextlib.suppress(OSError):
            found = partial.lstat()
            # to open a pipe would wait for whoever writes to it
            if not stat.S_ISREG(found.st_mode) or time.time() - found.st_mtime < age:
                continue
            with open(partial, "rb") as stream:
                if not _is_locked(stream):
                    partial.unlink()


def _sync_folder(folder: Path) -> None:
    """Let the new name survive a power failure, where folders can be synchronised."""
    with contextlib.suppress(OSError):
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


def _target(path: str | os.PathLike[str]) -> Path:
    """The file itself, also where `path` is a link to it."""
    return Path(os.path.realpath(path))


def _partial(target: Path) -> Path:
    """A fresh name in the same folder."""
    return target.with_name(f"{PREFIX}{os.urandom(8).hex()}{SUFFIX}")

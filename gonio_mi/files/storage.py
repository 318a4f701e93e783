"""Saving and loading of records, by the ending of the file's name."""

import contextlib
import os
import secrets
from pathlib import Path

from ..errors import FileFormatError
from . import exr, npz

__all__ = ["ENDINGS", "check_output", "load", "replacing", "save"]

FORMATS = {".exr": exr, ".npz": npz}
ENDINGS = tuple(FORMATS)


def save(record, path):
    """Write `record` to `path`, lossless; the file appears when it is complete.

    A failure leaves no partial file, and an older file as it was.

    Parameters
    ----------
    record : Record
    path : str or path
        Ends in ``.exr`` or ``.npz``.

    Raises
    ------
    ValueError
        For another ending.
    OSError
        If the file cannot be written.
    """
    file_format = FORMATS[_checked_ending(path, ENDINGS)]
    with replacing(path) as stream:
        file_format.write(record, stream)


def load(path):
    """Read a record from `path`; it equals the one that was saved.

    Parameters
    ----------
    path : str or path
        Ends in ``.exr`` or ``.npz``.

    Returns
    -------
    Record

    Raises
    ------
    ValueError
        For another ending.
    FileNotFoundError, OSError
        If there is no such file, or it cannot be opened.
    FileFormatError
        If the file is damaged, foreign, or of another version. Nothing in a file is
        ever executed, and no more is allocated than it can hold.
    """
    ending = _checked_ending(path, ENDINGS)
    if not os.path.exists(path):
        raise FileNotFoundError(f"there is no file {path}")
    with open(path, "rb") as stream:
        try:
            return FORMATS[ending].read(stream)
        except FileFormatError as error:
            raise FileFormatError(f"cannot load {path}: {error}") from None
        except MemoryError:
            raise
        except Exception as error:
            # whatever a damaged file makes the libraries raise, which is documented
            # nowhere and differs between their versions
            reason = str(error).strip().split("\n")[0] or type(error).__name__
            raise FileFormatError(
                f"cannot load {path}: it is damaged or not {ending} ({reason})"
            ) from error


def check_output(path, endings=ENDINGS):
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
    _checked_ending(path, endings)
    target = _target(path)
    if not target.parent.is_dir():
        raise FileNotFoundError(f"there is no folder {target.parent} for {path}")
    if target.is_dir():
        raise IsADirectoryError(f"{path} is a folder, not a file")
    if target.exists() and not os.access(target, os.W_OK):
        raise PermissionError(f"the file {path} is write-protected")
    trial = _partial(target)
    try:
        trial.touch(exist_ok=False)
    except OSError as error:
        raise type(error)(
            f"the folder {target.parent} cannot be written to: {error.strerror}"
        ) from None
    trial.unlink()


@contextlib.contextmanager
def replacing(path):
    """Context of a binary stream whose content becomes the file `path` on success.

    It is written to a temporary name in the same folder; the temporary file is renamed
    at the end, or removed if anything is raised.
    """
    target = _target(path)
    partial = _partial(target)
    try:
        with open(partial, "xb") as stream:
            yield stream
        os.replace(partial, target)
    except BaseException:  # Ctrl-C too
        partial.unlink(missing_ok=True)
        raise


def _checked_ending(path, endings):
    """Return the ending of `path` in lower case, or raise ValueError."""
    ending = Path(path).suffix.lower()
    if ending not in endings:
        raise ValueError(
            f"the file name must end in {' or '.join(endings)}, got {str(path)!r} "
            f"with the ending {ending!r}"
        )
    return ending


def _target(path):
    """What is written: the file itself, also where `path` is a link to it."""
    return Path(os.path.realpath(path))


def _partial(target):
    """A fresh name in the same folder."""
    return target.with_name(f".gonio-{secrets.token_hex(8)}.partial")

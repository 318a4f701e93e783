"""Saving and loading of records, by the ending of the file's name."""

import importlib
import os
from os import PathLike

from ..errors import FileFormatError, check_regular, no_file
from ..results.record import Record
from .checks import check_record
from .writing import checked_ending, replacing

# The names of the modules, too, which are imported when they are used.
ENDINGS = (".exr", ".npz")


def save(record: Record, path: str | PathLike[str]) -> None:
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
    file_format = importlib.import_module(checked_ending(path, ENDINGS), __package__)
    with replacing(path) as stream:
        file_format.write(record, stream)


def load(path: str | PathLike[str]) -> Record:
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
    return _loaded(path, added_up=False)


def load_added_up(path: str | PathLike[str]) -> Record:
    """Read a record as one batch, the sum of its own, which takes a fraction of memory.

    Its values are those of :func:`load` to the bit, without uncertainties.
    """
    return _loaded(path, added_up=True)


def _loaded(path: str | PathLike[str], added_up: bool) -> Record:
    """Record of a file, or the sums of its batches."""
    ending = checked_ending(path, ENDINGS)
    if not os.path.exists(path):
        raise FileNotFoundError(no_file(path))
    check_regular(path)
    with open(path, "rb") as stream:
        try:
            file_format = importlib.import_module(ending, __package__)
            record = file_format.read(stream, added_up)
            check_record(record)
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
    return record

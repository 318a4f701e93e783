"""Records as NumPy's ``.npz``: a ZIP archive of plain arrays, readable by ``np.load``.

`hits` has shape ``(n_incident, n_hemispheres, n_theta, n_phi)``; `sums`, `incident`,
`fates` and `direct` hold the batches of all incident directions, `n_batches` of each,
one after the other on their first axis. `errors`, of integrals only, is `hits` with
channels, and `elements`, of polarised variants, `sums` with an axis of the elements of
Mueller matrices before the last, row by row without the first; `changes`, of gradients,
has there a gain and a loss with each of the setting `columns`, or of integrals the
derivative and its error. The rest is the header, `settings` as JSON.

Where a campaign has copied directions by a symmetry of the specimen, their sums are
left out, and `copies` has a row for each incident direction: the number of that which
it copies (its own, if it was measured), by how many sectors it is turned, and whether
it is mirrored at azimuth 0 before.

Of a whole material that transmits, ``back.npz`` is another such file: of its back.
"""

import io
import math
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import IO, Any, BinaryIO

import numpy as np

from ..array_types import Integers, Numbers
from ..errors import check_memory
from ..results.azimuth_symmetry import Motion, sources
from ..results.record import Record
from .checks import PIECE, SEAL_LENGTH, check_seal, require, seal_of, size_of
from .header import (
    MAX_EXPANSION,
    VERSION,
    VERSION_OF_COPIES,
    VERSION_OF_MORE,
    check_format,
    header_of,
    json_of,
    parsed_json,
    parsed_subdivision,
    rebuilt,
    shapes_of_tally,
)

# Type, or one of several, and number of axes of each array.
HEADER = {
    "format": ("str", 0),
    "version": ("int64", 0),
    "subdivision": ("str", 0),
    "theta_i": ("float64", 1),
    "phi_i": ("float64", 1),
    "channels": ("str", 1),
    "stacked": ("bool", 0),
    "scales": ("int64", 1),
    "settings": ("str", 0),
}
TALLIES = {
    "n_batches": ("int64", 1),
    "hits": ("uint64", 4),
    "sums": ("float64 uint64", 5),
    "incident": ("float64 uint64", 2),
    "fates": ("uint64", 2),
    "direct": ("float64 uint64", 2),
}
INTEGRALS = {"errors": ("float64 uint64", 5)}
COLUMNS = {"elements": ("float64", 6), "changes": ("float64", 6)}
COPIES = {"copies": ("int64", 2)}
BACK = "back.npz"

# Arrays that are of all batches together.
WHOLE = ("hits", "errors")


def write(record: Record, stream: BinaryIO) -> None:
    """Write `record` to a binary stream."""
    header = header_of(record)
    header["settings"] = json_of(header["settings"])
    arrays = {name: np.array(header[name], HEADER[name][0]) for name in HEADER}
    origins = sources(record)
    own = [n for n, (source, _) in enumerate(origins) if n == source]
    tallies = [record.tallies[n] for n in own]
    if len(own) < len(record):
        if header["version"] == VERSION:
            arrays["version"] = np.array(VERSION_OF_COPIES)
        rows = [(source, motion.by, motion.mirrored) for source, motion in origins]
        arrays["copies"] = np.array(rows, np.int64)
    arrays["n_batches"] = np.array([tally.n_batches for tally in tallies])
    content = io.BytesIO()
    # like np.savez_compressed, but level 1: as small for noisy sums, six times faster
    with zipfile.ZipFile(
        content, "w", zipfile.ZIP_DEFLATED, compresslevel=1
    ) as archive:
        archive.comment = bytes(SEAL_LENGTH)
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, array, allow_pickle=False)
        for name in tallies[0].arrays:
            parts = (getattr(tally, name) for tally in tallies)
            if name in WHOLE:
                parts = (part[None] for part in parts)
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                _write_joined(file, list(parts))
        if record.back is not None:
            back = io.BytesIO()
            write(record.back, back)
            archive.writestr(zipfile.ZipInfo(BACK), back.getbuffer())  # not deflated
    unsealed = content.getbuffer()[:-SEAL_LENGTH]
    stream.write(unsealed)
    stream.write(seal_of(unsealed))


def _write_joined(file: IO[bytes], parts: Sequence[Numbers]) -> None:
    """Write concatenated arrays without `numpy.concatenate`'s copy in memory."""
    dtype, length = np.result_type(*parts), sum(len(part) for part in parts)
    header = {
        "descr": np.lib.format.dtype_to_descr(dtype),
        "fortran_order": False,
        "shape": (length, *parts[0].shape[1:]),
    }
    np.lib.format.write_array_header_1_0(file, header)
    for part in parts:
        file.write(np.ascontiguousarray(part, dtype).data)


def read(stream: BinaryIO, added_up: bool = False) -> Record:
    """Read a record from a binary file, or the sums of its batches: `added_up`.

    Nothing in it is executed.

    Raises
    ------
    FileFormatError
        If the file holds something else, does not agree with its check sum, or
        announces more than its size allows.
    """
    size = size_of(stream)
    check_seal(stream)
    with zipfile.ZipFile(stream) as archive:
        members = {info.filename: info for info in archive.infolist()}
        require("format.npy" in members, "it was not written by gonio-mi")
        announced = sum(info.file_size for info in archive.infolist())
        reason = f"it announces {announced} bytes, more than {size} bytes can hold"
        require(announced <= MAX_EXPANSION * size, reason)
        header: dict[str, Any] = {}
        for name in HEADER:
            member = _opened(archive, members, name, HEADER)
            header[name] = _numbers(*member).tolist()
        header["settings"] = parsed_json(header["settings"])
        check_format(header)
        expected = TALLIES | (INTEGRALS if "errors.npy" in members else {})
        held = (name for name in COLUMNS if f"{name}.npy" in members)
        expected |= {name: COLUMNS[name] for name in held}
        version = header["version"]
        may_copy = version == VERSION_OF_MORE and "copies.npy" in members
        expected |= COPIES if version == VERSION_OF_COPIES or may_copy else {}
        known = {f"{name}.npy" for name in HEADER | expected}
        known |= {BACK} & members.keys() if version == VERSION_OF_MORE else set()
        own = members.keys() == known and len(archive.infolist()) == len(known)
        require(own, "its arrays are not those of a record")
        batches = _opened(archive, members, "n_batches", expected)
        n_batches = _numbers(*batches).tolist()
        shapes = _shapes(header, n_batches)
        opened = {
            name: _opened(archive, members, name, expected, shapes[name])
            for name in expected
            if name != "n_batches"
        }
        copies = _numbers(*opened.pop("copies")) if "copies" in opened else None
        n_all = len(n_batches if copies is None else copies)
        # hits are those of all batches
        whole = members["hits.npy"].file_size if added_up else announced
        needed = whole + (announced - whole) / min(n_batches)
        needed *= n_all / len(n_batches)
        check_memory("its content", needed, "open it on a larger machine")
        content = _tallies(opened, n_batches)
        if copies is None:
            record = rebuilt(header, content, n_all, added_up)
        else:
            record = _with_copies(header, content, len(n_batches), copies, added_up)
        if BACK not in members:
            return record
        require(members[BACK].file_size <= size, "its back is compressed")
        back = io.BytesIO(archive.read(BACK))
        return replace(record, back=read(back, added_up))


def _tallies(
    opened: Mapping[str, tuple[IO[bytes], tuple[int, ...], np.dtype[Any]]],
    n_batches: Sequence[int],
) -> Iterator[dict[str, Numbers]]:
    """Arrays of the tally of one incident direction after the other."""
    for n in n_batches:
        yield {
            name: _numbers(file, shape[1:] if name in WHOLE else (n, *shape[1:]), dtype)
            for name, (file, shape, dtype) in opened.items()
        }


def _with_copies(
    header: dict[str, Any],
    content: Iterable[dict[str, Numbers]],
    n_own: int,
    copies: Integers,
    added_up: bool,
) -> Record:
    """Record of the directions in the file and of the copies that it leaves out."""
    n, n_sectors = len(copies), parsed_subdivision(header).shape[1]
    of_each = ("theta_i", "phi_i", "scales")
    reason = "its copies are not of its incident directions"
    require(all(len(header[name]) == n for name in of_each), reason)
    source, by, mirrored = copies.T
    own = np.flatnonzero(source == np.arange(n))
    reason = "its copies are not of directions that it holds"
    require(len(own) == n_own and bool(np.isin(source, own).all()), reason)
    moved = (by >= 0) & (by < n_sectors) & (mirrored >= 0) & (mirrored < 2)
    require(moved.all(), "its copies have an unknown motion")
    held = {name: [header[name][number] for number in own] for name in of_each}
    record = rebuilt(header | held, content, n_own, added_up)
    place = np.searchsorted(own, source).tolist()
    tallies = [record.tallies[number] for number in place]
    for number in np.flatnonzero(source != np.arange(n)).tolist():
        motion = Motion(int(by[number]), bool(mirrored[number]), n_sectors)
        tallies[number] = motion.moved_tally(tallies[number])
    return replace(
        record,
        theta_i=np.array(header["theta_i"], float),
        phi_i=np.array(header["phi_i"], float),
        tallies=tuple(tallies),
    )


def _shapes(
    header: dict[str, Any], n_batches: list[int]
) -> dict[str, tuple[int | None, ...]]:
    """Shape that each array must have, with None for hemispheres and fates."""
    require(min(n_batches, default=0) > 0, "its numbers of batches must be positive")
    patches, channels = parsed_subdivision(header).shape, len(header["channels"])
    shapes = shapes_of_tally(sum(n_batches), None, patches, channels)
    for name in WHOLE:
        shapes[name] = len(n_batches), *shapes[name]
    return shapes | {"fates": (sum(n_batches), None), "copies": (None, 3)}


def _opened(
    archive: zipfile.ZipFile,
    members: dict[str, zipfile.ZipInfo],
    name: str,
    expected: dict[str, tuple[str, int]],
    wanted: tuple[int | None, ...] | None = None,
) -> tuple[IO[bytes], tuple[int, ...], np.dtype[Any]]:
    """Member at the numbers of the array of that name, its shape and its type."""
    kind, n_axes = expected[name]
    require(f"{name}.npy" in members, f"its array {name} is missing")
    info = members[f"{name}.npy"]
    member = archive.open(info)
    version = np.lib.format.read_magic(member)
    require(version == (1, 0), f"its array {name} has npy version {version}")
    shape, by_columns, dtype = np.lib.format.read_array_header_1_0(member)
    n_bytes = info.file_size - member.tell()
    good = dtype.kind == "U" if kind == "str" else dtype in kind.split()
    require(
        good and len(shape) == n_axes and dtype.itemsize > 0 and not by_columns,
        f"its array {name} is {dtype} {shape} instead of {kind} with {n_axes} axes",
    )
    require(
        all(n >= 0 for n in shape) and math.prod(shape) * dtype.itemsize == n_bytes,
        f"its array {name} of shape {shape} does not fill its {n_bytes} bytes",
    )
    require(
        wanted is None or all(w in (None, n) for w, n in zip(wanted, shape)),
        f"its array {name} of shape {shape} does not fit its other entries",
    )
    return member, shape, dtype


def _numbers(
    member: IO[bytes], shape: tuple[int, ...], dtype: np.dtype[Any]
) -> Numbers:
    """The next numbers of a member, read in pieces."""
    array = np.empty(shape, dtype)
    content = array.reshape(-1).view(np.uint8).data
    for start in range(0, len(content), PIECE):
        piece = content[start : start + PIECE]
        piece[:] = member.read(len(piece))
    return array

"""Records as multi-part OpenEXR: maps and a picture for other programs, the exact sums.

The parts of one incident direction, in a stack with its number after a dot:

``brdf``, ``btdf``
    The patches as pixels: row 0 is the ring at the pole, column 0 the first sector.
    Layers ``brdf`` and ``std_err`` (1/sr, float32) per channel, and ``count`` of rays.
``view``
    A picture: the hemispheres side by side, both seen along -z in orthographic
    projection (radius sin(theta)), phi = 0 to the right, counter-clockwise. Colours are
    linear values in 1/sr, grey for the mean unless the channels are R, G, B.
``tally``
    The sums in units of 1/scale of a ray: one row per batch, hemisphere and ring.
``integral``
    Of integrals only: what they may be wrong by, in the same unit.

Whole numbers beyond 32 bits have their upper half in ``count_high`` and ``sum_high``.
The first header holds the rest as JSON, ``gonio.record``, and a check sum.
"""

import contextlib
import hashlib
import io
import os
import struct

import numpy as np
import OpenEXR

from . import exr_parts
from .header import (
    MAX_EXPANSION,
    check_format,
    header_of,
    json_of,
    parsed_json,
    parsed_subdivision,
    rebuilt,
    require,
    size_of,
)

__all__ = ["read", "write"]

MAGIC = b"\x76\x2f\x31\x01"
VERSION = 2
MULTI_PART, LONG_NAMES = 0x1000, 0x400


def write(record, stream):
    """Write `record` to a binary stream."""
    text = json_of(_description(record))
    arrays = [_arrays(tally) for tally in record.tallies]
    exact = {"gonio.record": text, "gonio.sha256": _digest(text, arrays)}
    parts = []
    for index in range(len(record)):
        for name, layers in exr_parts.layers(record[index]).items():
            header = exr_parts.attributes(record, index, name)
            if not parts:
                header |= exact
            full_name = _part_name(name, index, len(record))
            parts.append(OpenEXR.Part(header, layers, full_name))
    OpenEXR.File(parts).write(stream)


def read(stream):
    """Read a record from a binary file.

    Raises
    ------
    FileFormatError
        If the file holds something else, announces more than its size allows, or does
        not agree with its check sum.
    """
    _check_complete(stream)
    stream.seek(0)
    with _silenced():
        headers = [part.header for part in OpenEXR.File(stream, header_only=True).parts]
    _check_sizes(headers, size_of(stream))
    text = headers[0].get("gonio.record") if headers else None
    require(text is not None, "it was not written by gonio-mi")
    header = parsed_json(text)
    check_format(header)

    stream.seek(0)
    with _silenced():
        image = OpenEXR.File(stream, separate_channels=True)
    parts = {part.name(): part.channels for part in image.parts}
    per_batch = ["incident", "fates", *(["direct"] if header["version"] >= 3 else [])]
    per_batch = {key: _integers(header, key) for key in per_batch}
    fates = per_batch["fates"]
    require(
        all(len(arrays) == len(fates) > 0 for arrays in per_batch.values()),
        "its numbers of directions differ",
    )
    channels = header.get("channels")
    require(isinstance(channels, list), "its entry channels is not a list")
    names = exr_parts.layer_names([str(channel) for channel in channels])
    tallies = []
    for index in range(len(fates)):
        arrays = _sums(parts, index, len(fates), names, header, len(fates[index]))
        tallies.append(arrays | {k: rows[index] for k, rows in per_batch.items()})
    record = rebuilt(header, tallies)
    arrays = [_arrays(tally) for tally in record.tallies]
    require(
        headers[0].get("gonio.sha256") == _digest(text, arrays),
        "it is damaged: its content does not agree with its check sum",
    )
    return record


def _description(record):
    """Everything but the patches' sums."""
    return header_of(record) | {
        "incident": [tally.incident.tolist() for tally in record.tallies],
        "fates": [tally.fates.tolist() for tally in record.tallies],
        "direct": [tally.direct.tolist() for tally in record.tallies],
    }


def _arrays(tally):
    """What the pixels hold of a tally, exactly."""
    errors = [] if tally.errors is None else [tally.errors]
    return [tally.hits, tally.sums, *errors]


def _part_name(name, index, n):
    """``brdf``, or in a stack ``brdf.07``."""
    return name if n == 1 else f"{name}.{index:0{len(str(n - 1))}d}"


def _digest(text, arrays):
    """Check sum of the description and of the arrays of all tallies."""
    digest = hashlib.sha256(text.encode())
    for array in (array for pair in arrays for array in pair):
        digest.update(np.ascontiguousarray(array, dtype="<u8"))
    return digest.hexdigest()


# ------------------------------------------------------------------ what is read


@contextlib.contextmanager
def _silenced():
    """Context without what the library prints about damage, besides raising."""
    with contextlib.redirect_stdout(io.StringIO()), open(os.devnull, "wb") as nowhere:
        stderr = os.dup(2)
        os.dup2(nowhere.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)


def _check_complete(stream):
    """Raise FileFormatError unless all chunks that the file lists are in it."""
    size = size_of(stream)
    require(stream.read(len(MAGIC)) == MAGIC, "it is no OpenEXR file")
    require(
        _number(stream) & ~LONG_NAMES == VERSION | MULTI_PART,
        "it was not written by gonio-mi",
    )
    n_chunks = 0
    while name := _name(stream):  # the first attribute of a part, or the end
        while name:
            kind, length = _name(stream), _number(stream)
            if (name, kind, length) == (b"chunkCount", b"int", 4):
                n_chunks += _number(stream)
            else:
                stream.seek(length, io.SEEK_CUR)
            name = _name(stream)
    require(0 < 8 * n_chunks < size, "its list of chunks is damaged")
    last = max(struct.unpack(f"<{n_chunks}Q", _bytes(stream, 8 * n_chunks)))
    require(last < size, "it is truncated")
    stream.seek(last + 8)  # after the numbers of part and row
    require(last + 12 + _number(stream) <= size, "it is truncated")


def _name(stream):
    """Text up to the next zero byte."""
    text = b""
    while (byte := _bytes(stream, 1)) != b"\0":
        text += byte
        require(len(text) < 256, "a name in its headers is too long")
    return text


def _number(stream):
    """Unsigned number of 32 bits."""
    return struct.unpack("<I", _bytes(stream, 4))[0]


def _bytes(stream, n):
    """Exactly `n` bytes."""
    data = stream.read(n)
    require(len(data) == n, "it is truncated")
    return data


def _check_sizes(headers, size):
    """Raise FileFormatError if the pixels that are announced cannot be in the file."""
    announced = 0
    for header in headers:
        require(header.get("type") == OpenEXR.scanlineimage, "it holds no plain images")
        low, high = header["dataWindow"]
        width, height = (int(b) - int(a) + 1 for a, b in zip(low, high))
        announced += width * height * 4 * len(header["channels"])
    require(
        announced <= MAX_EXPANSION * size,
        f"it announces {announced} bytes, more than {size} bytes can hold",
    )


def _sums(parts, index, n, names, header, n_batches):
    """Arrays `hits`, `sums` and if there are some `errors` of one direction."""
    shape = parsed_subdivision(header).shape
    hits = []
    for part in ("brdf", "btdf"):
        layers = parts.get(_part_name(part, index, n))
        if layers is not None or part == "brdf":
            hits.append(_joined(layers, "count", "", part, shape))
    rows = n_batches * len(hits) * shape[0], shape[1]
    layers = parts.get(_part_name("tally", index, n))
    sums = [_joined(layers, "sum", f".{name}", "tally", rows) for name in names]
    arrays = {
        "hits": np.stack(hits),
        "sums": np.stack(sums, axis=-1).reshape(n_batches, len(hits), *shape, -1),
    }
    layers = parts.get(_part_name("integral", index, n))
    if layers is not None:
        rows = len(hits) * shape[0], shape[1]
        errors = [
            _joined(layers, "error", f".{name}", "integral", rows) for name in names
        ]
        arrays["errors"] = np.stack(errors, axis=-1).reshape(len(hits), *shape, -1)
    return arrays


def _joined(layers, layer, channel, part, shape):
    """uint64 numbers from their two halves."""
    require(
        layers is not None and f"{layer}{channel}" in layers,
        f"its part {part} is missing or damaged",
    )
    halves = [layers[f"{layer}{channel}"].pixels]
    if f"{layer}_high{channel}" in layers:
        halves.append(layers[f"{layer}_high{channel}"].pixels)
    for half in halves:
        require(
            half.shape == shape and half.dtype == np.uint32,
            f"its layer {layer}{channel} is {half.dtype} {half.shape} instead of "
            f"uint32 {shape}",
        )
    joined = halves[0].astype(np.uint64)
    if len(halves) == 2:
        joined |= halves[1].astype(np.uint64) << 32
    return joined


def _integers(header, key):
    """List of two-dimensional uint64 arrays from lists of whole numbers."""
    try:
        arrays = [np.array(rows, dtype=np.uint64) for rows in header.get(key)]
    except (TypeError, ValueError, OverflowError):
        arrays = None
    require(
        arrays is not None
        and all(array.ndim == 2 for array in arrays)
        and [array.tolist() for array in arrays] == header[key],
        f"its entry {key} does not hold whole numbers",
    )
    return arrays

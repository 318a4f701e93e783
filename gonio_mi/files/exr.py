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
The first header holds the rest as JSON, ``gonio.record``, and a check sum of the
content; after the last image there is one of all bytes.
"""

import hashlib
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, BinaryIO

import numpy as np
import OpenEXR

from ..array_types import Counts, Numbers
from ..results.record import Record
from ..results.tally import Tally
from . import exr_parts
from .header import (
    check_format,
    header_of,
    json_of,
    parsed_json,
    parsed_subdivision,
    rebuilt,
    require,
)
from .seal import check_seal, seal_of

__all__ = ["read", "write"]

MAGIC = b"\x76\x2f\x31\x01"


def write(record: Record, stream: BinaryIO) -> None:
    """Write `record` to a binary stream."""
    text = json_of(_description(record))
    arrays = [_arrays(tally) for tally in record.tallies]
    exact = {"gonio.record": text, "gonio.sha256": _digest(text, arrays)}
    parts: list[Any] = []
    for index in range(len(record)):
        for name, layers in exr_parts.layers(record[index]).items():
            header = exr_parts.attributes(record, index, name)
            if not parts:
                header |= exact
            full_name = _part_name(name, index, len(record))
            parts.append(OpenEXR.Part(header, layers, full_name))
    content = io.BytesIO()
    OpenEXR.File(parts).write(content)
    stream.write(content.getbuffer())
    stream.write(seal_of(content.getbuffer()))


def read(stream: BinaryIO) -> Record:
    """Read a record from a binary file.

    Raises
    ------
    FileFormatError
        If the file holds something else, or does not agree with its check sum.
    """
    magic = stream.read(len(MAGIC))
    require(magic == MAGIC, "it is no OpenEXR file")
    # damage makes the library print, drop parts, take any memory or crash
    check_seal(stream)
    image = OpenEXR.File(stream, separate_channels=True)
    first = image.parts[0].header if image.parts else {}
    text: Any = first.get("gonio.record")
    require(text is not None, "it was not written by gonio-mi")
    header = parsed_json(text)
    check_format(header)
    parts = {part.name(): part.channels for part in image.parts}
    per_batch = {"fates": _integers(header, "fates")}
    for key in ("incident", "direct"):
        per_batch[key] = _numbers(header, key)
    fates, incident = per_batch["fates"], per_batch["incident"]
    require(
        all(len(arrays) == len(fates) > 0 for arrays in per_batch.values()),
        "its numbers of directions differ",
    )
    channels = header.get("channels")
    require(isinstance(channels, list), "its entry channels is not a list")
    names = exr_parts.layer_names([str(channel) for channel in channels])
    tallies = []
    for index in range(len(fates)):
        kind = incident[index].dtype
        arrays = _sums(parts, index, len(fates), names, header, len(fates[index]), kind)
        tallies.append(arrays | {k: rows[index] for k, rows in per_batch.items()})
    record = rebuilt(header, tallies)
    content = [_arrays(tally) for tally in record.tallies]
    require(
        first.get("gonio.sha256") == _digest(text, content),
        "it is damaged: its content does not agree with its check sum",
    )
    return record


def _description(record: Record) -> dict[str, Any]:
    """Everything but the patches' sums."""
    return header_of(record) | {
        "incident": [tally.incident.tolist() for tally in record.tallies],
        "fates": [tally.fates.tolist() for tally in record.tallies],
        "direct": [tally.direct.tolist() for tally in record.tallies],
    }


def _arrays(tally: Tally) -> list[Counts]:
    """What the pixels hold of a tally, exactly."""
    of_pixels = ("hits", "sums", "errors")
    return [getattr(tally, name) for name in of_pixels if name in tally.arrays]


def _part_name(name: str, index: int, n: int) -> str:
    """``brdf``, or in a stack ``brdf.07``."""
    return name if n == 1 else f"{name}.{index:0{len(str(n - 1))}d}"


def _digest(text: str, arrays: Iterable[Iterable[Numbers]]) -> str:
    """Check sum of the description and of the arrays of all tallies."""
    digest = hashlib.sha256(text.encode())
    for array in (array for pair in arrays for array in pair):
        digest.update(np.ascontiguousarray(exr_parts.bits(array), dtype="<u8").data)
    return digest.hexdigest()


# ------------------------------------------------------------------ what is read


def _sums(
    parts: Mapping[str, Mapping[str, Any]],
    index: int,
    n: int,
    names: Sequence[str],
    header: dict[str, Any],
    n_batches: int,
    kind: np.dtype[Any],
) -> dict[str, Numbers]:
    """Arrays `hits`, `sums` and if there are some `errors` of one direction.

    The latter two are of the type `kind`.
    """
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
    arrays["sums"] = arrays["sums"].view(kind)
    layers = parts.get(_part_name("integral", index, n))
    if layers is not None:
        rows = len(hits) * shape[0], shape[1]
        errors = [
            _joined(layers, "error", f".{name}", "integral", rows) for name in names
        ]
        stacked = np.stack(errors, axis=-1).reshape(len(hits), *shape, -1)
        arrays["errors"] = stacked.view(kind)
    return arrays


def _joined(
    layers: Any,
    layer: str,
    channel: str,
    part: str,
    shape: tuple[int, int],
) -> Counts:
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


def _numbers(header: dict[str, Any], key: str) -> list[Numbers]:
    """As :func:`_integers`, but float64 where a list holds floats."""
    entry: Any = header.get(key)
    try:
        arrays = [np.array(rows) for rows in entry]
    except (TypeError, ValueError, OverflowError):
        arrays = []
    if not any(array.dtype == np.float64 for array in arrays):
        return _integers(header, key)
    require(
        all(array.ndim == 2 and array.dtype == np.float64 for array in arrays),
        f"its entry {key} does not hold numbers",
    )
    return arrays


def _integers(header: dict[str, Any], key: str) -> list[Numbers]:
    """List of two-dimensional uint64 arrays from lists of whole numbers."""
    entry: Any = header.get(key)
    try:
        arrays: Any = [np.array(rows, dtype=np.uint64) for rows in entry]
    except (TypeError, ValueError, OverflowError):
        arrays = None
    require(
        arrays is not None
        and all(array.ndim == 2 for array in arrays)
        and [array.tolist() for array in arrays] == header[key],
        f"its entry {key} does not hold whole numbers",
    )
    return arrays

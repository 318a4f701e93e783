"""Records as multi-part OpenEXR: maps and a picture for other programs, the exact sums.

The parts of one incident direction, in a stack with its number after a dot:

``brdf``, ``btdf``
    The patches as pixels: row 0 is the ring at the pole, column 0 the first sector.
    Layers ``brdf`` and ``std_err`` (1/sr, float32) per channel, and ``count`` of rays.
``brdf_mueller``, ``btdf_mueller``
    Of polarised variants only: layers ``M01`` to ``M33`` (1/sr, float32) per channel,
    the elements of Mueller matrices but the first, and ``std_err_M01`` and so on.
``view``
    A picture: the hemispheres side by side, both seen along -z in orthographic
    projection (radius sin(theta)), phi = 0 to the right, counter-clockwise. Colours are
    linear values in 1/sr, grey for the mean unless the channels are R, G, B.
``tally``
    The sums in units of 1/scale of a ray: one row per batch, hemisphere and ring.
``integral``
    Of integrals only: what they may be wrong by, in the same unit.
``elements``
    Of polarised variants only: sums of the elements but the first, in the same unit.
``changes``
    Of gradients only: a gain and a loss with each of the setting ``columns``, in the
    same unit; of integrals the derivative of the flux fraction, and its error.

Parts that begin with ``back_`` are those of the back of a material.

Whole numbers beyond 32 bits have their upper half in ``count_high`` and ``sum_high``.
The first header holds the rest as JSON, ``gonio.record``, and a check sum of the
content; after the last image there is one of all bytes.
"""

import hashlib
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, BinaryIO

import numpy as np
import OpenEXR

from ..array_types import Counts, Floats, Numbers
from ..results.record import Record
from ..results.tally import ELEMENT_NAMES, Integrals, PolarisedTally
from .checks import check_seal, require, seal_of
from .exr_part_reader import image_of, parts_of
from .header import (
    FRAMES,
    check_format,
    header_of,
    json_of,
    parsed_json,
    parsed_subdivision,
    rebuilt,
)

MAGIC = b"\x76\x2f\x31\x01"

# Parts of a direction that are read: what is exact.
SUMMED = ("brdf", "btdf", "tally", "integral", "elements", "changes")

# Beginning of the names of parts of the back.
BACK = "back_"

# Width and height of the picture of a hemisphere, in pixels.
VIEW_SIZE = 512

CONVENTIONS = (
    "Values are patch means in 1/sr, without cosine. Angles are in degrees: theta_i "
    "from the normal of the lit face, phi from +x counter-clockwise seen from +z; the "
    "mirror direction has phi = phi_i + 180. Rows are rings of theta from the pole to "
    "the horizon, columns are sectors of phi from 0 to 360."
)
_HALVES = (
    "the bits of numbers in double precision; the high layers hold the upper 32 bits"
)
MEANINGS = {
    "view": "picture of the BRDF, and of the BTDF to its right: seen along -z, radius "
    "is sin(theta), phi = 0 to the right, counter-clockwise, linear values in 1/sr",
    "tally": "received flux in units of 1/scale of a ray, one row per batch, "
    "hemisphere and ring, one column per sector: whole numbers if scale is 1, else "
    + _HALVES,
    "elements": "elements of Mueller matrices but the first, as the tally: " + _HALVES,
    "changes": "gains and losses with each of the columns, as the tally, or of "
    "integrals derivatives of flux fractions and their errors: " + _HALVES,
    "integral": "what the integrals may be wrong by in units of 1/scale of a ray, one "
    "row per hemisphere and ring: " + _HALVES,
}
for _part in ("brdf", "btdf"):
    _of = _part.upper()
    MEANINGS |= {
        _part: f"{_of} of each patch, its standard error (NaN where unknown), counted "
        "rays",
        f"{_part} of integrals": f"{_of} of each patch by integration, its largest "
        "error as estimated, rays of delta components",
        f"{_part}_mueller": f"elements of the Mueller matrix of the {_of} but the "
        f"first, which is the {_of}, and their standard errors (NaN where unknown); "
        + FRAMES,
    }


def write(record: Record, stream: BinaryIO) -> None:
    """Write `record` to a binary stream."""
    parts = _parts(record)
    if record.back is not None:
        parts += _parts(record.back, BACK, parts[0].header["displayWindow"])
    image = io.BytesIO()
    OpenEXR.File(parts).write(image)
    stream.write(image.getbuffer())
    stream.write(seal_of(image.getbuffer()))


def _parts(record: Record, prefix: str = "", window: Any = None) -> list[Any]:
    """Parts of a record; of the back with a prefix, and the front's display window."""
    # everything but the patches' sums
    content = header_of(record)
    for name in ("incident", "fates", "direct"):
        content[name] = [getattr(tally, name).tolist() for tally in record.tallies]
    text = json_of(content)
    digest = hashlib.sha256(text.encode())
    for tally in record.tallies:
        _include(digest, {name: getattr(tally, name) for name in tally.arrays})
    exact = {"gonio.record": text, "gonio.sha256": digest.hexdigest()}
    parts: list[Any] = []
    for index in range(len(record)):
        for name, layers in pixels(record[index]).items():
            header = attributes(record, index, name)
            header |= {} if parts else exact
            header |= {"displayWindow": window} if window else {}
            full_name = prefix + _part_name(name, index, len(record))
            parts.append(OpenEXR.Part(header, layers, full_name))
    return parts


def read(stream: BinaryIO, added_up: bool = False) -> Record:
    """Read a record from a binary file, or the sums of its batches: `added_up`.

    Raises
    ------
    FileFormatError
        If the file holds something else, or does not agree with its check sum.
    """
    magic = stream.read(len(MAGIC))
    require(magic == MAGIC, "it is not an OpenEXR file")
    # damage makes the library print, drop parts, take any memory or crash
    check_seal(stream)
    stream.seek(0)
    every = parts_of(stream)
    behind = [part for part in every if part.name.startswith(BACK)]
    record = _record(stream, [part for part in every if part not in behind], added_up)
    if not behind:
        return record
    return replace(record, back=_record(stream, behind, added_up, BACK))


def _record(
    stream: BinaryIO, every: Sequence[Any], added_up: bool, prefix: str = ""
) -> Record:
    """Record of parts, whose names begin with a prefix."""
    first = image_of(stream, every[:1]).parts[0].header if every else {}
    text: Any = first.get("gonio.record")
    require(text is not None, "it was not written by gonio-mi")
    header = parsed_json(text)
    check_format(header)
    per_batch = {key: _tables(header, key) for key in ("fates", "incident", "direct")}
    fates, incident = per_batch["fates"], per_batch["incident"]
    reason = "its numbers of directions differ"
    require(all(len(arrays) == len(fates) > 0 for arrays in per_batch.values()), reason)
    channels = header.get("channels")
    require(isinstance(channels, list), "its entry channels is not a list")
    names = layer_names(list(map(str, channels)))
    by_name = {part.name.removeprefix(prefix): part for part in every}
    digest = hashlib.sha256(text.encode())
    shape = parsed_subdivision(header).shape

    def arrays_of(index: int) -> dict[str, Numbers]:
        """Sums of one direction, which are included in the check sum."""
        kind = incident[index].dtype
        own = [_part_name(name, index, len(fates)) for name in SUMMED]
        image = image_of(stream, [by_name[name] for name in own if name in by_name])
        # without the number in a stack
        names_of = (part.name().removeprefix(prefix) for part in image.parts)
        of_parts = (part.channels for part in image.parts)
        parts = {name.partition(".")[0]: own for name, own in zip(names_of, of_parts)}
        arrays = _sums(parts, names, shape, len(fates[index]), kind)
        _include(digest, arrays)
        return arrays | {key: rows[index] for key, rows in per_batch.items()}

    n = len(fates)
    record = rebuilt(header, map(arrays_of, range(n)), n, added_up)
    reason = "it is damaged: its content does not agree with its check sum"
    require(first.get("gonio.sha256") == digest.hexdigest(), reason)
    return record


def _part_name(name: str, index: int, n: int) -> str:
    """``brdf``, or in a stack ``brdf.07``."""
    return name if n == 1 else f"{name}.{index:0{len(str(n - 1))}d}"


def _include(digest: Any, arrays: Mapping[str, Numbers]) -> None:
    """Add a tally's exact pixel values to a check sum."""
    for name in ("hits", "sums", "errors", "elements", "changes"):
        if name in arrays:
            digest.update(np.ascontiguousarray(bits(arrays[name]), dtype="<u8").data)


# -------------------------------------------------------------------------- parts


def pixels(single: Record) -> dict[str, dict[str, Numbers]]:
    """Pixels of the parts of one incident direction.

    Parameters
    ----------
    single : Record
        Of one incident direction.

    Returns
    -------
    dict of dict of ndarray
        float32 or uint32 pixels by the names of part and layer.
    """
    names = layer_names(single.channels)
    tally = single.tallies[0]
    hemispheres = [("brdf", single.brdf, single.brdf_std_err)]
    if single.btdf is not None and single.btdf_std_err is not None:
        hemispheres.append(("btdf", single.btdf, single.btdf_std_err))
    parts = {}
    for (part, values, std_errs), hits in zip(hemispheres, tally.hits):
        parts[part] = _halves("count", "", hits)
        for number, name in enumerate(names):
            parts[part][f"{part}.{name}"] = _float32(values[..., number])
            parts[part][f"std_err.{name}"] = _float32(std_errs[..., number])
    parts["view"] = _view(single, [values for _, values, _ in hemispheres])
    exact = {("tally", "sum"): tally.sums}
    if isinstance(tally, Integrals):
        exact["integral", "error"] = tally.errors
    if isinstance(tally, PolarisedTally):
        for number, element in enumerate(ELEMENT_NAMES):
            exact["elements", element] = tally.elements[..., number, :]
        parts |= _matrices(single, names)
    if hasattr(tally, "changes"):
        for number, column in enumerate(np.moveaxis(tally.changes, -2, 0)):
            exact["changes", f"{number:02d}"] = column
    for (part, layer), array in exact.items():
        rows = bits(array).reshape(-1, single.subdivision.shape[1], len(names))
        layers = parts.setdefault(part, {})
        for number, name in enumerate(names):
            layers |= _halves(layer, f".{name}", rows[..., number])
    return parts


def _matrices(single: Record, names: Sequence[str]) -> dict[str, dict[str, Numbers]]:
    """Layers of all elements but the first, and of their standard errors."""
    parts: dict[str, dict[str, Numbers]] = {}
    for part in ("brdf_mueller", "btdf_mueller")[: single.n_hemispheres]:
        layers = parts[part] = {}
        for ending, prefix in (("", ""), ("_std_err", "std_err_")):
            matrices = getattr(single, part + ending)
            for number, element in enumerate(ELEMENT_NAMES, 1):
                for channel, name in enumerate(names):
                    values = matrices[..., channel, number // 4, number % 4]
                    layers[f"{prefix}{element}.{name}"] = _float32(values)
    return parts


def attributes(record: Record, index: int, part: str) -> dict[str, Any]:
    """Header of one part, for people: what it is and how it was made."""
    tally = record.tallies[index]
    integrals = isinstance(tally, Integrals)
    kind = f"{part} of integrals" if integrals else part
    n_rows, n_columns = record.subdivision.shape
    rows = {
        "meaning": MEANINGS.get(kind, MEANINGS[part]),
        "conventions": CONVENTIONS,
        "units": "1/sr",
        "collector": str(record.subdivision),
        "channels": ", ".join(record.channels),
        "theta_i_deg": float(record.theta_i[index]),
        "phi_i_deg": float(record.phi_i[index]),
        "batches": str(tally.n_batches),
        "scale": str(tally.scale),
    }
    rows |= {key: _text(value) for key, value in record.settings.items()}
    if integrals and not tally.ledger.emitted:
        rows["ledger"] = "empty: quadrature traces no rays"
    else:
        ledger = vars(tally.ledger) | {"emitted": tally.ledger.emitted}
        rows |= {f"ledger.{fate}": str(n) for fate, n in ledger.items()}
    return {f"gonio.{key}": value for key, value in rows.items()} | {
        "compression": OpenEXR.ZIP_COMPRESSION,
        # OpenEXR wants one display window for all parts: that of the patches
        "displayWindow": ((0, 0), (n_columns - 1, n_rows - 1)),
    }


def layer_names(channels: Sequence[str]) -> list[str]:
    """Channel names that EXR readers sort as the channels are, wavelengths padded.

    ``380nm`` and ``1064.5nm`` become ``0380,0nm`` and ``1064,5nm``: a dot would end a
    layer's name (the comma as in Fichet et al. 2021, *An OpenEXR layout for spectral
    images*).
    """
    found = (re.fullmatch(r"([0-9]+)(?:\.([0-9]+))?nm", name) for name in channels)
    names = [channel.replace(".", ",") for channel in channels]
    parsed = [(match[1], match[2] or "") for match in found if match]
    if len(parsed) == len(channels):
        whole, part = (max(map(len, texts)) for texts in zip(*parsed))
        comma = "," if part else ""
        names = [f"{n.zfill(whole)}{comma}{d.ljust(part, '0')}nm" for n, d in parsed]
    if len(set(names)) < len(names):
        width = len(str(len(names) - 1))
        names = [f"{number:0{width}d}_{name}" for number, name in enumerate(names)]
    return names


def _view(single: Record, hemispheres: Sequence[Floats]) -> dict[str, Numbers]:
    """Layers R, G, B, A of the picture."""
    axis = (np.arange(VIEW_SIZE) + 0.5) * (2 / VIEW_SIZE) - 1
    x, y = np.meshgrid(axis, -axis)
    inside = x**2 + y**2 < 1
    x, y = x[inside], y[inside]
    patch = single.subdivision.patch(np.stack([x, y, np.sqrt(1 - x**2 - y**2)], -1))
    disks = np.zeros((len(hemispheres), VIEW_SIZE, VIEW_SIZE, 4), np.float32)
    for disk, values in zip(disks, hemispheres):
        if single.channels != ("R", "G", "B"):
            values = values.mean(axis=-1, keepdims=True)
        values = np.nan_to_num(values).reshape(single.subdivision.n_patches, -1)
        disk[inside, :3] = values[patch]
        disk[inside, 3] = 1
    picture = np.concatenate(disks, axis=1)
    return {name: _float32(picture[..., number]) for number, name in enumerate("RGBA")}


def bits(array: Numbers) -> Counts:
    """Whole numbers as they are, and floats as the 64 bits that they consist of."""
    if array.dtype == np.uint64:
        return array
    return np.ascontiguousarray(array, dtype=float).view(np.uint64)


def _halves(layer: str, channel: str, integers: Counts) -> dict[str, Numbers]:
    """Layer of the low 32 bits and, if any is set, one of the high 32 bits."""
    halves = {f"{layer}{channel}": integers.astype(np.uint32)}
    if integers.max() > 0xFFFFFFFF:
        halves[f"{layer}_high{channel}"] = (integers >> 32).astype(np.uint32)
    return halves


def _text(value: Any) -> str:
    """Readable UTF-8, also of file names that are not."""
    text = value if isinstance(value, str) else json_of(value)
    return text.encode("utf-8", "backslashreplace").decode()


def _float32(values: Numbers) -> Numbers:
    return np.ascontiguousarray(values, dtype=np.float32)


# ------------------------------------------------------------------------ reading


def _sums(
    parts: Mapping[str, Mapping[str, Any]],
    names: Sequence[str],
    shape: tuple[int, int],
    n_batches: int,
    kind: np.dtype[Any],
) -> dict[str, Numbers]:
    """Arrays `hits`, `sums` and if there are some `errors` of one direction.

    The latter two are of the type `kind`.
    """

    def channels(part: str, layer: str, n_rows: int) -> Numbers:
        """Layers of all channels of a part, channels last."""
        layers, size = parts.get(part), (n_rows, shape[1])
        found = [_joined(layers, f"{layer}.{name}", part, size) for name in names]
        return np.stack(found, axis=-1).view(kind)

    shown = ("brdf", "btdf") if "btdf" in parts else ("brdf",)
    hits = [_joined(parts.get(part), "count", part, shape) for part in shown]
    sums = channels("tally", "sum", n_batches * len(hits) * shape[0])
    sums = sums.reshape(n_batches, len(hits), *shape, -1)
    arrays = {"hits": np.stack(hits), "sums": sums}
    if "integral" in parts:
        errors = channels("integral", "error", len(hits) * shape[0])
        arrays["errors"] = errors.reshape(len(hits), *shape, -1)
    numbered = [f"{i:02d}" for i in range(len(parts.get("changes", ())))]
    own = [one for one in numbered if f"{one}.{names[0]}" in parts["changes"]]
    for part, columns in (("elements", ELEMENT_NAMES), ("changes", own)):
        if part in parts:
            require(bool(columns), f"its part {part} is damaged")
            rows = n_batches * len(hits) * shape[0]
            each = [channels(part, column, rows) for column in columns]
            several = np.stack(each, axis=-2).view(float)
            of_each = n_batches, len(hits), *shape, len(columns), len(names)
            arrays[part] = several.reshape(of_each)
    return arrays


def _joined(layers: Any, layer: str, part: str, shape: tuple[int, int]) -> Counts:
    """uint64 numbers from their two halves; `layer` with its channel."""
    require(
        layers is not None and layer in layers, f"its part {part} is missing or damaged"
    )
    stem, dot, channel = layer.partition(".")
    high = f"{stem}_high{dot}{channel}"
    halves = [layers[name].pixels for name in (layer, high) if name in layers]
    for half in halves:
        require(
            half.shape == shape and half.dtype == np.uint32,
            f"its layer {layer} is {half.dtype} {half.shape} instead of uint32 {shape}",
        )
    joined = halves[0].astype(np.uint64)
    if len(halves) == 2:
        joined |= halves[1].astype(np.uint64) << 32
    return joined


def _tables(header: dict[str, Any], key: str) -> list[Numbers]:
    """Two-dimensional arrays of lists: float64 if one holds floats, else uint64."""
    entry: Any = header.get(key)
    try:
        kinds = {np.array(rows).dtype for rows in entry}
        kind = np.float64 if np.dtype(np.float64) in kinds else np.uint64
        arrays = [np.array(rows, dtype=kind) for rows in entry]
    except (TypeError, ValueError, OverflowError):
        arrays = []
    held = [array.tolist() for array in arrays if array.ndim == 2]
    require(held == entry, f"its entry {key} does not hold numbers")
    return arrays

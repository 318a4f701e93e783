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

Whole numbers beyond 32 bits have their upper half in ``count_high`` and ``sum_high``.
The first header holds the rest as JSON, ``gonio.record``, and a check sum.
"""

import contextlib
import hashlib
import io
import re

import numpy as np
import OpenEXR

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

__all__ = ["layer_names", "read", "write"]

MAGIC = b"\x76\x2f\x31\x01"
VIEW_SIZE = 512

CONVENTIONS = (
    "Values are patch means in 1/sr, without cosine. Angles are in degrees: theta_i "
    "from the normal of the lit face, phi from +x counter-clockwise seen from +z; the "
    "mirror direction has phi = phi_i + 180. Rows are rings of theta from the pole to "
    "the horizon, columns are sectors of phi from 0 to 360."
)
MEANINGS = {
    "brdf": "BRDF of each patch, its standard error (NaN where unknown), counted rays",
    "btdf": "BTDF of each patch, its standard error (NaN where unknown), counted rays",
    "view": "picture of the BRDF, and of the BTDF to its right: seen along -z, radius "
    "is sin(theta), phi = 0 to the right, counter-clockwise, linear values in 1/sr",
    "tally": "received flux in units of 1/scale of a ray, one row per batch, "
    "hemisphere and ring, one column per sector; the high layers count 2^32",
}


def write(record, stream):
    """Write `record` to a binary stream."""
    text = json_of(_description(record))
    arrays = [(tally.hits, tally.sums) for tally in record.tallies]
    exact = {"gonio.record": text, "gonio.sha256": _digest(text, arrays)}
    parts = []
    for index in range(len(record)):
        for name, layers in _layers(record[index]).items():
            header = _attributes(record, index, name) | (exact if not parts else {})
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
    require(stream.read(len(MAGIC)) == MAGIC, "it is no OpenEXR file")
    stream.seek(0)
    headers = [part.header for part in OpenEXR.File(stream, header_only=True).parts]
    _check_sizes(headers, size_of(stream))
    text = headers[0].get("gonio.record") if headers else None
    require(text is not None, "it was not written by gonio-mi")
    header = parsed_json(text)
    check_format(header)

    stream.seek(0)
    with contextlib.redirect_stdout(io.StringIO()):  # warnings of unreadable parts
        image = OpenEXR.File(stream, separate_channels=True)
    parts = {part.name(): part.channels for part in image.parts}
    incident, fates = (_integers(header, key) for key in ("incident", "fates"))
    require(len(incident) == len(fates) > 0, "its numbers of directions differ")
    channels = header.get("channels")
    require(isinstance(channels, list), "its entry channels is not a list")
    names = layer_names([str(channel) for channel in channels])
    tallies = []
    for index in range(len(fates)):
        arrays = _sums(parts, index, len(fates), names, header, len(fates[index]))
        tallies.append(arrays | {"incident": incident[index], "fates": fates[index]})
    record = rebuilt(header, tallies)
    arrays = [(tally.hits, tally.sums) for tally in record.tallies]
    require(
        headers[0].get("gonio.sha256") == _digest(text, arrays),
        "it is damaged: its content does not agree with its check sum",
    )
    return record


def layer_names(channels):
    """Channel names that EXR readers sort as the channels are, wavelengths padded.

    ``380nm`` and ``1064.5nm`` become ``0380,0nm`` and ``1064,5nm``: a dot would end a
    layer's name (the comma as in Fichet et al. 2021, *An OpenEXR layout for spectral
    images*).
    """
    parsed = [
        re.fullmatch(r"([0-9]+)(?:\.([0-9]+))?nm", channel) for channel in channels
    ]
    if all(parsed):
        whole = max(len(match[1]) for match in parsed)
        decimals = max(len(match[2] or "") for match in parsed)
        comma = "," if decimals else ""
        names = [
            match[1].zfill(whole) + comma + (match[2] or "").ljust(decimals, "0") + "nm"
            for match in parsed
        ]
    else:
        names = [channel.replace(".", ",") for channel in channels]
    if len(set(names)) < len(names):
        width = len(str(len(names) - 1))
        names = [f"{number:0{width}d}_{name}" for number, name in enumerate(names)]
    return names


# ------------------------------------------------------------------ what is written


def _description(record):
    """Everything but the patches' sums."""
    return header_of(record) | {
        "incident": [tally.incident.tolist() for tally in record.tallies],
        "fates": [tally.fates.tolist() for tally in record.tallies],
    }


def _layers(single):
    """Pixels by layer, by part, of the record of one incident direction."""
    names = layer_names(single.channels)
    tally = single.tallies[0]
    hemispheres = [("brdf", single.brdf, single.brdf_std_err)]
    if single.has_lower:
        hemispheres.append(("btdf", single.btdf, single.btdf_std_err))
    parts = {}
    for (part, values, std_errs), hits in zip(hemispheres, tally.hits):
        layers = _halves("count", "", hits)
        for number, name in enumerate(names):
            layers[f"{part}.{name}"] = _float32(values[..., number])
            layers[f"std_err.{name}"] = _float32(std_errs[..., number])
        parts[part] = layers
    parts["view"] = _view(single, [values for _, values, _ in hemispheres])
    parts["tally"] = {}
    rows = tally.sums.reshape(-1, single.subdivision.n_phi, len(names))
    for number, name in enumerate(names):
        parts["tally"] |= _halves("sum", f".{name}", rows[..., number])
    return parts


def _view(single, hemispheres):
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


def _halves(layer, channel, integers):
    """Layer of the low 32 bits and, if any is set, one of the high 32 bits."""
    halves = {f"{layer}{channel}": integers.astype(np.uint32)}
    if integers.max() > 0xFFFFFFFF:
        halves[f"{layer}_high{channel}"] = (integers >> 32).astype(np.uint32)
    return halves


def _attributes(record, index, part):
    """Header of one part, for people: what it is and how it was made."""
    tally = record.tallies[index]
    n_views = tally.hits.shape[0]
    rows = {
        "meaning": MEANINGS[part],
        "conventions": CONVENTIONS,
        "units": "1/sr",
        "collector": str(record.subdivision),
        "channels": ", ".join(record.channels),
        "theta_i_deg": float(record.theta_i[index]),
        "phi_i_deg": float(record.phi_i[index]),
        "batches": str(tally.n_batches),
        "scale": str(tally.scale),
    }
    rows |= {
        key: value if isinstance(value, str) else json_of(value)
        for key, value in record.settings.items()
    }
    rows |= {f"ledger.{fate}": str(n) for fate, n in tally.ledger.rows.items()}
    rows["ledger.emitted"] = str(tally.ledger.emitted)
    return {f"gonio.{key}": value for key, value in rows.items()} | {
        "compression": OpenEXR.ZIP_COMPRESSION,
        # OpenEXR wants one display window for all parts: that of the picture
        "displayWindow": ((0, 0), (n_views * VIEW_SIZE - 1, VIEW_SIZE - 1)),
    }


def _part_name(name, index, n):
    """``brdf``, or in a stack ``brdf.07``."""
    return name if n == 1 else f"{name}.{index:0{len(str(n - 1))}d}"


def _float32(values):
    return np.ascontiguousarray(values, dtype=np.float32)


def _digest(text, arrays):
    """Check sum of the description and of the arrays of all tallies."""
    digest = hashlib.sha256(text.encode())
    for array in (array for pair in arrays for array in pair):
        digest.update(np.ascontiguousarray(array, dtype="<u8"))
    return digest.hexdigest()


# ------------------------------------------------------------------ what is read


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
    """Arrays `hits` and `sums` of one incident direction."""
    shape = parsed_subdivision(header).shape
    hits = []
    for part in ("brdf", "btdf"):
        layers = parts.get(_part_name(part, index, n))
        if layers is not None or part == "brdf":
            hits.append(_joined(layers, "count", "", part, shape))
    rows = n_batches * len(hits) * shape[0], shape[1]
    layers = parts.get(_part_name("tally", index, n))
    sums = [_joined(layers, "sum", f".{name}", "tally", rows) for name in names]
    return {
        "hits": np.stack(hits),
        "sums": np.stack(sums, axis=-1).reshape(n_batches, len(hits), *shape, -1),
    }


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

"""What the parts of an EXR file show: maps, a picture, sums, and headers for people."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import OpenEXR

from ..array_types import Counts, Floats, Numbers
from ..results.record import Record
from ..results.tally import Integrals
from .header import json_of

__all__ = ["attributes", "bits", "layer_names", "layers"]

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
    "brdf of integrals": "BRDF of each patch by integration, its largest error as "
    "estimated, rays of delta components",
    "btdf of integrals": "BTDF of each patch by integration, its largest error as "
    "estimated, rays of delta components",
    "view": "picture of the BRDF, and of the BTDF to its right: seen along -z, radius "
    "is sin(theta), phi = 0 to the right, counter-clockwise, linear values in 1/sr",
    "tally": "received flux in units of 1/scale of a ray, one row per batch, "
    "hemisphere and ring, one column per sector: whole numbers if scale is 1, else the "
    "bits of numbers in double precision; the high layers hold the upper 32 bits",
    "integral": "what the integrals may be wrong by in units of 1/scale of a ray, one "
    "row per hemisphere and ring: the bits of numbers in double precision; the high "
    "layers hold the upper 32 bits",
}


def layers(single: Record) -> dict[str, dict[str, Numbers]]:
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
    parts["tally"] = {}
    rows = bits(tally.sums).reshape(-1, single.subdivision.shape[1], len(names))
    for number, name in enumerate(names):
        parts["tally"] |= _halves("sum", f".{name}", rows[..., number])
    if isinstance(tally, Integrals):
        rows = bits(tally.errors).reshape(-1, single.subdivision.shape[1], len(names))
        parts["integral"] = {}
        for number, name in enumerate(names):
            parts["integral"] |= _halves("error", f".{name}", rows[..., number])
    return parts


def attributes(record: Record, index: int, part: str) -> dict[str, Any]:
    """Header of one part, for people: what it is and how it was made."""
    tally = record.tallies[index]
    integrals = isinstance(tally, Integrals)
    kind = f"{part} of integrals" if integrals else part
    n_views = max(len(tally.hits) for tally in record.tallies)
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
        rows["ledger"] = "empty: integrals send no rays"
    else:
        ledger = tally.ledger.rows | {"emitted": tally.ledger.emitted}
        rows |= {f"ledger.{fate}": str(n) for fate, n in ledger.items()}
    return {f"gonio.{key}": value for key, value in rows.items()} | {
        "compression": OpenEXR.ZIP_COMPRESSION,
        # OpenEXR wants one display window for all parts: that of the picture
        "displayWindow": ((0, 0), (n_views * VIEW_SIZE - 1, VIEW_SIZE - 1)),
    }


def layer_names(channels: Sequence[str]) -> list[str]:
    """Channel names that EXR readers sort as the channels are, wavelengths padded.

    ``380nm`` and ``1064.5nm`` become ``0380,0nm`` and ``1064,5nm``: a dot would end a
    layer's name (the comma as in Fichet et al. 2021, *An OpenEXR layout for spectral
    images*).
    """
    found = (re.fullmatch(r"([0-9]+)(?:\.([0-9]+))?nm", name) for name in channels)
    parsed = [match for match in found if match]
    if len(parsed) == len(channels):
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

"""Records as the data of a page: numbers in JSON, arrays packed into text."""

import base64
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..array_types import Floats
from ..collector import Subdivision
from ..collector.directions import direction
from ..errors import LABEL, abridged
from ..results.record import Record
from ..results.summary import summarize
from ..results.summary_text import summary_text

__all__ = ["MOST_VALUES", "RASTER", "packed_record", "raster"]

# Patch values of one record, over all directions, hemispheres and channels, that a
# browser still shows with ease: 1000 directions of two hemispheres of 30x90 patches.
MOST_VALUES = 1000 * 2 * 30 * 90

# Directions in polar angle and in azimuth at which the page knows the patch.
RASTER = 720, 720

# Bits of the mantissa of an uncertainty that are kept: 1e-4 of it.
UNCERTAIN_BITS = 12


def packed_record(
    record: Record, report: Callable[[float], Any] | None = None
) -> dict[str, Any]:
    """Return what the page shows of a record, in JSON's types.

    Arrays are little-endian, deflated and in base 64. ``raster`` is the patch of
    each direction, ``(polar angle, azimuth)`` at the middles of equal steps;
    ``values`` has one block per incident direction with, one after the other, the
    patch means in 1/sr, standard errors, distances from the mean to the lower and
    upper end of the 95 % interval, each float32 of the shape ``(hemispheres, patches,
    channels)``, and the rays per patch, uint32 of ``(hemispheres, patches)``. Of more
    than `MOST_VALUES` values evenly chosen directions are kept, and ``left_out`` says
    so. `report` is told of each direction that is packed.
    """
    patches = record.subdivision
    n_all = len(record)
    kept = _kept(record)
    numbers = summarize(record)
    blocks = []
    for number in kept:
        blocks.append(_block(record[number]))
        if report is not None:
            report(1)
    name = str(record.settings.get("specimen", "specimen"))
    middles = [np.degrees(np.ravel(angle)) for angle in patches.middles]
    return {
        "name": name,
        "label": abridged(name, LABEL),
        "collector": str(patches),
        "channels": list(record.channels),
        "hemispheres": 2 if record.has_lower else 1,
        "patches": patches.n_patches,
        "detectors": patches.n_detectors,
        "solid": _packed(patches.solid_angles.astype("<f4")),
        "theta": _packed(middles[0].astype("<f4")),
        "phi": _packed(middles[1].astype("<f4")),
        "raster": _packed(raster(patches)),
        "raster_shape": RASTER,
        "integrals": numbers["integrals"],
        "directions": [numbers["directions"][i] for i in kept],
        "values": blocks,
        "left_out": "" if len(kept) == n_all else _left_out(len(kept), n_all),
        "warnings": numbers["warnings"],
        "text": summary_text(numbers),
    }


def _kept(record: Record) -> list[int]:
    """Numbers of the incident directions that the page has."""
    n_all = len(record)
    hemispheres = 2 if record.has_lower else 1
    each = hemispheres * record.subdivision.n_patches * len(record.channels)
    n = min(n_all, max(1, MOST_VALUES // each))
    return np.unique(np.linspace(0, n_all - 1, n).round().astype(int)).tolist()


def _left_out(n: int, n_all: int) -> str:
    return f"This page has {n} of the record's {n_all} incident directions, evenly."


def raster(patches: Subdivision) -> NDArray[Any]:
    """Patch of each direction of a raster; uint32, of the shape `RASTER`.

    Rows are equal steps of the polar angle, columns of the azimuth, at their middles.
    """
    n_theta, n_phi = RASTER
    theta = (np.arange(n_theta) + 0.5) * np.pi / 2 / n_theta
    phi = (np.arange(n_phi) + 0.5) * 2 * np.pi / n_phi
    v = direction(*np.meshgrid(theta, phi, indexing="ij"))
    return patches.patch(v).astype("<u4")


def _block(single: Record) -> str:
    """Patch means, their uncertainties and hits at one incident direction."""
    shown = ("brdf", "btdf") if single.has_lower else ("brdf",)
    n_channels = len(single.channels)

    def flat(arrays: list[Any]) -> Floats:
        return np.stack([np.reshape(one, (-1, n_channels)) for one in arrays])

    mean = flat([getattr(single, of) for of in shown])
    std_err = flat([getattr(single, f"{of}_std_err") for of in shown])
    limits = [single.interval(0.95, of=of) for of in shown]
    low, high = (flat([pair[end] for pair in limits]) for end in (0, 1))
    arrays = [mean.astype("<f4")]
    arrays += [_rounded(one) for one in (std_err, mean - low, high - mean)]
    hits = np.minimum(single.counts, np.iinfo(np.uint32).max).astype("<u4")
    return _packed(*arrays, hits)


def _rounded(values: Floats) -> NDArray[np.float32]:
    """Numbers of `UNCERTAIN_BITS` bits, which deflate well; NaN where not finite."""
    mantissa, exponent = np.frexp(values)
    mantissa = np.round(mantissa * 2**UNCERTAIN_BITS) / 2**UNCERTAIN_BITS
    return np.where(np.isfinite(values), np.ldexp(mantissa, exponent), np.nan).astype(
        "<f4"
    )


def _packed(*arrays: NDArray[Any]) -> str:
    """The bytes of arrays, one after the other, deflated, in base 64."""
    raw = b"".join(np.ascontiguousarray(one).tobytes() for one in arrays)
    return base64.b64encode(zlib.compress(raw, 6)).decode("ascii")

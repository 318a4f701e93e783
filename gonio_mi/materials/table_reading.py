"""Reading tables of double precision, lane by lane, in Dr.Jit."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

__all__ = ["between", "doubles", "last", "quantile", "read", "tilted"]


def doubles(values: ArrayLike) -> mi.Float64:
    """Array of all values, in one row."""
    return mi.Float64(np.ascontiguousarray(values, dtype=np.float64).ravel())


def read(array: mi.Float64, index: mi.UInt32, active: mi.Bool = True) -> mi.Float64:
    """Numbers of an array, 0 where not active."""
    return dr.gather(mi.Float64, array, mi.UInt32(index), active)


def last(n: int, begins: Callable[[mi.UInt32], mi.Bool]) -> mi.UInt32:
    """Last of `n` ascending pieces that `begins`; the first always does."""
    if n == 1:
        return mi.UInt32(0)
    return mi.UInt32(dr.binary_search(1, n, begins)) - 1


def between(edges: mi.Float64, number: mi.UInt32, part: mi.Float64) -> mi.Float64:
    """Coordinate of the part of a bin."""
    low, high = read(edges, number), read(edges, number + 1)
    return low + part * (high - low)


def quantile(
    shares: Callable[[mi.UInt32], mi.Float64], n: int, share: mi.Float64
) -> tuple[mi.UInt32, mi.Float64]:
    """Bin up to which `share` of the light is, and the part of it in the bin.

    `shares` gives what is below each of the ``n + 1`` edges.
    """
    number = last(n, lambda i: shares(i) <= share)
    low, high = shares(number), shares(number + 1)
    inside = dr.select(high > low, (share - low) / (high - low), 0.5)
    return number, dr.clip(inside, 0, 1)


def tilted(share: mi.Float64, tilt: mi.Float64) -> mi.Float64:
    """Coordinate below which `share` of a density is that is linear from 0 to 1.

    It changes by `tilt`, within 2, and is 1 in the middle.
    """
    tilt = dr.clip(tilt, -2, 2)
    start = 1 - tilt / 2
    root = start + dr.safe_sqrt(start * start + 2 * tilt * share)
    return dr.select(root > 0, dr.clip(2 * share / root, 0, 1), share)

"""Dr.Jit's array functions under the names that subdivisions call."""

from __future__ import annotations

from types import SimpleNamespace

import drjit as dr
import mitsuba as mi

from ..array_types import Floats, Numbers

__all__ = ["DRJIT"]


def _count_below(edges: Floats, x: mi.Float) -> mi.Float:
    """Count the ascending `edges` that are not above `x`."""
    edges = mi.Float(edges.tolist())
    count = dr.binary_search(
        0, dr.width(edges), lambda i: dr.gather(mi.Float, edges, i) <= x
    )
    return mi.Float(count)


def _take(table: Numbers, index: mi.Float) -> mi.Float:
    """Entries of a float32 `table` at whole floating-point numbers."""
    return dr.gather(mi.Float, mi.Float(table), mi.UInt32(index))


# What Dr.Jit calls as NumPy does.
SAME = ("sqrt", "sin", "cos", "atan2", "floor", "ceil", "minimum")

# See gonio_mi.collector.Subdivision.patch_index.
DRJIT = SimpleNamespace(
    **{name: getattr(dr, name) for name in SAME},
    where=dr.select,
    count_below=_count_below,
    take=_take,
)

"""Dr.Jit's array functions under the names that subdivisions call."""

from types import SimpleNamespace

import drjit as dr
import mitsuba as mi

__all__ = ["DRJIT"]


def _count_below(borders, x):
    """Count the ascending `borders` that are not above `x`."""
    borders = mi.Float(borders.tolist())
    count = dr.binary_search(
        0, dr.width(borders), lambda i: dr.gather(mi.Float, borders, i) <= x
    )
    return mi.Float(count)


def _take(table, index):
    """Entries of a float32 `table` at whole floating-point numbers."""
    return dr.gather(mi.Float, mi.Float(table), mi.UInt32(index))


# See gonio_mi.collector.Subdivision.patch_index.
DRJIT = SimpleNamespace(
    sqrt=dr.sqrt,
    atan2=dr.atan2,
    floor=dr.floor,
    ceil=dr.ceil,
    minimum=dr.minimum,
    where=dr.select,
    count_below=_count_below,
    take=_take,
)

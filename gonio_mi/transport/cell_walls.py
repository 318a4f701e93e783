"""Walls of glass, or of media, in the sides of a periodic cell: no endless piece's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import mitsuba as mi
import numpy as np

from ..array_types import Floats
from .traversal import traversed

__all__ = ["encloses_medium", "refracts", "walls_in_sides"]

# How near to the side of the cell a wall is in it, in units of the cell.
NEAR = 1e-5


def walls_in_sides(
    shapes: Sequence[mi.Shape],
    low: Floats,
    high: Floats,
    which: Callable[[mi.Shape], bool],
) -> list[str]:
    """Names of the shapes, of those `which`, with faces in the sides of the cell.

    Parameters
    ----------
    shapes : sequence of mi.Shape
    low, high : ndarray, shape (3,)
        Corners of the cell.
    which : callable
        Such as :func:`refracts` and :func:`encloses_medium`.
    """
    return [_name(shape) for shape in filter(which, shapes) if _walls(shape, low, high)]


def refracts(shape: mi.Shape) -> bool:
    """Whether light that passes is bent: no mask, and no thin sheet."""
    flags = shape.bsdf().flags()
    bent = mi.BSDFFlags.DeltaTransmission, mi.BSDFFlags.GlossyTransmission
    refracted = any(mi.has_flag(flags, flag) for flag in bent)
    return refracted and not mi.has_flag(flags, mi.BSDFFlags.Null)


def encloses_medium(shape: mi.Shape) -> bool:
    """Whether light may pass it into a medium, or out of one."""
    flags = shape.bsdf().flags()
    return shape.is_medium_transition() and mi.has_flag(
        flags, mi.BSDFFlags.Transmission
    )


def _walls(shape: mi.Shape, low: Floats, high: Floats) -> bool:
    """Whether a face of the shape is in a side of the cell."""
    near = NEAR * (high - low)[:2]
    for triangle in _faces(shape):
        for axis in (0, 1):
            along = triangle[..., axis]
            for side in (low[axis], high[axis]):
                if (np.abs(along - side) <= near[axis]).all(axis=-1).any():
                    return True
    return False


def _faces(shape: mi.Shape) -> list[Floats]:
    """Triangles of a mesh ``(n, 3, 3)``, or the box of what is flat."""
    if shape.class_name() in ("Rectangle", "Disk"):
        box = shape.bbox()
        return [np.array([[box.min, box.max]], dtype=float).reshape(1, 2, 3)]
    parameters: Any = traversed(shape)
    if "vertex_positions" not in parameters:
        return []
    points = np.array(parameters["vertex_positions"], dtype=float).reshape(-1, 3)
    faces = np.array(parameters["faces"], dtype=int).reshape(-1, 3)
    return [points[faces]]


def _name(shape: mi.Shape) -> str:
    return f"{shape.class_name()} {shape.id()!r}"

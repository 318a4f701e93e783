"""Points of the unit disk onto which hemispheres project, in Dr.Jit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

__all__ = ["DiskPoint", "above", "on_disk", "seen_from", "towards", "turned"]


@dataclass(frozen=True)
class DiskPoint:
    """Point of the unit disk, turned so that light comes from +x."""

    x: mi.Float64
    v: mi.Float64  # y / sqrt(1 - x^2)


def seen_from(wo: mi.Vector3f, phi_i: mi.Float64) -> DiskPoint:
    """Point of the disk below (or above) which a unit vector ends."""
    x, y, z = (mi.Float64(component) for component in (wo.x, wo.y, wo.z))
    norm = 1 / dr.sqrt(x * x + y * y + z * z)
    return on_disk([norm * one for one in turned([x, y, z], -phi_i)])


def on_disk(wo: Sequence[Any]) -> DiskPoint:
    """The same for one in the frame of incidence, by its coordinates."""
    x, y, z = wo
    across = dr.sqrt(y * y + z * z)
    return DiskPoint(dr.clip(x, -1, 1), dr.select(across > 0, y / across, 0))


def above(point: DiskPoint) -> list[Any]:
    """Coordinates of the unit vector above a point of the disk."""
    across = dr.safe_sqrt(1 - dr.square(point.x))
    return [point.x, point.v * across, across * dr.safe_sqrt(1 - dr.square(point.v))]


def turned(v: Sequence[Any], angle: mi.Float64) -> list[Any]:
    """Coordinates of a vector turned about the normal."""
    sin, cos = dr.sincos(angle)
    x, y, z = v
    return [x * cos - y * sin, x * sin + y * cos, z]


def towards(point: DiskPoint, phi_i: mi.Float64, upper: mi.Bool) -> mi.Vector3f:
    """Unit vector above or below a point of the disk."""
    x, y, z = turned(above(point), phi_i)
    return mi.Vector3f(x, y, dr.select(upper, z, -z))

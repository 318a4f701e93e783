"""Free flight: what rays meet, cross and pass until they meet it indeed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi

from .ray_offsets import (
    departure,
    intersect,
    into_cell,
    is_back_face,
    is_self_hit,
    leaves_by_a_side,
    resume,
    through_side,
)

__all__ = [
    "Encounter",
    "Flight",
    "encounter",
    "escapes",
    "flight_from",
    "proceed",
    "unobstructed",
]

# Cells after which a ray is as good as horizontal.
MAX_CELLS = 4096


@dataclass
class Flight:
    """Rays on their way: variables of a loop, which `proceed` changes in place.

    Attributes
    ----------
    ray : mi.Ray3f
        Inside the cell of a periodic specimen.
    shift : mi.Vector3f
        From there to where the ray is among the copies of that cell.
    n, offset : mi.Normal3f, mi.Float
        Geometric normal where it started, 0 off a surface, and how far off that.
    again : mi.Bool
        Whether it looks again at what it met from behind.
    cells : mi.UInt32
        Sides of a periodic cell that it crossed.
    """

    ray: Any
    shift: Any
    n: Any
    offset: Any
    again: Any
    cells: Any


def flight_from(specimen: Any, ray: mi.Ray3f, n: Any = 0, offset: Any = 0) -> Flight:
    """:class:`Flight` of new rays; those that start on a surface tell where."""
    ray = mi.Ray3f(ray)
    ray.o, shift = into_cell(specimen, ray.o)
    n, offset = mi.Normal3f(n), mi.Float(offset)
    return Flight(ray, shift, n, offset, mi.Bool(False), mi.UInt32(0))


@dataclass
class Encounter:
    """What rays meet next; none but `missed` and `crosses` have a surface there.

    Attributes
    ----------
    missed, endless : mi.Bool
        No surface is in the way, and of these: too many cells were crossed.
    self_hit, back_face, real : mi.Bool
        Stepped over, looked at again, and met indeed.
    crosses : mi.Bool
        Goes through a side of the periodic cell, and on from `entry`.
    entry, step : mi.Point3f, mi.Vector3f
        See `through_side`.
    """

    missed: Any
    endless: Any
    self_hit: Any
    back_face: Any
    real: Any
    crosses: Any
    entry: Any
    step: Any

    @property
    def goes_on(self) -> mi.Bool:
        """Whether the ray is the same after it."""
        return self.self_hit | self.back_face | self.crosses

    def unless(self, earlier: mi.Bool) -> Encounter:
        """The same without the rays to which something happens `earlier`."""
        masks = ("missed", "endless", "self_hit", "back_face", "real", "crosses")
        left = {name: getattr(self, name) & ~earlier for name in masks}
        return replace(self, **left)


def encounter(
    specimen: Any,
    side: int,
    flight: Flight,
    si: mi.SurfaceInteraction3f,
    active: mi.Bool,
) -> Encounter:
    """:class:`Encounter` of the rays of a flight with what Mitsuba found."""
    ray = flight.ray
    hit = active & si.is_valid()
    missed = active & ~hit
    entry, step, crosses = through_side(specimen, side, ray.o, ray.d)
    crosses &= missed
    endless = crosses & (flight.cells >= MAX_CELLS)
    self_hit = is_self_hit(specimen, si, ray, flight.n) & hit
    back_face = is_back_face(specimen, si, ray) & ~self_hit & ~flight.again & hit
    real = hit & ~self_hit & ~back_face
    crosses &= ~endless
    return Encounter(missed, endless, self_hit, back_face, real, crosses, entry, step)


def proceed(
    specimen: Any,
    flight: Flight,
    si: mi.SurfaceInteraction3f,
    met: Encounter,
    scattered: mi.Bool | None = None,
    wo: mi.Vector3f | None = None,
) -> None:
    """Start the next rays: of those that go on, and of those that were scattered.

    `wo` is the direction in the world of those that were `scattered`, if any were.
    """
    ray = flight.ray
    moved = met.self_hit | met.back_face
    origin = resume(specimen, si, ray.d, met.back_face)
    if scattered is not None:
        moved |= scattered
        departed, off_surface = departure(specimen, si, ray.d, wo)
        origin = dr.select(scattered, departed, origin)
        flight.offset[scattered] = off_surface
        flight.n[scattered] = si.n
        ray.d[scattered] = wo
    flight.again = mi.Bool(met.back_face)
    flight.offset[met.self_hit] = 8 * flight.offset
    flight.n[met.back_face | met.crosses] = mi.Normal3f(0)
    origin += dr.copysign(flight.offset, dr.dot(flight.n, ray.d)) * flight.n
    origin, shift = into_cell(specimen, origin)
    ray.o[moved] = origin
    flight.shift[moved] = flight.shift + shift
    ray.o[met.crosses] = met.entry
    flight.shift[met.crosses] = flight.shift + met.step
    flight.cells[met.crosses] = flight.cells + 1


def escapes(
    specimen: Any,
    side: int,
    ray: mi.Ray3f,
    n: mi.Normal3f,
    offset: mi.Float,
    active: mi.Bool,
) -> mi.Bool:
    """Whether nothing stands in the way of rays that left a surface.

    Parameters
    ----------
    specimen : Specimen
    side : int
        Of the emitter: 1 above, -1 below.
    ray : mi.Ray3f
    n, offset : mi.Normal3f, mi.Float
        Geometric normal where they left, and how far off its surface they started.
    active : mi.Bool

    Returns
    -------
    mi.Bool
        False for those that leave through a side of the specimen's bounding box.
    """
    free, last = unobstructed(specimen, side, ray, n, offset, active)
    return free & ~leaves_by_a_side(specimen, last.o, last.d)


@dr.syntax
def unobstructed(
    specimen: Any,
    side: int,
    ray: mi.Ray3f,
    n: mi.Normal3f,
    offset: mi.Float,
    active: mi.Bool,
) -> tuple[mi.Bool, mi.Ray3f]:
    """As :func:`escapes`, sides or no sides; and the rays as they were at last."""
    flight = flight_from(specimen, ray, n, offset)
    free = mi.Bool(False)
    flying = mi.Bool(active)
    scene = specimen.scene
    while flying:
        si = intersect(scene, flight.ray, mi.RayFlags.Minimal, flying)
        met = encounter(specimen, side, flight, si, flying)
        free |= met.missed & ~met.crosses & ~met.endless
        proceed(specimen, flight, si, met)
        flying = met.goes_on
    return free, flight.ray

r"""Rays through geometry: where they start, what they meet, and how they go on.

A ray starts a few roundings off its surface. What Mitsuba says it hits may be that very
plane, or the far wall of a crest which it passes just above, seen from behind::

         ^ n                             --------> ray, within rounding of the crest
         |  / ray                          /\
         | /                        near  /  \  far
    -----o----------- plane         wall /    \ wall

    is_self_hit: stepped over       is_back_face: looked at again, from nearby and above
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi

from ..loops import syntax
from ..mitsuba_compat import FRAME, MINIMAL

# How far a ray starts off its surface, in units of the local coordinates: 64 ulp. Off a
# plane 2 ulp are enough, since a hit on that plane is recognised, within this part of
# the specimen's coordinates, and stepped over.
SURFACE_OFFSET = 2.0**-18
PLANE_OFFSET = 2.0**-23
SAME_PLANE = 2.0**-20

# How far a reflected ray starts back along the one that came, in the same units: 16
# ulp. Where two walls meet, a point off the one may lie behind the other, but the light
# came from where there is none.
RETREAT = 2.0**-19

# Distance, in units of the specimen's coordinates, from which a ray looks again at what
# it met from behind.
NEARBY = 2.0**-16

# How far above the specimen rays start, and how far they are lifted where they enter a
# periodic cell or meet a crest, so that no rounding takes them below an edge that they
# passed above.
LIFT = 2.0**-20

# How far above the footprint rays start, in the same units: further than a ray is moved
# that looks again, so that it does not pass what faces away.
START = 2.0**-18


def intersect(
    scene: mi.Scene,
    ray: mi.Ray3f,
    flags: int,
    active: mi.Bool,
    coherent: mi.Bool | bool = False,
) -> mi.SurfaceInteraction3f:
    """Surface interaction whose geometric normal is on the side of the shading normal.

    Mitsuba 3.9.1 turns the former alone over where a rectangle or mesh is mirrored.
    `coherent`: whether the rays of neighbouring lanes are alike; that is for speed.
    Embree 3 then follows them in packets, and decides within rounding of an edge by
    which rays are in a packet (10 of 1e7 on a mirror field); else one by one.
    """
    return with_normal(scene.ray_intersect(ray, flags | FRAME, coherent, active))


def nearest(
    specimen: Any,
    ray: mi.Ray3f,
    flags: int,
    active: mi.Bool,
    coherent: mi.Bool | bool = False,
) -> mi.SurfaceInteraction3f:
    """:func:`intersect` of rays inside of a cell with all that reaches into it."""
    if specimen.box.shifts is None:
        return intersect(specimen.scene, ray, flags, active, coherent)
    return _of_copies(specimen, ray, flags, active, coherent)


@syntax
def _of_copies(
    specimen: Any, ray: mi.Ray3f, flags: int, active: mi.Bool, coherent: Any
) -> mi.SurfaceInteraction3f:
    """The nearest of what rays meet in the copies of the geometry, each a shift away.

    Up to just beyond the sides of the cell: what is within rounding of a side is met on
    this side of it, and not lost between two cells.
    """
    box, scene = specimen.box, specimen.scene
    beyond = box.reach * NEARBY
    low, high, o, d = box.low, box.high, ray.o, ray.d
    t_x = exit_distance(low[0] - beyond, high[0] + beyond, o.x, d.x)
    t_y = exit_distance(low[1] - beyond, high[1] + beyond, o.y, d.y)
    best = dr.zeros(mi.PreliminaryIntersection3f)
    met = mi.Bool(False)
    here = mi.Ray3f(ray)
    here.maxt = dr.minimum(t_x, t_y)
    shift = mi.Vector3f(0)
    i = mi.UInt32(0)
    while i < box.n_shifts:
        step = dr.gather(mi.Vector3f, box.shifts, i)
        here.o = ray.o - step
        found = scene.ray_intersect_preliminary(here, coherent, active)
        nearer = active & found.is_valid()
        best = dr.select(nearer, found, best)
        shift = dr.select(nearer, step, shift)
        here.maxt = dr.select(nearer, found.t, here.maxt)
        met |= nearer
        i += 1
    here.o = ray.o - shift
    si = best.compute_surface_interaction(here, flags | FRAME, active & met)
    si.p += shift
    return with_normal(si)


def with_normal(si: mi.SurfaceInteraction3f) -> mi.SurfaceInteraction3f:
    """The interaction, its geometric normal on the side of the shading normal."""
    si.n = dr.select(dr.dot(si.n, si.sh_frame.n) < 0, -si.n, si.n)
    return si


def departure(
    specimen: Any, si: mi.SurfaceInteraction3f, d: mi.Vector3f, wo: mi.Vector3f
) -> tuple[mi.Point3f, mi.Float]:
    """Where light that came along `d` starts along `wo`.

    Returns
    -------
    p : mi.Point3f
        On the surface, or if it is reflected, just before.
    offset : mi.Float
        How far to go off the surface from there.
    """
    detail = specimen.box.detail
    flat = dr.all((si.dn_du == 0) & (si.dn_dv == 0))
    scale = detail + dr.max(dr.abs(si.p))
    across = detail + dr.dot(dr.abs(si.n), dr.abs(si.p))
    offset = dr.select(flat, across * PLANE_OFFSET, scale * SURFACE_OFFSET)
    reflected = dr.dot(si.n, wo) * dr.dot(si.n, d) < 0
    return si.p - dr.select(reflected, scale * RETREAT, 0.0) * d, offset


def is_self_hit(
    specimen: Any, si: mi.SurfaceInteraction3f, ray: mi.Ray3f, n: mi.Normal3f
) -> mi.Bool:
    """Whether a ray that left a plane of normal `n` hits that plane: rounding."""
    beside = dr.abs(dr.dot(si.p - ray.o, si.n)) < specimen.box.reach * SAME_PLANE
    return dr.all(si.n == n) & beside


def is_back_face(specimen: Any, si: mi.SurfaceInteraction3f, ray: mi.Ray3f) -> mi.Bool:
    """Whether a surface without transmission is hit on the side of no normal.

    Of two walls that meet in a crest, rounding may show the far one. In a plane there
    is no crest that could be the reason.
    """
    if not specimen.closed_to_light or specimen.low[2] == specimen.high[2]:
        return mi.Bool(False)
    return dr.dot(si.n, ray.d) > 0


def resume(
    specimen: Any, si: mi.SurfaceInteraction3f, d: mi.Vector3f, behind: mi.Bool
) -> mi.Point3f:
    """Where a ray goes on that is misjudged: on the plane, or just before it.

    A ray that meets a crest within rounding is moved off its far wall: it passes above,
    or meets the near wall. One that comes from behind a surface that is open, or faces
    away, meets it again: it is moved back by more than off.
    """
    reach = specimen.box.reach
    off = reach * LIFT
    beyond = 2 * off / dr.abs(dr.dot(si.n, d))
    back = dr.minimum(si.t / 2, dr.maximum(reach * NEARBY, beyond))
    return si.p + dr.select(behind, off * si.n - back * d, 0.0)


def into_cell(specimen: Any, p: mi.Point3f) -> tuple[mi.Point3f, mi.Vector3f]:
    """Points moved into the periodic cell, and by how much.

    Beside it there is no geometry: not even what is just a rounding error away.
    """
    if not specimen.periodic:
        return mi.Point3f(p), mi.Vector3f(0)
    box, shift = specimen.box, mi.Vector3f(0)
    for axis in (0, 1):
        cells = dr.floor((p[axis] - box.low[axis]) * box.per_period[axis])
        shift[axis] = box.period[axis] * cells
    return p - shift, shift


def through_side(
    specimen: Any, side: int, o: mi.Point3f, d: mi.Vector3f
) -> tuple[mi.Point3f, mi.Vector3f, mi.Bool]:
    """Where rays that leave the periodic cell through a side enter it again.

    Returns
    -------
    p : mi.Point3f
        On the opposite side, to the bit, and lifted towards the emitter's `side`.
    step : mi.Vector3f
        By how much the ray went further than that.
    crosses : mi.Bool
        Whether it leaves through a side; never if the specimen is not periodic.
    """
    p, step = mi.Point3f(o), mi.Vector3f(0)
    if not specimen.periodic:
        return p, step, mi.Bool(False)
    box = specimen.box
    low, high = box.low, box.high
    t_x, t_y, t_z = (exit_distance(low[i], high[i], o[i], d[i]) for i in range(3))
    # a ray that is outside by rounding leaves at once
    t = dr.maximum(dr.minimum(t_x, t_y), 0)
    p = o + t * d
    p.z += side * box.reach * LIFT
    for axis, leaves in ((0, t_x <= t_y), (1, t_x > t_y)):
        up, period = d[axis] > 0, box.period[axis]
        p[axis] = dr.select(leaves, dr.select(up, low[axis], high[axis]), p[axis])
        step[axis] = dr.select(leaves, dr.select(up, period, -period), 0.0)
    return p, step, t < t_z


def exit_distance(low: mi.Float, high: mi.Float, o: mi.Float, d: mi.Float) -> mi.Float:
    """Distance to the face of a slab through which a ray from inside leaves."""
    face = dr.select(d > 0, high, low)
    # -0 and +0 alike: along the face, never through it
    return dr.select(d == 0, dr.inf, (face - o) / d)


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
        return replace(self, **{name: getattr(self, name) & ~earlier for name in masks})


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


@syntax
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
    """
    flight = flight_from(specimen, ray, n, offset)
    free = mi.Bool(False)
    flying = mi.Bool(active)
    while flying:
        si = nearest(specimen, flight.ray, MINIMAL, flying)
        met = encounter(specimen, side, flight, si, flying)
        free |= met.missed & ~met.crosses & ~met.endless
        proceed(specimen, flight, si, met)
        flying = met.goes_on
    return free


@syntax
def first_met(
    specimen: Any, side: int, ray: mi.Ray3f, active: mi.Bool
) -> tuple[mi.Bool, mi.UInt32, mi.Point3f]:
    """What rays from somewhere in space meet first.

    Returns
    -------
    met : mi.Bool
        Whether that is anything.
    number : mi.UInt32
        Of the triangle.
    p : mi.Point3f
        Where it is met, within the periodic cell.
    """
    flight = flight_from(specimen, ray)
    found, number, p = mi.Bool(False), mi.UInt32(0), mi.Point3f(0)
    flying = mi.Bool(active)
    while flying:
        si = nearest(specimen, flight.ray, MINIMAL, flying)
        met = encounter(specimen, side, flight, si, flying)
        found |= met.real
        number[met.real] = si.prim_index
        p[met.real] = si.p
        proceed(specimen, flight, si, met)
        flying = met.goes_on
    return found, number, p

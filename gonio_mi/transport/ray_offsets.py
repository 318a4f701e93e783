"""Free flight: off a surface, through the sides of a periodic cell, out of reach."""

import drjit as dr
import mitsuba as mi

__all__ = [
    "MAX_CELLS",
    "departure",
    "escapes",
    "intersect",
    "into_cell",
    "is_misjudged",
    "leaves_by_a_side",
    "resume",
    "through_side",
]

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

# Cells after which a ray is as good as horizontal.
MAX_CELLS = 4096


def intersect(scene, ray, flags, active):
    """Surface interaction whose geometric normal is on the side of the shading normal.

    Mitsuba 3.9.1 turns the former alone over where a rectangle or mesh is mirrored.
    """
    flags |= mi.RayFlags.ShadingFrame
    si = scene.ray_intersect(ray, flags, False, active)
    si.n = dr.select(dr.dot(si.n, si.sh_frame.n) < 0, -si.n, si.n)
    return si


def departure(specimen, si, d, wo):
    """Where light that came along `d` starts along `wo`.

    Returns
    -------
    p : mi.Point3f
        On the surface, or if it is reflected, just before.
    offset : mi.Float
        How far to go off the surface from there.
    """
    detail = specimen.detail
    flat = dr.all((si.dn_du == 0) & (si.dn_dv == 0))
    scale = detail + dr.max(dr.abs(si.p))
    across = detail + dr.dot(dr.abs(si.n), dr.abs(si.p))
    offset = dr.select(flat, across * PLANE_OFFSET, scale * SURFACE_OFFSET)
    reflected = dr.dot(si.n, wo) * dr.dot(si.n, d) < 0
    return si.p - dr.select(reflected, scale * RETREAT, 0.0) * d, offset


def is_misjudged(specimen, si, ray, n, again):
    """Whether what a ray that left a surface of normal `n` hits is not what it meets.

    `again`: whether the ray is one that looks again.

    Returns
    -------
    own : mi.Bool
        A plane cannot be hit from itself: that is rounding, to be stepped over.
    behind : mi.Bool
        Of two walls that meet in a crest, rounding may show the far one, from behind:
        that is looked at again, from nearby and beside.
    """
    beside = dr.abs(dr.dot(si.p - ray.o, si.n)) < specimen.reach * SAME_PLANE
    own = dr.all(si.n == n) & beside
    return own, _from_behind(specimen, si, ray) & ~own & ~again


def resume(specimen, si, d, behind):
    """Where a ray goes on that `is_misjudged`: on the plane, or just before it.

    A ray that meets a crest within rounding is moved off its far wall: it passes above,
    or meets the near wall. One that comes from behind a surface that is open, or faces
    away, meets it again: it is moved back by more than off.
    """
    off = specimen.reach * LIFT
    beyond = 2 * off / dr.abs(dr.dot(si.n, d))
    back = dr.minimum(si.t / 2, dr.maximum(specimen.reach * NEARBY, beyond))
    return si.p + dr.select(behind, off * si.n - back * d, 0.0)


@dr.syntax
def escapes(specimen, side, ray, n, offset, active):
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
    ray, n, offset = mi.Ray3f(ray), mi.Normal3f(n), mi.Float(offset)
    ray.o = into_cell(specimen, ray.o)[0]
    free = mi.Bool(False)
    flying = mi.Bool(active)
    cells = mi.UInt32(0)
    again = mi.Bool(False)
    scene = specimen.scene
    while flying:
        si = intersect(scene, ray, mi.RayFlags.Minimal, flying)
        hit = flying & si.is_valid()
        entry, _, crosses = through_side(specimen, side, ray.o, ray.d)
        crosses &= flying & ~hit
        free |= flying & ~hit & ~crosses
        crosses &= cells < MAX_CELLS
        own, behind = is_misjudged(specimen, si, ray, n, again)
        own &= hit
        behind &= hit
        again = mi.Bool(behind)
        offset[own] = 8 * offset
        n[behind | crosses] = mi.Normal3f(0)
        origin = resume(specimen, si, ray.d, behind)
        origin += dr.copysign(offset, dr.dot(n, ray.d)) * n
        ray.o[own | behind] = into_cell(specimen, origin)[0]
        ray.o[crosses] = entry
        cells[crosses] = cells + 1
        flying = own | behind | crosses
    return free & ~leaves_by_a_side(specimen, ray.o, ray.d)


def _from_behind(specimen, si, ray):
    """Whether a surface without transmission is hit on the side of no normal.

    In a plane there is no crest that could be the reason.
    """
    if not specimen.closed_to_light or specimen.low[2] == specimen.high[2]:
        return mi.Bool(False)
    return dr.dot(si.n, ray.d) > 0


def into_cell(specimen, p):
    """Points moved into the periodic cell, and by how much.

    Beside it there is no geometry: not even what is just a rounding error away.
    """
    if not specimen.periodic:
        return mi.Point3f(p), mi.Vector3f(0)
    low, high = specimen.low, specimen.high
    shift = mi.Vector3f(0)
    for axis in (0, 1):
        period = float(high[axis] - low[axis])
        shift[axis] = period * dr.floor((p[axis] - float(low[axis])) / period)
    return p - shift, shift


def through_side(specimen, side, o, d):
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
    low, high = specimen.low, specimen.high
    t_x, t_y, t_z = (_exit_distance(low[i], high[i], o[i], d[i]) for i in range(3))
    # a ray that is outside by rounding leaves at once
    t = dr.maximum(dr.minimum(t_x, t_y), 0)
    p = o + t * d
    p.z += side * specimen.reach * LIFT
    for axis, leaves in ((0, t_x <= t_y), (1, t_x > t_y)):
        near, far = float(low[axis]), float(high[axis])
        up = d[axis] > 0
        p[axis] = dr.select(leaves, dr.select(up, near, far), p[axis])
        jump = dr.select(up, far - near, near - far)
        step[axis] = dr.select(leaves, jump, 0.0)
    return p, step, t < t_z


def leaves_by_a_side(specimen, o, d):
    """Whether a ray from inside the bounding box crosses one of its four sides.

    A periodic specimen has none.
    """
    if specimen.periodic:
        return mi.Bool(False)
    low, high = specimen.low, specimen.high
    # a ray that starts just outside of a face has passed it
    t_x, t_y, t_z = (
        dr.maximum(_exit_distance(low[i], high[i], o[i], d[i]), 0) for i in range(3)
    )
    # the horizon is at an infinite distance in z
    return ~(dr.minimum(t_x, t_y) >= t_z)


def _exit_distance(low, high, o, d):
    """Distance to the face of a slab through which a ray from inside leaves."""
    face = dr.select(d > 0, mi.Float(float(high)), mi.Float(float(low)))
    # -0 and +0 alike: along the face, never through it
    return dr.select(d == 0, dr.inf, (face - o) / d)

"""From a beam to exits: one scattering event on a plane, or a loop through geometry.

Flux travels from emitter to collector, so BSDFs are used in importance mode, in which a
transmitted weight is not divided by eta^2 (Veach 1997, section 5.2).
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..tally import Fate

__all__ = ["Exits", "Settings", "flux_context", "scatter_plane", "trace"]

# Weights and powers above these would overflow the fixed-point sums.
LARGEST_WEIGHT = 2.0**15
LARGEST_POWER = 2.0**30

# Relative excess of a weight over 1 that is taken for float32 rounding: 16 ulp.
ROUNDING = 2.0**-20

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

# How far above the specimen rays start, and how far they are lifted where they enter a
# periodic cell, so that no rounding takes them below an edge that they passed above.
LIFT = 2.0**-20

# Cells after which a ray is as good as horizontal.
MAX_CELLS = 4096


@dataclass(frozen=True)
class Settings:
    """How rays are followed: estimator and where paths end."""

    analog: bool
    max_depth: int
    rr_depth: int
    delta_only: bool = False  # on a plane: all else is integrated


@dataclass
class Exits:
    """What became of each ray.

    Attributes
    ----------
    p, d : mi.Point3f, mi.Vector3f
        Last point on the specimen and direction of flight, where `fate` is REFLECTED.
    throughput : mi.Spectrum
        Power left; a whole number for the analog estimator.
    fate : mi.UInt32
        :class:`Fate`; REFLECTED stands for having left in any direction.
    incident : mi.Spectrum
        Power that met the specimen.
    depth : mi.UInt32
        Surface events.
    """

    p: object
    d: object
    throughput: object
    fate: object
    incident: object
    depth: object


def flux_context():
    """Return the BSDF context of light that travels from emitter to collector."""
    return mi.BSDFContext(mi.TransportMode.Importance)


def scatter_plane(plane, beam, sampler, wavelengths, settings):
    """Scatter every ray once where it lands on the plane; exact without ray tracing."""
    p, wi, _, weight = beam.sample(sampler, wavelengths)
    throughput = _emitted(weight, sampler, settings.analog, beam.uniform)
    lit = dr.any(throughput > 0)
    if beam.footprint == "point":
        uv, inside = mi.Point2f(0.5), mi.Bool(True)
    else:
        uv = plane.uv(p)
        inside = (
            mi.Bool(True) if beam.footprint == "full" else dr.all((uv >= 0) & (uv <= 1))
        )
    si = plane.interactions(uv, wi, wavelengths)
    bs, bsdf_weight = plane.bsdf.sample(
        flux_context(), si, sampler.next_1d(), sampler.next_2d(), lit & inside
    )
    wo = si.to_world(bs.wo)
    exit_throughput, fate = _after_event(
        throughput, bsdf_weight, bs, wo, sampler, settings.analog
    )
    if settings.delta_only:
        delta = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        left = fate == mi.UInt32(Fate.REFLECTED)
        fate = dr.select(left & ~delta, mi.UInt32(Fate.INTEGRATED), fate)
    fate = dr.select(inside, fate, mi.UInt32(Fate.MISSED))
    fate = dr.select(lit, fate, mi.UInt32(Fate.UNLIT))
    incident = dr.select(inside & lit, throughput, 0.0)
    depth = dr.select(inside & lit, mi.UInt32(1), 0)
    return Exits(p, wo, exit_throughput, fate, incident, depth)


@dr.syntax
def trace(specimen, beam, sampler, wavelengths, settings):
    """Follow every ray through the geometry until it leaves, ends or is cut off."""
    if hasattr(sampler, "follow_curve"):
        sampler.follow_curve()
    p, wi, distance, weight = beam.sample(sampler, wavelengths)
    β = _emitted(weight, sampler, settings.analog, beam.uniform)

    # from just above the footprint, to which nothing stands in the way
    p, shift = _into_cell(specimen, p)
    start = dr.minimum(distance, specimen.reach * LIFT / dr.abs(wi.z))
    ray = mi.Ray3f(p + start * wi, -wi)
    ray.wavelengths = wavelengths

    ctx = flux_context()
    flags = mi.RayFlags.All | mi.RayFlags.dNSdUV
    scene = specimen.scene
    detail = specimen.detail
    analog = settings.analog
    same_plane = specimen.reach * SAME_PLANE
    nearby = 16 * specimen.reach * RETREAT
    max_depth = dr.opaque(mi.UInt32, settings.max_depth)
    rr_depth = dr.opaque(mi.UInt32, settings.rr_depth)

    lit = dr.any(β > 0)
    incident = mi.Spectrum(β)  # Power that met the specimen
    depth = mi.UInt32(0)  # Surface events so far
    cells = mi.UInt32(0)  # Sides of a periodic cell that were crossed
    fate = dr.select(lit, mi.UInt32(Fate.MISSED), mi.UInt32(Fate.UNLIT))
    active = mi.Bool(lit)  # Still in flight?

    n = mi.Normal3f(0)  # Geometric normal where the ray started
    offset = mi.Float(0)  # How far off its surface

    while active:
        si = scene.ray_intersect(ray, flags, False, active)
        hit = active & si.is_valid()

        # ------------------- Rays that leave, or have had enough events ---------------
        entry, step, crosses = _through_side(specimen, beam.side, ray.o, ray.d)
        crosses &= active & ~hit
        endless = crosses & (cells >= MAX_CELLS)
        fate[active & ~hit & (depth > 0)] = mi.UInt32(Fate.REFLECTED)
        fate[endless] = mi.UInt32(Fate.SIDEWAYS)
        crosses &= ~endless

        # A plane cannot be hit from itself: that is rounding, to be stepped over
        beside = dr.abs(dr.dot(si.p - ray.o, si.n)) < same_plane
        own = hit & dr.all(si.n == n) & beside
        # Of two walls that meet in a crest, rounding may show the far one, from behind:
        # which is nearer is seen from nearby
        behind = _from_behind(specimen, si, ray) & hit & ~own & (si.t > nearby)
        active = hit & ~own & ~behind

        truncated = active & (depth >= max_depth)
        fate[truncated] = mi.UInt32(Fate.TRUNCATED)
        active &= ~truncated

        # ------------------------------- Scattering -----------------------------------
        bsdf = si.bsdf(ray)
        bs, bsdf_weight = bsdf.sample(
            ctx, si, sampler.next_1d(active), sampler.next_2d(active), active
        )
        wo = si.to_world(bs.wo)
        bsdf_weight *= _shading_normal_correction(si, ray, bs, wo)
        event_β, event_fate = _after_event(β, bsdf_weight, bs, wo, sampler, analog)
        β[active] = event_β
        fate[active] = event_fate
        active &= event_fate == mi.UInt32(Fate.REFLECTED)
        depth[active] += 1

        # ---------------------------- Russian roulette --------------------------------
        survival = dr.select(
            depth > rr_depth, dr.minimum(dr.max(β), 0.95), mi.Float(1.0)
        )
        survives = sampler.next_1d(active) < survival
        β[active] = dr.select(survives, β / survival, 0.0)
        fate[active & ~survives] = mi.UInt32(Fate.ABSORBED)
        active &= survives

        # ------------------------------- Next ray -------------------------------------
        flat = dr.all((si.dn_du == 0) & (si.dn_dv == 0))
        scale = detail + dr.max(dr.abs(si.p))
        across = detail + dr.dot(dr.abs(si.n), dr.abs(si.p))
        offset[active] = dr.select(flat, across * PLANE_OFFSET, scale * SURFACE_OFFSET)
        offset[own] = 8 * offset
        n[active] = si.n
        n[behind | crosses] = mi.Normal3f(0)
        reflected = active & (dr.dot(si.n, wo) * dr.dot(si.n, ray.d) < 0)
        retreat = dr.select(reflected, scale * RETREAT, 0.0)
        retreat = dr.select(behind, nearby / 2, retreat)
        origin = si.p - retreat * ray.d
        ray.d[active] = wo
        active |= own | behind
        ray.o[active] = origin + dr.copysign(offset, dr.dot(n, ray.d)) * n
        ray.o[crosses] = entry
        shift[crosses] = shift + step
        cells[crosses] = cells + 1
        active |= crosses

    incident = dr.select(fate == mi.UInt32(Fate.MISSED), 0.0, incident)
    fate = dr.select(
        (fate == mi.UInt32(Fate.REFLECTED)) & _leaves_by_a_side(specimen, ray.o, ray.d),
        mi.UInt32(Fate.SIDEWAYS),
        fate,
    )
    return Exits(ray.o + shift, ray.d, β, fate, incident, depth)


def _emitted(weight, sampler, analog, uniform):
    """Power of a new ray; for the analog estimator a whole number of that mean."""
    if not analog or uniform:
        return mi.Spectrum(weight)
    return _whole(weight, sampler.next_1d())


def _after_event(throughput, bsdf_weight, bs, wo, sampler, analog):
    """Throughput after a surface event, and its fate: REFLECTED means in flight."""
    largest, smallest = dr.max(bsdf_weight), dr.min(bsdf_weight)
    norm2 = dr.squared_norm(wo)
    zero = largest == 0
    # comparisons with NaN are false
    valid = (smallest >= 0) & (largest <= LARGEST_WEIGHT)
    valid &= zero | (dr.abs(norm2 - 1) < 1e-3)
    product = throughput * dr.select(valid, bsdf_weight, 0.0)
    valid &= dr.max(product) <= LARGEST_POWER
    throughput = _whole(product, sampler.next_1d()) if analog else product
    fate = dr.select(
        dr.any(throughput > 0), mi.UInt32(Fate.REFLECTED), mi.UInt32(Fate.ABSORBED)
    )
    fate = dr.select(zero & ~(bs.pdf > 0), mi.UInt32(Fate.REJECTED), fate)
    return throughput, dr.select(valid, fate, mi.UInt32(Fate.INVALID))


def _whole(x, u):
    """Random whole number with mean `x`, the same `u` in [0, 1) for all channels.

    A weight that exceeds a whole number by rounding alone counts as that number.
    """
    floor = dr.floor(x)
    rest = x - floor
    above = (u < rest) & ((x < 1) | (rest > x * ROUNDING))
    return floor + dr.select(above, mi.Spectrum(1.0), mi.Spectrum(0.0))


def _shading_normal_correction(si, ray, bs, wo):
    """Adjoint correction for interpolated normals (Veach 1997, eq. 5.19); 1 for others.

    0 where geometric and shading normal disagree about the side: light would leak.
    """
    wi_n, wo_n = dr.dot(si.n, -ray.d), dr.dot(si.n, wo)
    wi_s, wo_s = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(bs.wo)
    agree = (wi_n * wi_s > 0) & (wo_n * wo_s > 0)
    flat = dr.all(si.sh_frame.n == si.n)
    corrected = dr.select(agree, dr.abs(wi_s * wo_n / (wo_s * wi_n)), 0.0)
    return dr.select(flat, mi.Float(1.0), corrected)


def _from_behind(specimen, si, ray):
    """Whether a surface without transmission is hit on the side of no normal."""
    if not specimen.closed_to_light:
        return mi.Bool(False)
    return dr.dot(si.n, ray.d) > 0


def _into_cell(specimen, p):
    """Points of the footprint moved into the periodic cell, and by how much."""
    if not specimen.periodic:
        return p, mi.Vector3f(0)
    low, high = specimen.low, specimen.high
    shift = mi.Vector3f(0)
    for axis in (0, 1):
        period = float(high[axis] - low[axis])
        shift[axis] = period * dr.floor((p[axis] - float(low[axis])) / period)
    return p - shift, shift


def _through_side(specimen, side, o, d):
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


def _leaves_by_a_side(specimen, o, d):
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

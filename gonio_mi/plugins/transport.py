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
# the specimen's size, and stepped over.
SURFACE_OFFSET = 2.0**-18
PLANE_OFFSET = 2.0**-23
SAME_PLANE = 2.0**-20


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
    """

    p: object
    d: object
    throughput: object
    fate: object
    incident: object


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
    return Exits(p, wo, exit_throughput, fate, incident)


@dr.syntax
def trace(specimen, beam, sampler, wavelengths, settings):
    """Follow every ray through the geometry until it leaves, ends or is cut off."""
    p, wi, distance, weight = beam.sample(sampler, wavelengths)
    β = _emitted(weight, sampler, settings.analog, beam.uniform)

    # from the emitter, or from just outside of the specimen if that is nearer
    start = dr.minimum(distance, 2.0 * specimen.size)
    ray = mi.Ray3f(p + start * wi, -wi)
    ray.wavelengths = wavelengths

    ctx = flux_context()
    flags = mi.RayFlags.All | mi.RayFlags.dNSdUV
    scene = specimen.scene
    detail = specimen.detail
    analog = settings.analog
    same_plane = specimen.size * SAME_PLANE
    max_depth = dr.opaque(mi.UInt32, settings.max_depth)
    rr_depth = dr.opaque(mi.UInt32, settings.rr_depth)

    lit = dr.any(β > 0)
    incident = mi.Spectrum(β)  # Power that met the specimen
    depth = mi.UInt32(0)  # Surface events so far
    fate = dr.select(lit, mi.UInt32(Fate.MISSED), mi.UInt32(Fate.UNLIT))
    active = mi.Bool(lit)  # Still in flight?

    n = mi.Normal3f(0)  # Geometric normal where the ray started
    offset = mi.Float(0)  # How far off its surface

    while active:
        si = scene.ray_intersect(ray, flags, False, active)
        hit = active & si.is_valid()

        # ------------------- Rays that leave, or have had enough events ---------------
        fate[active & ~hit & (depth > 0)] = mi.UInt32(Fate.REFLECTED)

        # A plane cannot be hit from itself: that is rounding, to be stepped over
        beside = dr.abs(dr.dot(si.p - ray.o, si.n)) < same_plane
        own = hit & dr.all(si.n == n) & beside
        active = hit & ~own

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
        scale = dr.max(dr.abs(si.p)) + detail
        n[active] = si.n
        offset[active] = scale * dr.select(flat, PLANE_OFFSET, SURFACE_OFFSET)
        offset[own] = 8 * offset
        ray.d[active] = wo
        active |= own
        ray.o[active] = si.p + dr.copysign(offset, dr.dot(n, ray.d)) * n

    incident = dr.select(fate == mi.UInt32(Fate.MISSED), 0.0, incident)
    fate = dr.select(
        (fate == mi.UInt32(Fate.REFLECTED)) & _leaves_by_a_side(specimen, ray.o, ray.d),
        mi.UInt32(Fate.SIDEWAYS),
        fate,
    )
    return Exits(ray.o, ray.d, β, fate, incident)


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


def _leaves_by_a_side(specimen, o, d):
    """Whether a ray from inside the bounding box crosses one of its four sides."""

    def exit_distance(low, high, o, d):
        face = dr.select(d > 0, mi.Float(float(high)), mi.Float(float(low)))
        # -0 and +0 alike: along the face, never through it
        return dr.select(d == 0, dr.inf, (face - o) / d)

    low, high = specimen.low, specimen.high
    t_x = exit_distance(low[0], high[0], o.x, d.x)
    t_y = exit_distance(low[1], high[1], o.y, d.y)
    t_z = exit_distance(low[2], high[2], o.z, d.z)
    # the horizon is at an infinite distance in z
    return ~(dr.minimum(t_x, t_y) >= t_z)

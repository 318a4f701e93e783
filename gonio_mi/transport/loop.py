"""From a beam to exits: one scattering event on a plane, or a loop through geometry.

Flux travels from emitter to collector, so BSDFs are used in importance mode, in which a
transmitted weight is not divided by eta^2 (Veach 1997, section 5.2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..results.tally import Fate
from ..single_precision import FEW_ROUNDINGS
from .beam import Beam
from .flat_rectangle import Plane
from .flight import encounter, flight_from, proceed
from .ray_offsets import START, intersect, leaves_by_a_side
from .specimen import Specimen

__all__ = [
    "LARGEST_POWER",
    "RARE",
    "Exits",
    "PathSettings",
    "after_event",
    "emitted",
    "flux_context",
    "is_delta",
    "scatter_plane",
    "shading_normal_correction",
    "survival_chance",
    "trace",
    "whole_number",
]

# Weights and powers above these are no measurement of anything.
LARGEST_WEIGHT = 2.0**15
LARGEST_POWER = 2.0**30

# Two random numbers decide about chances below it, a multiple of their step.
RARE = 2.0**-12

# What single precision holds in full; below, only some threads of Dr.Jit keep anything.
SMALLEST_POWER = 2.0**-126


@dataclass(frozen=True)
class PathSettings:
    """How rays are followed: estimator and where paths end."""

    analog: bool
    max_depth: int
    rr_depth: int
    delta_only: bool = False  # on a plane: all else is integrated
    max_scatterings: int = 0  # inside of media
    roulette: bool = False  # inside of media: as `rr_depth` says, not by default


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
        :class:`Fate`; REFLECTED stands for having left in any direction after an event,
        DIRECT for having left without any.
    incident : mi.Spectrum
        Power that met the specimen.
    depth : mi.UInt32
        Surface events, the one among them that ended the ray.
    left, density : mi.Point3f, mi.Float
        Where the last of them was, and the density in 1/sr of the direction that it
        chose: infinite for delta components, and without any event. None for all
        estimators but `next_event`.
    """

    p: Any
    d: Any
    throughput: Any
    fate: Any
    incident: Any
    depth: Any
    left: Any = None
    density: Any = None


def flux_context() -> mi.BSDFContext:
    """Return the BSDF context of light that travels from emitter to collector."""
    return mi.BSDFContext(mi.TransportMode.Importance)


def scatter_plane(
    plane: Plane,
    beam: Beam,
    sampler: mi.Sampler,
    wavelengths: mi.Spectrum,
    settings: PathSettings,
) -> Exits:
    """Scatter every ray once where it lands on the plane; exact without ray tracing."""
    p, wi, _, weight = beam.sample(sampler, wavelengths)
    throughput = emitted(weight, sampler, settings.analog, beam.uniform)
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
    numbers = (sampler.next_1d(), sampler.next_1d()) if settings.analog else None
    exit_throughput, fate = after_event(throughput, bsdf_weight, bs, wo, numbers)
    if settings.delta_only:
        left = fate == mi.UInt32(Fate.REFLECTED)
        fate = dr.select(left & ~is_delta(bs), mi.UInt32(Fate.INTEGRATED), fate)
    fate = dr.select(inside, fate, mi.UInt32(Fate.MISSED))
    fate = dr.select(lit, fate, mi.UInt32(Fate.UNLIT))
    incident = dr.select(inside & lit, throughput, 0.0)
    depth = dr.select(inside & lit, mi.UInt32(1), 0)
    return Exits(p, wo, exit_throughput, fate, incident, depth)


@dr.syntax
def trace(
    specimen: Specimen,
    beam: Beam,
    sampler: mi.Sampler,
    wavelengths: mi.Spectrum,
    settings: PathSettings,
    deposits: Any = None,
) -> Exits:
    """Follow every ray through the geometry until it leaves, ends or is cut off.

    `deposits`, a :class:`~.next_event.Deposits`, is told of every event.
    """
    p, wi, distance, weight = beam.sample(sampler, wavelengths)
    β = emitted(weight, sampler, settings.analog, beam.uniform)

    # from just above the footprint, to which nothing stands in the way; grazing, that
    # may be above the next cell
    start = dr.minimum(distance, specimen.reach * START / dr.abs(wi.z))
    ray = mi.Ray3f(p + start * wi, -wi)
    ray.wavelengths = wavelengths
    flight = flight_from(specimen, ray)

    ctx = flux_context()
    flags = mi.RayFlags.All | mi.RayFlags.dNSdUV
    scene = specimen.scene
    analog = settings.analog
    max_depth = dr.opaque(mi.UInt32, settings.max_depth)
    rr_depth = dr.opaque(mi.UInt32, settings.rr_depth)

    lit = dr.any(β > 0)
    incident = mi.Spectrum(β)  # Power that met the specimen
    depth = mi.UInt32(0)  # Surface events so far
    # what passes a periodic cell without any event has passed the specimen
    passed = Fate.DIRECT if specimen.periodic else Fate.MISSED
    fate = dr.select(lit, mi.UInt32(passed), mi.UInt32(Fate.UNLIT))
    left = mi.Point3f(0)  # Where the last of them was
    density = mi.Float(dr.inf)  # Of the direction that it chose
    active = mi.Bool(lit)  # Still in flight?

    # to which of the faces at an edge a ray goes depends on it: all of a point may
    together = beam.footprint != "point"
    while active:
        ray = flight.ray
        si = intersect(scene, ray, flags, active, (depth == 0) & together)

        # ------------------- Rays that leave, or have had enough events ---------------
        met = encounter(specimen, beam.side, flight, si, active)
        fate[met.missed & (depth > 0)] = mi.UInt32(Fate.REFLECTED)
        fate[met.endless] = mi.UInt32(Fate.SIDEWAYS)
        active = mi.Bool(met.real)

        truncated = active & (depth >= max_depth)
        fate[truncated] = mi.UInt32(Fate.TRUNCATED)
        active &= ~truncated

        bsdf = si.bsdf(ray)
        if deposits is not None and deposits.scatters:
            sound = deposits.add(si, bsdf, ray, β, depth, flight.shift, sampler, active)
            fate[active & ~sound] = mi.UInt32(Fate.INVALID)
            active &= sound

        # ------------------------------- Scattering -----------------------------------
        bs, bsdf_weight = bsdf.sample(
            ctx, si, sampler.next_1d(active), sampler.next_2d(active), active
        )
        wo = si.to_world(bs.wo)
        bsdf_weight *= shading_normal_correction(si, ray, bs.wo, wo)
        # one number serves the roulette or, in its absence, the analog estimator
        number = sampler.next_1d() if analog else mi.Float(0)
        another = sampler.next_1d(active)
        numbers = (number, another) if analog else None
        event_β, event_fate = after_event(β, bsdf_weight, bs, wo, numbers)
        β[active] = event_β
        fate[active] = event_fate
        depth[active] += 1
        active &= event_fate == mi.UInt32(Fate.REFLECTED)
        if deposits is not None:
            left[active] = si.p + flight.shift
            density[active] = deposits.density(si, bsdf, bs, wo, active)

        # ---------------------------- Russian roulette --------------------------------
        survival = survival_chance(β, depth > rr_depth)
        survives = another < survival
        β[active] = dr.select(survives, β / survival, 0.0)
        fate[active & ~survives] = mi.UInt32(Fate.ABSORBED)
        active &= survives

        # ------------------------------- Next ray -------------------------------------
        proceed(specimen, flight, si, met, active, wo)
        active |= met.goes_on

    ray = flight.ray
    incident = dr.select(fate == mi.UInt32(Fate.MISSED), 0.0, incident)
    fate = dr.select(
        (fate == mi.UInt32(Fate.REFLECTED)) & leaves_by_a_side(specimen, ray.o, ray.d),
        mi.UInt32(Fate.SIDEWAYS),
        fate,
    )
    if deposits is None:
        left = density = None
    return Exits(ray.o + flight.shift, ray.d, β, fate, incident, depth, left, density)


def emitted(
    weight: mi.Spectrum, sampler: mi.Sampler, analog: bool, uniform: bool
) -> mi.Spectrum:
    """Power of a new ray; for the analog estimator a whole number of that mean."""
    if not analog or uniform:
        return mi.Spectrum(weight)
    return whole_number(weight, sampler.next_1d(), sampler.next_1d())


def after_event(
    throughput: mi.Spectrum,
    bsdf_weight: mi.Spectrum,
    bs: mi.BSDFSample3f,
    wo: mi.Vector3f,
    numbers: tuple[mi.Float, mi.Float] | None,
) -> tuple[mi.Spectrum, mi.UInt32]:
    """Throughput after a surface event, and its fate: REFLECTED means in flight.

    The analog estimator gives two random `numbers`, the others None.
    """
    largest, smallest = dr.max(bsdf_weight), dr.min(bsdf_weight)
    norm2 = dr.squared_norm(wo)
    zero = largest == 0
    # comparisons with NaN are false
    valid = (smallest >= 0) & (largest <= LARGEST_WEIGHT)
    valid &= zero | (dr.abs(norm2 - 1) < 1e-3)
    product = throughput * dr.select(valid, bsdf_weight, 0.0)
    valid &= dr.max(product) <= LARGEST_POWER
    throughput = product if numbers is None else whole_number(product, *numbers)
    left = dr.any(throughput >= SMALLEST_POWER)
    fate = dr.select(left, mi.UInt32(Fate.REFLECTED), mi.UInt32(Fate.ABSORBED))
    fate = dr.select(zero & ~(bs.pdf > 0), mi.UInt32(Fate.REJECTED), fate)
    return throughput, dr.select(valid, fate, mi.UInt32(Fate.INVALID))


def survival_chance(β: mi.Spectrum, due: mi.Bool, most: float = 0.95) -> mi.Float:
    """Chance to survive Russian roulette, where it is `due`; 1 elsewhere.

    In steps that random numbers of 23 bits hit exactly, and never 0.
    """
    chance = dr.ceil(dr.minimum(dr.max(β), most) * 2.0**16) * 2.0**-16
    return dr.select(due, chance, mi.Float(1.0))


def whole_number(x: mi.Spectrum, u: mi.Float, v: mi.Float) -> mi.Spectrum:
    """Random whole number with mean `x`, from two numbers in [0, 1) for all channels.

    A weight that exceeds a whole number by rounding alone counts as that number. Random
    numbers are multiples of 2^-23 or 2^-24, too coarse for a small chance: `v` decides
    about what is left of it where `u` is below `RARE`.
    """
    floor = dr.floor(x)
    rest = x - floor
    chosen = dr.select(rest < RARE, (u < RARE) & (v < rest / RARE), u < rest)
    above = chosen & ((x < 1) | (rest > x * FEW_ROUNDINGS))
    # of that type: a loop's variable does not change its own
    return mi.Spectrum(floor + dr.select(above, 1.0, 0.0))


def shading_normal_correction(
    si: mi.SurfaceInteraction3f, ray: mi.Ray3f, local_wo: mi.Vector3f, wo: mi.Vector3f
) -> mi.Float:
    """Adjoint correction for interpolated normals (Veach 1997, eq. 5.19); 1 for others.

    `wo` is given in the frame of shading and in the world. 0 where both normals
    disagree about the side: light would leak.
    """
    wi_n, wo_n = dr.dot(si.n, -ray.d), dr.dot(si.n, wo)
    wi_s, wo_s = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(local_wo)
    agree = (wi_n * wi_s > 0) & (wo_n * wo_s > 0)
    flat = dr.all(si.sh_frame.n == si.n)
    corrected = dr.select(agree, dr.abs(wi_s * wo_n / (wo_s * wi_n)), 0.0)
    return dr.select(flat, mi.Float(1.0), corrected)


def is_delta(bs: mi.BSDFSample3f) -> mi.Bool:
    """Whether a sampled component has no density."""
    delta, line = mi.BSDFFlags.Delta, mi.BSDFFlags.Delta1D
    return mi.has_flag(bs.sampled_type, delta) | mi.has_flag(bs.sampled_type, line)

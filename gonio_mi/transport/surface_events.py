"""One event of light at a surface, its power before and after, and its survival.

Flux travels from emitter to collector, so BSDFs are used in importance mode, in which a
transmitted weight is not divided by eta^2 (Veach 1997, section 5.2).
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..results.tally import Fate
from ..single_precision import FEW_ROUNDINGS
from . import polarisation

# Weights and powers above these are no measurement of anything.
MAX_WEIGHT = 2.0**15
MAX_POWER = 2.0**30

# Two random numbers decide about chances below it, a multiple of their step.
RARE = 2.0**-12

# What single precision holds in full; below, only some threads of Dr.Jit keep anything.
MIN_POWER = 2.0**-126


def flux_context() -> mi.BSDFContext:
    """Return the BSDF context of light that travels from emitter to collector."""
    return mi.BSDFContext(mi.TransportMode.Importance)


def emitted(
    weight: mi.UnpolarizedSpectrum, sampler: mi.Sampler, analog: bool, uniform: bool
) -> mi.UnpolarizedSpectrum:
    """Power of a new ray; for the analog estimator a whole number of that mean."""
    if not analog or uniform:
        return mi.UnpolarizedSpectrum(weight)
    return whole_number(weight, sampler.next_1d(), sampler.next_1d())


def scattered(
    bsdf: mi.BSDFPtr,
    si: mi.SurfaceInteraction3f,
    ray: mi.Ray3f,
    u1: mi.Float,
    u2: mi.Point2f,
    active: mi.Bool,
) -> tuple[mi.BSDFSample3f, mi.Spectrum, mi.Vector3f]:
    """What a surface samples, its weight for flux, and the direction in the world."""
    bs, weight = bsdf.sample(flux_context(), si, u1, u2, active)
    wo = si.to_world(bs.wo)
    weight = polarisation.in_instrument_frames(si, weight, ray.d, bs.wo, wo)
    return bs, weight * shading_normal_correction(si, ray, bs.wo, wo), wo


def survival_numbers(
    sampler: mi.Sampler, analog: bool, active: mi.Bool
) -> tuple[mi.Float, tuple[mi.Float, mi.Float] | None]:
    """Number of the roulette, and the two of the analog estimator, else None.

    One serves the roulette or, in its absence, the analog estimator.
    """
    number = sampler.next_1d() if analog else mi.Float(0)
    another = sampler.next_1d(active)
    return another, (number, another) if analog else None


def after_event(
    throughput: mi.Spectrum,
    bsdf_weight: mi.Spectrum,
    bs: mi.BSDFSample3f,
    wo: mi.Vector3f,
    numbers: tuple[mi.Float, mi.Float] | None,
) -> tuple[mi.Spectrum, mi.UInt32]:
    """Throughput after a surface event, and its fate: REFLECTED means in flight.

    The analog estimator gives two random `numbers`, the others None. Weights of
    polarised variants are given in frames of s = k x z.
    """
    light = polarisation.power_of(bsdf_weight)
    largest, smallest = dr.max(light), dr.min(light)
    norm2 = dr.squared_norm(wo)
    zero = largest == 0
    # comparisons with NaN are false
    valid = (smallest >= 0) & (largest <= MAX_WEIGHT)
    valid &= zero | (dr.abs(norm2 - 1) < 1e-3)
    weight = dr.select(valid, bsdf_weight, 0.0)
    product, realisable = polarisation.product(weight, throughput)
    power = polarisation.power_of(product)
    valid &= realisable
    valid &= dr.max(power) <= MAX_POWER
    if numbers is not None:
        power = whole_number(power, *numbers)
        product = polarisation.scaled(product, power)
    left = dr.any(power >= MIN_POWER)
    fate = dr.select(left, mi.UInt32(Fate.REFLECTED), mi.UInt32(Fate.ABSORBED))
    fate = dr.select(zero & ~(bs.pdf > 0), mi.UInt32(Fate.REJECTED), fate)
    return product, dr.select(valid, fate, mi.UInt32(Fate.INVALID))


def survival_chance(β: mi.Spectrum, due: mi.Bool, most: float = 0.95) -> mi.Float:
    """Chance to survive Russian roulette, where it is `due`; 1 elsewhere.

    In steps that random numbers of 23 bits hit exactly, and never 0.
    """
    power = dr.max(polarisation.power_of(β))
    chance = dr.ceil(dr.minimum(power, most) * 2.0**16) * 2.0**-16
    return dr.select(due, chance, mi.Float(1.0))


def whole_number(
    x: mi.UnpolarizedSpectrum, u: mi.Float, v: mi.Float
) -> mi.UnpolarizedSpectrum:
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
    return mi.UnpolarizedSpectrum(floor + dr.select(above, 1.0, 0.0))


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

"""Free flight through media: to the next scattering, or to the next surface.

Delta tracking (Woodcock et al. 1965) for media that vary, and of channels that differ
the balance heuristic over which of them chose the path (Wilkie et al. 2014, *Hero
Wavelength Spectral Sampling*; Miller et al. 2019, *A Null-Scattering Path Integral
Formulation of Light Transport*).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log
from typing import Any

import drjit as dr
import mitsuba as mi

__all__ = ["Step", "free_flight", "of_channel"]

# Where random numbers, multiples of 2^-24, become too coarse for a small chance to get
# far: a flight of so many mean free paths is interrupted, and goes on with a new number
# as if nothing had been. That is exact, since flights have no memory.
RARE = 2.0**-12
LONGEST = -log(RARE)


@dataclass
class Step:
    """What becomes of each ray in its medium.

    Attributes
    ----------
    at : mi.MediumInteraction3f
        Where it scatters, or is interrupted.
    scatters, waits : mi.Bool
        Scatters there; or goes on from there as it is. Neither: it gets to the surface.
    power, chance : mi.Spectrum
        Factors by which the light of each channel, and the probability of the path had
        that channel chosen it, change over those by which the hero's probability does.
    """

    at: Any
    scatters: Any
    waits: Any
    power: Any
    chance: Any


def of_channel(spectrum: mi.Spectrum, channel: mi.UInt32) -> mi.Float:
    """Value of one channel, another one in each lane."""
    value = spectrum[0]
    for i in range(1, len(spectrum)):
        value = dr.select(channel == i, spectrum[i], value)
    return value


def free_flight(
    medium: mi.MediumPtr,
    ray: mi.Ray3f,
    distance: mi.Float,
    hero: mi.UInt32,
    u: mi.Float,
    v: mi.Float,
    homogeneous: bool,
    apart: bool,
    active: mi.Bool,
) -> Step:
    """Step of rays through their medium.

    Parameters
    ----------
    medium : mi.MediumPtr
    ray : mi.Ray3f
    distance : mi.Float
        To the next surface.
    hero : mi.UInt32
        Channel whose coefficients choose how far light gets.
    u, v : mi.Float
        Random numbers in [0, 1): for the distance, and, unless all media are
        `homogeneous`, for whether it is a scattering.
    homogeneous : bool
    apart : bool
        Whether channels differ in how far light gets.
    active : mi.Bool
    """
    at = dr.zeros(mi.MediumInteraction3f)
    at.wi = -ray.d
    at.sh_frame = mi.Frame3f(at.wi)
    at.time, at.wavelengths, at.medium = ray.time, ray.wavelengths, medium
    begin, end, flies = mi.Float(0), distance, active
    if not homogeneous:
        meets, near, far = medium.intersect_aabb(ray)
        # a homogeneous medium has no box
        begin = dr.select(meets, dr.clip(near, 0, distance), distance)
        end = dr.select(meets, dr.clip(far, begin, distance), distance)
        flies = active & meets
    majorants = medium.get_majorant(at, active)
    majorant = of_channel(majorants, hero)
    paths = dr.select(u < 1 - RARE, -dr.log(1 - u), LONGEST)
    t = dr.select(majorant > 0, begin + paths / majorant, dr.inf)
    stops = flies & (t < end)
    at.t = dr.select(stops, t, dr.inf)
    at.p = ray(dr.select(stops, t, 0.0))
    at.mint = begin
    at.combined_extinction = majorants
    at.sigma_s, at.sigma_n, at.sigma_t = medium.get_scattering_coefficients(at, stops)
    extinction = of_channel(at.sigma_t, hero)
    real = stops & (u < 1 - RARE)
    scatters = real
    if not homogeneous:
        scatters &= v * majorant < extinction
    waits = stops & ~scatters

    null = real & waits
    chosen = dr.select(scatters, extinction, 1.0)
    chance = dr.select(scatters, at.sigma_t, 1.0)
    if apart:
        chosen = dr.select(null, of_channel(at.sigma_n, hero), chosen)
        chance = dr.select(null, at.sigma_n, chance)
        length = dr.select(active, dr.minimum(t, end) - begin, 0.0)
        passed = dr.exp((majorant - majorants) * length)
        power = dr.select(scatters, at.sigma_s, chance) / chosen * passed
        return Step(at, scatters, waits, power, chance / chosen * passed)
    power = dr.select(scatters, at.sigma_s, 1.0) / chosen
    return Step(at, scatters, waits, power, mi.Spectrum(1.0))

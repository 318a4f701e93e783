"""From a beam to exits: one scattering event on a plane, or a loop through geometry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..loops import syntax
from ..mitsuba_compat import PARTIALS
from ..results.tally import Fate
from ..specimen.plane import Plane, repeated
from ..specimen.rays import START, encounter, flight_from, nearest, proceed
from ..specimen.specimen import Specimen
from .beam import Beam
from .exits import Exits, exits_of
from .polarisation import in_instrument_frames, new_light
from .surface_events import (
    after_event,
    emitted,
    flux_context,
    is_delta,
    scattered,
    survival_chance,
    survival_numbers,
)


@dataclass(frozen=True)
class PathSettings:
    """How rays are followed: estimator and where paths end."""

    analog: bool
    max_depth: int
    rr_depth: int
    delta_only: bool = False  # on a plane: all else is integrated
    max_scatterings: int = 0  # inside of media
    roulette: bool = False  # as `rr_depth` says; without, media have one of their own
    derivative: Any = None  # by the parameter that is attached


def scatter_plane(
    plane: Plane,
    beam: Beam,
    sampler: mi.Sampler,
    wavelengths: mi.Spectrum,
    settings: PathSettings,
) -> Exits:
    """Scatter every ray once where it lands on the plane; exact without ray tracing."""
    p, wi, _, _, weight = beam.sample(sampler, wavelengths)
    power = emitted(weight, sampler, settings.analog, beam.uniform)
    lit = dr.any(power > 0)
    if beam.footprint == "point":
        uv, inside = mi.Point2f(0.5), mi.Bool(True)
    else:
        uv = plane.uv(p)
        inside = (
            mi.Bool(True) if beam.footprint == "full" else dr.all((uv >= 0) & (uv <= 1))
        )
    si = plane.interactions(uv, wi, wavelengths)
    u1, u2 = sampler.next_1d(), sampler.next_2d()
    if plane.by_ray:
        si = repeated(si, dr.width(u1))
    bs, bsdf_weight = plane.bsdf.sample(flux_context(), si, u1, u2, lit & inside)
    wo = si.to_world(bs.wo)
    numbers = (sampler.next_1d(), sampler.next_1d()) if settings.analog else None
    bsdf_weight = in_instrument_frames(si, bsdf_weight, -wi, bs.wo, wo)
    throughput, fate = after_event(new_light(power), bsdf_weight, bs, wo, numbers)
    if settings.delta_only:
        left = fate == mi.UInt32(Fate.REFLECTED)
        fate = dr.select(left & ~is_delta(bs), mi.UInt32(Fate.INTEGRATED), fate)
    fate = dr.select(inside, fate, mi.UInt32(Fate.MISSED))
    fate = dr.select(lit, fate, mi.UInt32(Fate.UNLIT))
    incident = dr.select(inside & lit, power, 0.0)
    depth = dr.select(inside & lit, mi.UInt32(1), 0)
    exits = Exits(p, wo, throughput, fate, incident, depth)
    if settings.derivative is not None:
        sampled, active = (bs, bsdf_weight), lit & inside
        slope = settings.derivative.of_event(plane.bsdf, si, u1, u2, sampled, active)
        exits.change = throughput * slope
    return exits


@syntax
def trace(
    specimen: Specimen,
    beam: Beam,
    sampler: mi.Sampler,
    wavelengths: mi.Spectrum,
    settings: PathSettings,
    deposits: Any = None,
    begun: Any = None,
) -> Exits:
    """Follow every ray through the geometry until it leaves, ends or is cut off.

    `deposits`, of the estimator `next_event`, is told of every event. Rays that were
    `begun` have one event behind them; their power is beside their flight.
    """
    if dr.hint(begun is None, mode="scalar"):
        ray, power = sent(specimen, beam, sampler, wavelengths, settings.analog)
        flight = flight_from(specimen, ray)
    else:
        flight, power = begun
    β = new_light(power)
    analog, roulette = settings.analog, settings.roulette
    max_depth = dr.opaque(mi.UInt32, settings.max_depth)
    rr_depth = dr.opaque(mi.UInt32, settings.rr_depth)

    lit = dr.any(power > 0)
    incident = mi.UnpolarizedSpectrum(power)  # Power that met the specimen
    depth = mi.UInt32(0 if begun is None else 1)  # Surface events so far
    # what passes a periodic cell without any event has passed the specimen
    passed = Fate.DIRECT if specimen.periodic else Fate.MISSED
    fate = dr.select(lit, mi.UInt32(passed), mi.UInt32(Fate.UNLIT))
    left = mi.Point3f(0)  # Where the last of them was
    density = mi.Float(dr.inf)  # Of the direction that it chose
    active = mi.Bool(lit)  # Still in flight?
    derivative = settings.derivative
    slope = None if derivative is None else mi.Spectrum(0)  # logarithmic derivative

    # to which of the faces at an edge a ray goes depends on its packet: all of a point
    # may, and packets must be the same however rays are shared among launches
    together = beam.footprint != "point"
    facets = None if deposits is None else deposits.facets
    if facets is not None and not facets.once:
        deposits.subtract_facets(flight.ray, active)
    while active:
        ray = flight.ray
        si = nearest(specimen, ray, PARTIALS, active, (depth == 0) & together)

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
            told = si, bsdf, flight, β, depth, sampler, active
            sound = deposits.add(*told, slope)
            fate[active & ~sound] = mi.UInt32(Fate.INVALID)
            active &= sound
        if facets is not None and facets.once:
            deposits.take_facet_off(si.prim_index, active & (depth == 0))

        # ------------------------------- Scattering -----------------------------------
        u1, u2 = sampler.next_1d(active), sampler.next_2d(active)
        bs, bsdf_weight, wo = scattered(bsdf, si, ray, u1, u2, active)
        if derivative is not None:
            sampled = bs, bsdf_weight
            slope += derivative.of_event(bsdf, si, u1, u2, sampled, active)
        another, numbers = survival_numbers(sampler, analog, active)
        event_β, event_fate = after_event(β, bsdf_weight, bs, wo, numbers)
        β[active] = event_β
        fate[active] = event_fate
        depth[active] += 1
        active &= event_fate == mi.UInt32(Fate.REFLECTED)
        if deposits is not None and deposits.scatters:
            left[active] = si.p + flight.shift
            density[active] = deposits.density(si, bsdf, bs, wo, active)

        # ---------------------------- Russian roulette --------------------------------
        if roulette:
            survival = survival_chance(β, depth > rr_depth)
            survives = another < survival
            β[active] = dr.select(survives, β / survival, 0.0)
            fate[active & ~survives] = mi.UInt32(Fate.ABSORBED)
            active &= survives

        # ------------------------------- Next ray -------------------------------------
        proceed(specimen, flight, si, met, active, wo)
        active |= met.goes_on

    exits = exits_of(specimen, flight, β, fate, incident, depth)
    if derivative is not None:
        exits.change = β * slope
    if deposits is not None:
        exits.left, exits.density = left, density
    return exits


def sent(
    specimen: Specimen,
    beam: Beam,
    sampler: mi.Sampler,
    wavelengths: mi.Spectrum,
    counted: bool,
) -> tuple[mi.Ray3f, mi.UnpolarizedSpectrum]:
    """New rays and their power.

    They start just above the footprint, to which nothing stands in the way; grazing,
    that may be above the next cell.
    """
    p, wi, cosine, distance, weight = beam.sample(sampler, wavelengths)
    β = emitted(weight, sampler, counted, beam.uniform)
    start = dr.minimum(distance, specimen.box.reach * START / cosine)
    ray = mi.Ray3f(p + start * wi, -wi)
    ray.wavelengths = wavelengths
    return ray, β

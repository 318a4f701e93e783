"""The loop through media: light that scatters inside of shapes, and at their surfaces.

A specimen without a medium never gets here. The loop is the same for geometry, which is
traced, and for infinite layers, which need no intersection.

Free flight is delta tracking (Woodcock et al. 1965) for media that vary, and of
channels that differ the balance heuristic over which of them chose the path (Wilkie et
al. 2014, *Hero Wavelength Spectral Sampling*; Miller et al. 2019, *A Null-Scattering
Path Integral Formulation of Light Transport*).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log
from typing import Any

import drjit as dr
import mitsuba as mi

from ..loops import syntax
from ..mitsuba_compat import PARTIALS
from ..results.tally import Fate
from ..specimen.media import differ_by_channel
from ..specimen.rays import (
    Encounter,
    Flight,
    encounter,
    flight_from,
    nearest,
    proceed,
)
from ..specimen.specimen import Specimen
from .beam import Beam
from .exits import exits_of
from .layers import Layers
from .surface_events import (
    after_event,
    scattered,
    survival_chance,
    survival_numbers,
    whole_number,
)
from .surface_loop import PathSettings, sent

# Where random numbers, multiples of 2^-24, become too coarse for a small chance to get
# far: a flight of so many mean free paths is interrupted, and goes on with a new number
# as if nothing had been. That is exact, since flights have no memory.
RARE = 2.0**-12
MAX_PATHS = -log(RARE)


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
    numbers: tuple[mi.Float, mi.Float | None],
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
    numbers : (mi.Float, mi.Float or None)
        Random numbers in [0, 1): for the distance, and for whether it is a scattering,
        which in homogeneous media it always is; None if all are.
    apart : bool
        Whether channels differ in how far light gets.
    active : mi.Bool
    """
    u, v = numbers
    at = dr.zeros(mi.MediumInteraction3f)
    at.wi = -ray.d
    at.sh_frame = mi.Frame3f(at.wi)
    at.time, at.wavelengths, at.medium = ray.time, ray.wavelengths, medium
    begin, end, flies = mi.Float(0), distance, active
    if v is not None:
        meets, near, far = medium.intersect_aabb(ray)
        # a homogeneous medium has no box
        begin = dr.select(meets, dr.clip(near, 0, distance), distance)
        end = dr.select(meets, dr.clip(far, begin, distance), distance)
        flies = active & meets
    majorants = medium.get_majorant(at, active)
    majorant = of_channel(majorants, hero)
    paths = dr.select(u < 1 - RARE, -dr.log(1 - u), MAX_PATHS)
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
    if v is not None:
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


# How far from a surface light scatters at least, in units of the local coordinates: 16
# ulp, so that no rounding finds it on the other side.
MIN_DEPTH = 2.0**-20

# Power below which one of four rays goes on, with four times as much: by default a
# path inside of a medium ends.
FAINT_POWER, FAINT_SURVIVAL = 2.0**-4, 2.0**-2


class Geometry:
    """Shapes that are traced: where rays start, what they meet, how they go on.

    Parameters
    ----------
    specimen : Specimen
    side : int
        Of the emitter: 1 above, -1 below.
    """

    def __init__(self, specimen: Specimen, side: int) -> None:
        self.specimen, self.side = specimen, side

    def start(self, ray: mi.Ray3f) -> Flight:
        """Flight of new rays."""
        return flight_from(self.specimen, ray)

    def meet(
        self, flight: Flight, active: mi.Bool, inside: mi.Bool
    ) -> tuple[mi.SurfaceInteraction3f, Encounter, mi.Float]:
        """What rays meet next, and at what distance; nothing is infinitely far.

        `inside`: whether they are in a medium. In a relay no two rays share packets for
        long: each is looked for by itself.
        """
        ray = flight.ray
        si = nearest(self.specimen, ray, PARTIALS, active)
        met = encounter(self.specimen, self.side, flight, si, active)
        across = mi.Vector2f(ray.d.x, ray.d.y)
        path = met.entry + met.step - ray.o
        to_side = dr.dot(mi.Vector2f(path.x, path.y), across) / dr.squared_norm(across)
        # not lifted as in air: the end of the medium may be as near as that
        met.entry.z[inside] = ray.o.z + to_side * ray.d.z
        distance = dr.select(met.missed, dr.inf, si.t)
        distance = dr.select(met.crosses, dr.maximum(to_side, 0), distance)
        return si, met, distance

    def proceed(
        self,
        flight: Flight,
        si: mi.SurfaceInteraction3f,
        met: Encounter,
        scattered: mi.Bool,
        wo: mi.Vector3f,
    ) -> None:
        """Start the next rays, of those that a surface scattered and that go on."""
        proceed(self.specimen, flight, si, met, scattered, wo)

    def place(
        self,
        flight: Flight,
        si: mi.SurfaceInteraction3f,
        t: mi.Float,
        distance: mi.Float,
        active: mi.Bool,
        wo: mi.Vector3f,
    ) -> None:
        """Start the next rays of those that go on from inside of a medium, after `t`.

        `distance`: to the surface ahead, which they have not reached.
        """
        ray, detail = flight.ray, self.specimen.box.detail
        near = MIN_DEPTH * (detail + dr.dot(dr.abs(flight.n), dr.abs(ray.o)))
        near = near / dr.abs(dr.dot(flight.n, ray.d))
        far = MIN_DEPTH * (detail + dr.dot(dr.abs(si.n), dr.abs(si.p)))
        far = distance - far / dr.abs(dr.dot(si.n, ray.d))
        left = dr.any(flight.n != 0)  # a surface, just before
        t = dr.select(left, dr.maximum(t, near), t)
        t = dr.select(si.is_valid(), dr.minimum(t, far), t)
        t = dr.select((t > 0) & (t < distance), t, distance / 2)
        ray.o[active] = ray(dr.select(active, t, 0.0))
        ray.d[active] = wo
        flight.n[active] = mi.Normal3f(0)
        flight.offset[active] = 0.0
        flight.again[active] = mi.Bool(False)
        flight.cells[active] = mi.UInt32(0)


@syntax
def trace_inside(
    specimen: Specimen,
    path: Geometry | Layers,
    beam: Beam,
    sampler: mi.Sampler,
    wavelengths: mi.Spectrum,
    settings: PathSettings,
    relay: Any,
) -> None:
    """Follow every ray through surfaces and media until it leaves, ends or is cut off.

    A lane whose ray has ended takes the next one from the `relay`, a
    :class:`~.sampling.Relay`, and gives it the exits of the last one. Their `depth`
    counts scatterings inside of media.
    """
    apart = differ_by_channel(specimen.media, wavelengths)
    homogeneous = all(medium.is_homogeneous() for medium in specimen.media)
    # whole numbers of rays, unless channels share them: then in the end
    counted = settings.analog
    analog, roulette = counted and not apart, settings.roulette
    n = len(mi.Spectrum())
    passed = Fate.DIRECT if specimen.periodic else Fate.MISSED
    ctx = mi.PhaseFunctionContext(None, mi.TransportMode.Importance)

    max_depth = dr.opaque(mi.UInt32, settings.max_depth)
    max_scatterings = dr.opaque(mi.UInt32, settings.max_scatterings)
    rr_depth = dr.opaque(mi.UInt32, settings.rr_depth)

    coming = relay.first()  # Number of the ray that each lane sends next
    which = mi.UInt32(coming)  # Of the one that it follows
    hero = mi.UInt32(0)  # Channel whose free path it takes
    β = mi.Spectrum(0)  # Power left
    incident = mi.Spectrum(0)  # Power that met the specimen
    chance = mi.Spectrum(1)  # Probability of the path by channel, over the hero's
    depth = mi.UInt32(0)  # Surface events so far
    scatterings = mi.UInt32(0)  # Events inside of media so far
    touched = mi.Bool(False)  # Any of them but the passing of a null boundary?
    medium = dr.zeros(mi.MediumPtr)  # Around the ray; none is air
    fate = mi.UInt32(Fate.UNLIT)
    flight: Any = path.start(dr.zeros(mi.Ray3f))
    active = mi.Bool(False)  # Still in flight?

    while active | relay.has(coming):
        # -------------------------------- New rays ------------------------------------
        if ~active:
            which = mi.UInt32(coming)
            coming = relay.begin(sampler, which)
            ray, β = sent(specimen, beam, sampler, wavelengths, counted)
            hero = mi.UInt32(sampler.next_1d() * n) if apart else mi.UInt32(0)
            flight = path.start(ray)
            active = dr.any(β > 0)
            incident = mi.Spectrum(β)
            chance = mi.Spectrum(1)
            depth, scatterings = mi.UInt32(0), mi.UInt32(0)
            touched = mi.Bool(False)
            medium = dr.zeros(mi.MediumPtr)
            fate = dr.select(active, mi.UInt32(passed), mi.UInt32(Fate.UNLIT))

        ray = flight.ray
        inside = active & (medium != None)  # noqa: E711 (each lane)
        si, met, free = path.meet(flight, active, inside)

        # ---------------- Rays that leave, or are where no medium should be -----------
        gone = met.missed & ~met.crosses
        changes = met.real & si.is_medium_transition()
        astray = (gone & inside & ~met.endless) | (
            changes & (si.target_medium(-ray.d) != medium)
        )
        known = touched if specimen.periodic else depth > 0
        fate[gone & known] = mi.UInt32(Fate.REFLECTED)
        fate[met.endless] = mi.UInt32(Fate.SIDEWAYS)
        fate[astray] = mi.UInt32(Fate.ASTRAY)
        active &= ~gone & ~astray

        # ------------------------------ Free flight -----------------------------------
        inside &= active
        u = sampler.next_1d(inside)
        v = None if homogeneous else sampler.next_1d(inside)
        step = free_flight(medium, ray, free, hero, (u, v), apart, inside)
        met = met.unless(step.scatters | step.waits | astray)
        at_surface = met.real
        truncated = at_surface & (depth >= max_depth)
        truncated |= step.scatters & (scatterings >= max_scatterings)
        fate[truncated] = mi.UInt32(Fate.TRUNCATED)
        at_surface &= ~truncated
        in_medium = step.scatters & ~truncated
        event = at_surface | in_medium
        if apart:
            β[inside] = β * step.power
            chance[inside] = chance * step.chance

        # ------------------------------- Scattering -----------------------------------
        u1, u2 = sampler.next_1d(event), sampler.next_2d(event)
        bs, event_weight, wo = scattered(si.bsdf(ray), si, ray, u1, u2, at_surface)
        phase_wo, phase_weight, pdf = medium.phase_function().sample(
            ctx, step.at, u1, u2, in_medium
        )
        phase_weight *= mi.Spectrum(1) if apart else step.power
        wo = dr.select(in_medium, phase_wo, wo)
        event_weight = dr.select(in_medium, phase_weight, event_weight)
        bs.pdf = dr.select(in_medium, pdf, bs.pdf)
        another, numbers = survival_numbers(sampler, analog, event)
        event_β, event_fate = after_event(β, event_weight, bs, wo, numbers)
        β[event] = event_β
        ended = event_fate == mi.UInt32(Fate.ABSORBED)
        event_fate[ended & in_medium] = mi.UInt32(Fate.ABSORBED_INSIDE)
        survived = event_fate == mi.UInt32(Fate.REFLECTED)
        fate[event & ~survived] = event_fate
        scatterings[in_medium] += 1
        at_surface &= survived
        in_medium &= survived
        depth[at_surface] += 1
        through = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null)
        touched |= in_medium | (at_surface & ~through)
        medium[at_surface & changes] = si.target_medium(wo)

        # ---------------------------- Russian roulette --------------------------------
        power = β / _mean(chance) if apart else β
        due = depth + scatterings > rr_depth if roulette else mi.Bool(not analog)
        # of thousands of events none may end a ray that has lost nothing
        chosen = survival_chance(power, due, 1.0) if roulette else _faint(power, due)
        event = at_surface | in_medium
        survives = another < chosen
        β[event] = dr.select(survives, β / chosen, 0.0)
        killed = event & ~survives
        fate[killed & at_surface] = mi.UInt32(Fate.ABSORBED)
        fate[killed & in_medium] = mi.UInt32(Fate.ABSORBED_INSIDE)
        at_surface &= survives
        in_medium &= survives

        # ------------------------------- Next ray -------------------------------------
        goes_on = met.goes_on
        onward = dr.select(step.waits, ray.d, wo)
        stays = step.waits | in_medium
        path.place(flight, si, step.at.t, free, stays, onward)
        path.proceed(flight, si, met, at_surface, wo)
        active = at_surface | stays | goes_on

        # ---------------------------- Rays that have ended ----------------------------
        if ~active:
            left = mi.Spectrum(β)
            if dr.hint(apart, mode="scalar"):
                left /= _mean(chance)
            if dr.hint(apart and counted, mode="scalar"):
                left = whole_number(left, sampler.next_1d(), sampler.next_1d())
            none = (fate == mi.UInt32(Fate.REFLECTED)) & ~dr.any(left > 0)
            last = dr.select(none, mi.UInt32(Fate.ABSORBED_INSIDE), fate)
            relay.arrive(
                which, exits_of(specimen, flight, left, last, incident, scatterings)
            )


def _faint(power: mi.Spectrum, due: mi.Bool) -> mi.Float:
    """Chance of faint rays to survive where it is `due`, without Russian roulette."""
    faint = due & (dr.max(power) < FAINT_POWER)
    return dr.select(faint, mi.Float(FAINT_SURVIVAL), mi.Float(1))


def _mean(spectrum: mi.Spectrum) -> mi.Float:
    """Mean over the channels, the same to the bit however many lanes there are.

    The mean of Dr.Jit 1.5 rounds by their number, which it makes part of the kernel.
    """
    return dr.sum(spectrum) / len(spectrum)

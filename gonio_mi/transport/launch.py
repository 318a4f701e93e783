"""One launch: a kernel that sends the rays of some batches, and their totals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi

from ..results.provenance import FACETS
from ..results.tally import Fate
from ..settings.measurement_settings import BRANCHES
from ..settings.values import UNLIMITED
from .beam import Beam
from .exits import Exits, of_order
from .kernels import check_variant_kept
from .media_loop import Geometry, trace_inside
from .mirror_facets import MirrorFacets, has_mirror_facets
from .next_event import Deposits
from .rays import Flight
from .sampling import Relay, apart, continues, in_turns, rays_per_lane, seeded, turns_of
from .setup import Setup
from .sums import Sums, Totals
from .surface_loop import PathSettings, scatter_plane, trace

# Tells the random numbers of the branches of a ray from its own.
BRANCHED = 0x62726E63


@dataclass(frozen=True, eq=False)
class Launch:
    """Rays of several batches that one kernel sends.

    Attributes
    ----------
    setup : Setup
    beams : tuple of Beam
        Of the incident directions that share the launch, or none if there is one:
        batch `i` has number ``i % len(beams)``. All else of their setups is that of
        `setup`.
    wavelengths : mi.Spectrum or mi.Color0f
        Of the rays.
    capacity : int
        Batches that there is room for: the same for all launches at a setup.
    keys : tuple of tuple of int
        Each tells a batch from all others.
    sizes : tuple of int
        Rays of each batch, in descending order and alike within one ray.
    begin : int
        Rays of each batch that were sent before.
    stretch : (int, int), optional
        Along the curve that all batches of a direction walk together: only rays from
        there.
    facets : MirrorFacets, optional
        Of the setup, where their first order is known.
    """

    setup: Setup
    beams: tuple[Beam, ...]
    wavelengths: Any
    capacity: int
    keys: tuple[tuple[int, ...], ...]
    sizes: tuple[int, ...]
    begin: int = 0
    stretch: tuple[int, int] | None = None
    facets: MirrorFacets | None = None

    @property
    def rays(self) -> int:
        """Rays in all, or points of the curve."""
        if self.stretch is None:
            return sum(self.sizes)
        first, end = self.stretch
        return self.n_directions * (end - first)

    @property
    def n_directions(self) -> int:
        """Incident directions."""
        return len(self.beams) or 1


def launch(one: Launch) -> Totals:
    """Send rays of several batches in one kernel; totals of as many batches."""
    setup, sizes = one.setup, one.sizes
    traced = traces(setup)
    inside = bool(setup.specimen.media)
    turns = 1 if traced else turns_of(setup.sampler, sizes[0])
    if inside and continues(setup.sampler):
        turns = rays_per_lane(setup.sampler, sizes[0])
    lanes = -(-sizes[0] // turns)
    if traced and len(sizes) * lanes == 1:
        lanes = 2  # in a single one Dr.Jit 1.5 takes a loop's variables for constants
    while True:
        sums = Sums(setup, one.capacity, one.facets)
        sampler = seeded(setup.sampler, one.keys, one.begin, lanes)
        if one.stretch is not None:
            batch, ray = sampler.follow_curve(*one.stretch, one.n_directions)
        else:
            # as many lanes as rays, even where none of them draws a number
            lane = dr.arange(mi.UInt32, len(sizes) * lanes)
            alone = one.capacity == 1
            batch, ray = (mi.UInt32(0), lane) if alone else apart(lane, lanes)
        # the last batches may be shorter by one ray
        full = dr.opaque(mi.UInt32, sizes.count(sizes[0]))
        size = dr.opaque(mi.UInt32, sizes[0]) - dr.select(batch < full, mi.UInt32(0), 1)
        rays = _Rays(one, sums, batch, size)
        if inside:
            rays.relay(sampler, ray, sizes[0])
        elif turns > 1:
            in_turns(rays.add, sampler, ray, lanes, turns)
        else:
            rays.add(sampler, ray)
        sums.evaluate()
        check_variant_kept()
        if not sums.lacking:
            break
        # fainter or brighter light than there was room for: once more, with room for it
        setup.levels = sums.lacking
    return sums.totals(len(sizes))


def traces(setup: Setup) -> bool:
    """Whether rays are traced: for geometry, or where that is asked for."""
    return setup.settings.trace or setup.specimen.plane is None


def transport_of(setup: Setup) -> str:
    """How rays are followed: on a ``plane``, through ``layers``, or ``traced``.

    Or traced for what the first order of mirror ``facets`` leaves open.
    """
    if not traces(setup):
        return "plane"
    if has_mirror_facets(setup):
        return FACETS
    return "traced" if setup.settings.trace or setup.layers is None else "layers"


class _Rays:
    """The rays of a launch, one after the other in each lane.

    No closure: the traceback of an error would keep what it closes over alive.
    """

    def __init__(
        self, one: Launch, sums: Sums, batch: mi.UInt32, size: mi.UInt32
    ) -> None:
        self.setup, self.wavelengths = one.setup, one.wavelengths
        self.sums, self.batch, self.size = sums, batch, size
        self.beam = one.setup.beam
        if one.beams:
            several = len(one.sizes) // len(one.beams)
            self.beam = self.beam.in_lanes(one.beams * several, batch)
        self.ray: Any = None

    def add(self, sampler: mi.Sampler, ray: mi.UInt32) -> None:
        """Add to the sums what becomes of one ray per lane, number `ray` of a batch.

        They are followed by the cheapest transport that is exact for the specimen.
        """
        setup, active = self.setup, ray < self.size
        how, specimen = _path_settings(setup), setup.specimen
        if setup.settings.estimator.splits:
            how = replace(how, max_depth=1)
        deposits = None
        if setup.settings.estimator.deposits:
            deposits = Deposits(setup, self.sums, active, self.batch)
        if traces(setup):
            exits = trace(specimen, self.beam, sampler, self.wavelengths, how, deposits)
        else:
            plane = specimen.plane
            exits = scatter_plane(plane, self.beam, sampler, self.wavelengths, how)
        if setup.settings.estimator.splits:
            self._branch(sampler, exits, active)
            return
        exits = of_order(exits, setup.order)
        bins = setup.bins(exits)
        self.sums.add(bins, exits, active, self.batch)
        if deposits is not None:
            deposits.add_exits(bins, exits)

    def _branch(self, sampler: mi.Sampler, exits: Exits, active: mi.Bool) -> None:
        """Add to the sums what becomes of rays of the estimator `split`.

        Those that met a surface again after their first event go on from there in
        `BRANCHES` directions, each with its part of the power.
        """
        setup, flight = self.setup, exits.flight
        again = active & (exits.fate == mi.UInt32(Fate.TRUNCATED))
        ended = of_order(exits, setup.order)
        self.sums.add(setup.bins(ended), ended, active & ~again, self.batch)
        bins = setup.bins(exits)  # of light of one event, to be compared with points
        first = active & ~again & (bins < setup.n_collected)
        self.sums.deposit(
            bins, exits.throughput, first, self.batch + self.sums.capacity
        )
        state = flight.ray.o, flight.ray.d, flight.n, flight.offset
        own, none = (self.batch, sampler.index, sampler.key), dr.zeros_like(exits.fate)
        batch, index, key = (mi.UInt32(x) + none for x in own)
        β = exits.throughput
        dr.eval(*state, β, batch, index, key, again)
        which = dr.compress(again)
        if not len(which):
            return
        lane, branch = apart(dr.arange(mi.UInt32, BRANCHES * len(which)), BRANCHES)
        which = dr.gather(mi.UInt32, which, lane)
        batch, index, key = (
            dr.gather(mi.UInt32, x, which) for x in (batch, index, key)
        )
        o, d, n, offset = (dr.gather(type(x), x, which) for x in state)
        ray = mi.Ray3f(o, d)
        ray.wavelengths = self.wavelengths
        # what they met is met indeed, from behind too
        flight = Flight(ray, mi.Vector3f(0), n, offset, mi.Bool(True), mi.UInt32(0))
        power = dr.gather(type(β), β, which)
        sampler = sampler.clone()
        # beyond 2**28 rays, whose branches have no index of 32 bits, by other keys
        sampler.key = (key ^ BRANCHED) + index // (2**32 // BRANCHES)
        sampler.index = index * BRANCHES + branch
        sampler.draw = mi.UInt32(0)
        how = replace(_path_settings(setup), max_depth=setup.settings.max_depth)
        specimen = setup.specimen
        light = self.wavelengths
        begun = flight, power
        exits = trace(specimen, self.beam, sampler, light, how, None, begun)
        exits = of_order(exits, setup.order)  # by rounding some meet nothing again
        bins = setup.bins(exits)
        self.sums.add(bins, exits, branch == 0, batch)
        collected = bins < setup.n_collected
        self.sums.deposit(bins, exits.throughput / BRANCHES, collected, batch)

    def relay(self, sampler: mi.Sampler, ray: mi.UInt32, rays: int) -> None:
        """Add to the sums what becomes of all rays, which scatter inside of media."""
        specimen, beam = self.setup.specimen, self.setup.beam
        path: Any = self.setup.layers
        if transport_of(self.setup) == "traced":
            path = Geometry(specimen, beam.side)
        if not continues(sampler):
            rays = dr.width(ray)
            # what rays of any number are looked up in
            self.batch, self.size = (
                x + dr.zeros(mi.UInt32, rays) for x in (self.batch, self.size)
            )
            dr.eval(self.batch, self.size, ray)
            self.ray = ray
        trace_inside(
            specimen,
            path,
            beam,
            sampler,
            self.wavelengths,
            _path_settings(self.setup),
            Relay(sampler, rays, self._arrive),
        )

    def _arrive(self, number: mi.UInt32, exits: Exits) -> None:
        """Add to the sums what has become of some rays of a relay."""
        exits = of_order(exits, self.setup.order)
        ray, batch, size = number, self.batch, self.size
        if self.ray is not None:
            ray, batch, size = (
                dr.gather(mi.UInt32, x, number)
                for x in (self.ray, self.batch, self.size)
            )
        self.sums.add(self.setup.bins(exits), exits, ray < size, batch)


def _path_settings(setup: Setup) -> PathSettings:
    """How rays are followed."""
    settings, analog = setup.settings, setup.settings.estimator.counts
    rr_depth = settings.rr_depth
    # counted rays live or die at each event as it is, and stay whole
    roulette = rr_depth >= 0 and not analog
    media, most = bool(setup.specimen.media), settings.order.most
    # rays that are cut off would leave other numbers to those after them in the lane
    shared = media and continues(setup.sampler)
    return PathSettings(
        analog=analog,
        # nothing that comes later is collected
        max_depth=settings.max_depth if media else min(settings.max_depth, most),
        rr_depth=rr_depth if roulette else 2**32 - 1,
        delta_only=settings.estimator.integrates,
        max_scatterings=min(settings.max_scatterings, UNLIMITED if shared else most),
        roulette=roulette,
    )

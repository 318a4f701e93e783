"""One launch: a kernel that sends the rays of some batches, and their totals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from ..settings.measurement_settings import MeasurementSettings
from ..settings.orders import UNLIMITED
from .bench import Bench
from .inside import Geometry, trace_inside
from .loop import Exits, PathSettings, scatter_plane, trace
from .next_event import Deposits
from .sampling import Relay, apart, continues, in_turns, relay_turns, seeded, turns_of
from .scattering_order import of_order
from .sums import Sums, Totals

__all__ = ["launch", "traces", "transport_of"]


def launch(
    bench: Bench,
    settings: MeasurementSettings,
    keys: Sequence[tuple[int, ...]],
    sizes: Sequence[int],
    begin: int,
    wavelengths: mi.Spectrum,
    capacity: int,
    stretch: tuple[int, int] | None = None,
) -> Totals:
    """Send rays of several batches in one kernel and return the totals.

    Parameters
    ----------
    bench : Bench
    settings : MeasurementSettings
    keys : list of tuple of int
        What tells each batch from all others.
    sizes : list of int
        Rays of each batch, in descending order and alike within one ray.
    begin : int
        Rays of each batch that were sent before.
    wavelengths : mi.Spectrum or mi.Color0f
        Of the rays.
    capacity : int
        Batches that there is room for: the same for all launches at a bench.
    stretch : (int, int), optional
        Along the curve that all batches walk together: only rays from there.

    Returns
    -------
    Totals
        Of as many batches as `keys`.
    """
    counted = settings.estimator == "analog"
    deposited = settings.estimator == "next_event"
    traced = traces(bench, settings)
    inside = bool(bench.specimen.media)
    turns = 1 if traced else turns_of(bench.sampler, sizes[0])
    if inside and continues(bench.sampler):
        turns = relay_turns(bench.sampler, sizes[0])
    lanes = -(-sizes[0] // turns)
    if traced and len(sizes) * lanes == 1:
        lanes = 2  # in a single one Dr.Jit 1.5 takes a loop's variables for constants
    while True:
        sums = Sums(bench, capacity, counted=counted, deposits=deposited)
        sampler = seeded(bench.sampler, keys, begin, lanes)
        if stretch is not None:
            batch, ray = sampler.follow_curve(*stretch)
        else:
            # as many lanes as rays, even where none of them draws a number
            lane = dr.arange(mi.UInt32, len(sizes) * lanes)
            batch, ray = (mi.UInt32(0), lane) if capacity == 1 else apart(lane, lanes)
        # the last batches may be shorter by one ray
        full = dr.opaque(mi.UInt32, sizes.count(sizes[0]))
        size = dr.opaque(mi.UInt32, sizes[0]) - dr.select(batch < full, mi.UInt32(0), 1)
        rays = _Rays(bench, settings, wavelengths, sums, batch, size)
        if inside:
            rays.relay(sampler, ray, sizes[0])
        elif continues(sampler) and not traced:
            in_turns(rays.add, sampler, ray, lanes, turns)
        else:
            rays.add(sampler, ray)
        sums.evaluate()
        if not sums.lacking:
            break
        # fainter or brighter light than there was room for: once more, with room for it
        bench.levels = sums.lacking
    return sums.totals(len(sizes))


def traces(bench: Bench, settings: MeasurementSettings) -> bool:
    """Whether rays are traced: for geometry, or where that is asked for."""
    return settings.trace or bench.specimen.plane is None


def transport_of(bench: Bench, settings: MeasurementSettings) -> str:
    """How rays are followed: on a ``plane``, through ``layers``, or ``traced``."""
    if not traces(bench, settings):
        return "plane"
    return "traced" if settings.trace or bench.layers is None else "layers"


class _Rays:
    """The rays of a launch, one after the other in each lane.

    No closure: the traceback of an error would keep what it closes over alive.
    """

    def __init__(
        self,
        bench: Bench,
        settings: MeasurementSettings,
        wavelengths: mi.Spectrum,
        sums: Sums,
        batch: mi.UInt32,
        size: mi.UInt32,
    ) -> None:
        self.bench, self.settings, self.wavelengths = bench, settings, wavelengths
        self.sums, self.batch, self.size = sums, batch, size
        self.ray: Any = None

    def add(self, sampler: mi.Sampler, ray: mi.UInt32) -> None:
        """Add to the sums what becomes of one ray per lane, number `ray` of a batch."""
        active = ray < self.size
        deposits = None
        if self.sums.deposits:
            order, points = self.settings.order, self.settings.points
            deposits = Deposits(
                self.bench, self.sums, points, order, active, self.batch
            )
        exits = _exits(self.bench, self.settings, sampler, self.wavelengths, deposits)
        bins = self.bench.bins(exits)
        self.sums.add(bins, exits, active, self.batch)
        if deposits is not None:
            deposits.add_exits(bins, exits)

    def relay(self, sampler: mi.Sampler, ray: mi.UInt32, rays: int) -> None:
        """Add to the sums what becomes of all rays, which scatter inside of media."""
        specimen, beam = self.bench.specimen, self.bench.beam
        path: Any = self.bench.layers
        if transport_of(self.bench, self.settings) == "traced":
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
            _path_settings(self.bench, self.settings),
            Relay(sampler, rays, self._arrive),
        )

    def _arrive(self, number: mi.UInt32, exits: Exits) -> None:
        """Add to the sums what has become of some rays of a relay."""
        exits = of_order(exits, self.settings.order)
        ray, batch, size = number, self.batch, self.size
        if self.ray is not None:
            ray, batch, size = (
                dr.gather(mi.UInt32, x, number)
                for x in (self.ray, self.batch, self.size)
            )
        self.sums.add(self.bench.bins(exits), exits, ray < size, batch)


def _exits(
    bench: Bench,
    settings: MeasurementSettings,
    sampler: mi.Sampler,
    wavelengths: mi.Spectrum,
    deposits: Deposits | None,
) -> Exits:
    """Follow the rays by the cheapest transport that is exact for the specimen."""
    how = _path_settings(bench, settings)
    if traces(bench, settings):
        exits = trace(bench.specimen, bench.beam, sampler, wavelengths, how, deposits)
    else:
        plane = bench.specimen.plane
        exits = scatter_plane(plane, bench.beam, sampler, wavelengths, how)
    return of_order(exits, settings.order)


def _path_settings(bench: Bench, settings: MeasurementSettings) -> PathSettings:
    """How rays are followed."""
    analog = settings.estimator == "analog"
    rr_depth = settings.rr_depth
    # counted rays live or die at each event as it is, and stay whole
    roulette = rr_depth >= 0 and not analog
    media, most = bool(bench.specimen.media), settings.order.most
    # rays that are cut off would leave other numbers to those after them in the lane
    shared = media and continues(bench.sampler)
    return PathSettings(
        analog=analog,
        # nothing that comes later is collected
        max_depth=settings.max_depth if media else min(settings.max_depth, most),
        rr_depth=rr_depth if roulette else 2**32 - 1,
        delta_only=settings.estimator == "quadrature",
        max_scatterings=min(settings.max_scatterings, UNLIMITED if shared else most),
        roulette=roulette,
    )

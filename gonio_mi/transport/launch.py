"""One launch: a kernel that sends the rays of some batches, and their totals."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi

from ..kernels import check_variant_kept
from ..results.provenance import FACETS
from ..settings.values import UNLIMITED
from .beam import Beam
from .curve import Curve
from .derivative import Adjoint, Derivative, Lobes, Noted, sent_back
from .exits import Exits, of_order
from .polarisation import n_channels
from .sampling import (
    Relay,
    continues,
    in_points_beside,
    in_turns,
    is_joint,
    points_per_lane,
    rays_per_lane,
    seeded,
    split_lanes,
    turns_of,
)
from .setup import Setup
from .sums import Sums, Totals
from .surface_loop import PathSettings, scatter_plane, trace


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
    curve : Curve, optional
        Stretch of the curve that the batches follow. Without one rays are in order.
    control : object, optional
        Light that is known without rays, of the setup's method.
    levels : range
        Of rare powers that there is room for: what was met so far.
    derivative : Derivative, optional
        By the parameter that is attached.
    """

    setup: Setup
    beams: tuple[Beam, ...]
    wavelengths: Any
    capacity: int
    keys: tuple[tuple[int, ...], ...]
    sizes: tuple[int, ...]
    begin: int = 0
    curve: Curve | None = None
    control: Any = None
    levels: range = range(0)
    derivative: Derivative | None = None

    @property
    def rays(self) -> int:
        """Rays in all, those along the curve that no batch sends included."""
        return sum(self.sizes) if self.curve is None else self.curve.rays

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
    rays_of_lanes, shared = sizes[0], _shares_words(one)
    if shared:
        turns = points_per_lane(sum(sizes))
        rays_of_lanes += one.begin % turns
    lanes = -(-rays_of_lanes // turns)
    if (traced or shared) and len(sizes) * lanes == 1:
        lanes = 2  # in a single one Dr.Jit 1.5 takes a loop's variables for constants
    levels = one.levels
    while True:
        known = None if one.control is None else one.control.flux
        sums = Sums(setup, levels, one.capacity, known)
        sampler, batch, ray, size = _wavefront(one, lanes)
        rays = LaunchedRays(one, sums, batch, size)
        add = partial(setup.method.add, rays)
        if inside:
            rays.relay(sampler, ray, sizes[0])
        elif shared:
            in_points_beside(add, sampler, ray, turns)
        elif turns > 1:
            in_turns(add, sampler, ray, lanes, turns)
        else:
            add(sampler, ray)
        sums.evaluate()
        check_variant_kept()
        if not sums.lacking:
            break
        # fainter or brighter light than there was room for: once more, with room for it
        levels = sums.lacking
    return sums.totals(len(sizes))


def _shares_words(one: Launch) -> bool:
    """Whether lanes send rays of points beside each other, in a loop.

    Not for derivatives, nor where plugins in Python may look at their lanes: what is
    computed in a loop has no values yet. On a GPU it has not been measured.
    """
    setup = one.setup
    if traces(setup) or not is_joint(setup.sampler) or one.derivative is not None:
        return False
    inspected = setup.specimen.plane.by_ray or not setup.beam.collimated
    return mi.variant().startswith("llvm") and not inspected


def _wavefront(
    one: Launch, lanes: int
) -> tuple[mi.Sampler, mi.UInt32, mi.UInt32, mi.UInt32]:
    """Sampler of all lanes; of each its batch, its ray, and the rays of the batch."""
    sizes = one.sizes
    sampler = seeded(one.setup.sampler, one.keys, one.begin, lanes)
    if one.curve is not None:
        batch, ray = sampler.follow(one.curve)
    else:
        # as many lanes as rays, even where none of them draws a number
        lane = dr.arange(mi.UInt32, len(sizes) * lanes)
        alone = one.capacity == 1
        batch, ray = (mi.UInt32(0), lane) if alone else split_lanes(lane, lanes)
    # the last batches may be shorter by one ray
    full = dr.opaque(mi.UInt32, sizes.count(sizes[0]))
    size = dr.opaque(mi.UInt32, sizes[0]) - dr.select(batch < full, mi.UInt32(0), 1)
    return sampler, batch, ray, size


def send_back(one: Launch, lobes: Lobes, loss: mi.Float) -> float:
    """Send what a loss makes of patches back to the parameters that are attached.

    Traced rays go twice: for what they bring, and for what their events have of it,
    since no derivative goes backward through a loop of unknown length.

    Parameters
    ----------
    one : Launch
    lobes : Lobes
    loss : mi.Float
        Derivative of the loss by what a ray adds to each patch and channel.

    Returns
    -------
    float
        When the last kernel began to run, by ``time.perf_counter``.
    """
    setup, n = one.setup, n_channels()
    lanes = one.sizes[0]
    if len(one.sizes) * lanes == 1:
        lanes = 2  # as of a launch
    noted = None if traces(setup) else Noted()
    exits, bins, active = _arrived(replace(one, derivative=noted), lanes)
    light = mi.UnpolarizedSpectrum(exits.throughput)
    for channel in range(n):
        own = dr.gather(mi.Float, loss, bins * n + channel, active)
        light[channel] = dr.select(active, light[channel] * own, 0)
    adjoint = Adjoint(lobes, light)
    if noted is not None:
        dr.eval(sent_back(adjoint, noted.event, dr.width(bins)))
    else:
        dr.eval(light)
        exits, _, _ = _arrived(replace(one, derivative=adjoint), lanes)
        dr.eval(exits.fate)
    started = time.perf_counter()
    dr.sync_thread()
    return started


def _arrived(one: Launch, lanes: int) -> tuple[Exits, mi.UInt32, mi.Bool]:
    """Exits of the rays of a launch, their bins, and which are collected in patches."""
    setup = one.setup
    sampler, batch, ray, size = _wavefront(one, lanes)
    path = LaunchedRays(one, None, batch, size).path  # type: ignore[arg-type]
    exits = of_order(path()(sampler), setup.order)
    bins = setup.bins(exits)
    return exits, bins, (ray < size) & (bins < setup.n_collected)


def traces(setup: Setup) -> bool:
    """Whether rays are traced: for geometry, or where that is asked for."""
    return setup.settings.trace or setup.specimen.plane is None


def transport_of(setup: Setup) -> str:
    """How rays are followed: on a ``plane``, through ``layers``, or ``traced``.

    Or traced for what the first order of mirror ``facets`` leaves open.
    """
    if not traces(setup):
        return "plane"
    if setup.method.controls(setup):
        return FACETS
    return "traced" if setup.settings.trace or setup.layers is None else "layers"


class LaunchedRays:
    """The rays of a launch, one after the other in each lane.

    No closure: the traceback of an error would keep what it closes over alive.

    Attributes
    ----------
    setup : Setup
    sums : Sums
    wavelengths : mi.Spectrum or mi.Color0f
    batch, size : mi.UInt32
        Of each lane: its batch, and the rays of that.
    beam : Beam
    control : object, optional
        Light that is known without rays, of the setup's method.
    """

    def __init__(
        self, one: Launch, sums: Sums, batch: mi.UInt32, size: mi.UInt32
    ) -> None:
        self.setup, self.wavelengths = one.setup, one.wavelengths
        self.sums, self.batch, self.size = sums, batch, size
        self.control, self.derivative = one.control, one.derivative
        self.beam = one.setup.beam
        if one.beams:
            several = len(one.sizes) // len(one.beams)
            self.beam = self.beam.in_lanes(one.beams * several, batch)
        self.ray: Any = None

    def path(
        self, max_depth: int | None = None, deposits: Any = None, begun: Any = None
    ) -> Callable[[mi.Sampler], Exits]:
        """Function that follows one ray per lane, by the cheapest transport.

        `max_depth` is that of the settings unless given; `deposits` and `begun` are
        those of :func:`~.surface_loop.trace`.
        """
        setup, light = self.setup, self.wavelengths
        how, specimen = path_settings(setup), setup.specimen
        how = replace(how, derivative=self.derivative)
        if max_depth is not None:
            how = replace(how, max_depth=max_depth)
        told: dict[str, Any] = {"wavelengths": light, "settings": how}
        if begun is None and not traces(setup):
            return partial(scatter_plane, specimen.plane, self.beam, **told)
        told |= {"deposits": deposits, "begun": begun}
        return partial(trace, specimen, self.beam, **told)

    def collect(self, exits: Exits, active: mi.Bool) -> tuple[mi.UInt32, Exits]:
        """Add to the sums what arrived; its bins, and the exits of the order asked."""
        exits = of_order(exits, self.setup.order)
        bins = self.setup.bins(exits)
        self.sums.add(bins, exits, active, self.batch)
        return bins, exits

    def relay(self, sampler: mi.Sampler, ray: mi.UInt32, rays: int) -> None:
        """Add to the sums what becomes of all rays, which scatter inside of media."""
        # slow to import, for Dr.Jit takes its loops apart
        from .media_loop import Geometry, trace_inside

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
            path_settings(self.setup),
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


def path_settings(setup: Setup) -> PathSettings:
    """How rays are followed."""
    settings, analog = setup.settings, setup.method.counted
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
        delta_only=setup.method.delta_only,
        max_scatterings=min(settings.max_scatterings, UNLIMITED if shared else most),
        roulette=roulette,
    )

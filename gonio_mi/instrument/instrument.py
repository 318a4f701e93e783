"""The instrument: settings, collector and sampler, which measure at a bench."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import SpecimenError
from ..quadrature.plane import check_integrable, integrals
from ..results.integral_sums import Integrals
from ..results.record import Record
from ..results.tally import WEIGHT_SCALE, Ledger, Tally
from ..settings import MeasurementSettings
from ..settings.orders import Order
from ..transport.beam import Beam
from ..transport.bench import Bench
from ..transport.collector_sphere import CollectorSphere
from ..transport.media import check_media
from ..transport.next_event import check_traced
from ..transport.pace import Pace
from ..transport.specimen import Specimen
from ..transport.spectral_coverage import check_covered
from ..transport.trial import check_works
from ..transport.wavelengths import channel_names, passes, wavelength_lanes
from .description import described
from .launches import Launches

__all__ = ["Instrument"]


class Instrument:
    """What measures: it sets up a bench, sends rays batch by batch, makes the record.

    Parameters
    ----------
    settings : MeasurementSettings
    sampler : mi.Sampler
    """

    def __init__(self, settings: MeasurementSettings, sampler: mi.Sampler) -> None:
        self.settings = settings
        self.sampler = sampler
        self.collector = CollectorSphere(
            settings.collector, settings.hemispheres, settings.collector_radius
        )
        self.wavelengths = settings.wavelengths
        self._pace: Pace | None = None

    @property
    def integrates(self) -> bool:
        """Whether ``eval`` is integrated, and rays are for delta components only."""
        return self.settings.estimator == "quadrature"

    @property
    def deposits(self) -> bool:
        """Whether ``eval`` is deposited at every event."""
        return self.settings.estimator == "next_event"

    @property
    def points(self) -> int:
        """Directions that a ray looks into at each event: 1 but for `deposits`."""
        return self.settings.points if self.deposits else 1

    @property
    def passes(self) -> int:
        """How often the rays are sent: once for every four wavelengths."""
        return len(passes(self.wavelengths))

    def check(self, specimen: Specimen) -> None:
        """Raise what a BSDF of the specimen raises, or SpecimenError beyond its data.

        Once for each specimen, before its benches.
        """
        lanes = [wavelength_lanes(nm) for nm in passes(self.wavelengths)]
        bsdfs = [surface.bsdf() for surface in specimen.surfaces]
        check_works(bsdfs, lanes[0], self.settings.estimator)
        if mi.is_spectral:
            check_covered([*bsdfs, *specimen.media], self.wavelengths)
        if specimen.media:
            check_media(specimen, lanes, self.settings.estimator)

    def bench(
        self,
        specimen: Specimen,
        emitters: Sequence[mi.Emitter],
        incident: tuple[float, float] | None = None,
        described: str | None = None,
        orders: Sequence[Order] = (),
    ) -> Bench:
        """Set up a :class:`Bench` for the one emitter of `emitters`.

        `incident` is the pair of angles in degrees that it was made for, if any, and
        `described` the digest of the emitter before it was turned there. Several
        `orders` are collected apart.
        """
        if any(emitter.get_medium() is not None for emitter in emitters):
            raise SpecimenError(
                "the emitter must stand in air, got one inside of a medium"
            )
        if len(emitters) != 1:
            raise SpecimenError(
                "the scene must have one emitter, or an incident angle be given, "
                f"got {len(emitters)} emitters"
            )
        corner = np.abs([specimen.low, specimen.high]).max(axis=0)
        if 0 < self.collector.radius <= np.linalg.norm(corner):
            raise SpecimenError(
                "collector.radius must enclose the specimen, whose corner is at "
                f"{corner}, got {self.collector.radius}"
            )
        beam = self._beam(specimen, emitters[0])
        bench = Bench(specimen, beam, self.collector, self.sampler, incident, described)
        bench.collect_orders(orders)
        if self.integrates:
            lanes = wavelength_lanes(passes(self.wavelengths)[0])
            check_integrable(bench, self.settings, lanes)
        if self.deposits:
            check_traced(bench, self.settings)
        return bench

    def _beam(self, specimen: Specimen, emitter: mi.Emitter) -> Beam:
        """Light of `emitter`, at wavelengths that it has."""
        emission = self.settings.emission
        collimated = mi.has_flag(emitter.flags(), mi.EmitterFlags.DeltaDirection)
        by_shape = emission == "equal_power" and emitter.get_shape() is not None
        # of the other two, no power is asked for
        if mi.is_spectral and not collimated and not by_shape:
            check_covered([emitter], self.wavelengths)
        nm = self.wavelengths if mi.is_spectral else None
        footprint, divergence = self.settings.footprint, self.settings.divergence
        incident = self.settings.incident
        return Beam(specimen, emitter, footprint, emission, nm, divergence, incident)

    def tallies(
        self,
        bench: Bench,
        key: tuple[int, ...],
        sizes: Sequence[int],
        first: int = 0,
        start: int = 0,
        progress: Callable[[float], Any] | None = None,
    ) -> Iterator[Tally]:
        """Tallies of independent batches, in order: of one batch each, or of several.

        Small batches share a launch if the sampler keeps them apart; the bits do not
        depend on that.

        Parameters
        ----------
        bench : Bench
        key : tuple of int
            Seed, and whatever tells this measurement from others of the same seed.
        sizes : sequence of int
            Rays to send in each batch, in descending order and alike within one ray; as
            often again for each further four wavelengths.
        first : int
            Number of the first of these batches.
        start : int
            Rays of each of these batches that were sent before.
        progress : callable, optional
            Called after each launch with the rays it sent.

        Yields
        ------
        Tally
        """
        launches = self._launches(bench)
        sent = [(nm, wavelength_lanes(nm)) for nm in passes(self.wavelengths)]
        while sizes:
            keys = [(*key, first + i) for i in range(len(sizes))]
            several = launches.several(
                [(*one, 0) for one in keys], sizes, start, sent[0][1]
            )
            groups = []
            for number, (nm, lanes) in enumerate(sent):
                own = [(*one, number) for one in keys[:several]]
                tally = launches.tally(own, sizes[:several], start, lanes, progress)
                groups.append(tally if nm is None else tally.first(len(nm)))
            yield groups[0] if len(groups) == 1 else Tally.join_channels(groups)
            first, sizes = first + several, sizes[several:]

    def round_rays(self, bench: Bench) -> int:
        """Rays of each batch after which all of them are even for the first time."""
        return self._launches(bench).round_rays

    def samples(self, bench: Bench) -> bool:
        """Whether rays are needed: always, but for integrals without delta lobes."""
        return not self.integrates or mi.has_flag(
            bench.specimen.plane.bsdf.flags(), mi.BSDFFlags.Delta
        )

    def integrated(
        self, benches: Sequence[Bench], sampled: Sequence[list[Tally]]
    ) -> list[Integrals]:
        """Integrals of all but the delta components, beside the tallies of those.

        At each of the `benches`, which share kernels, what was `sampled` there.
        """
        groups = []
        for nm in passes(self.wavelengths):
            lanes, kept = wavelength_lanes(nm), nm and len(nm)
            groups.append(integrals(benches, lanes, self.settings.integral_err, kept))
        found = []
        for bench, tallies, parts in zip(benches, sampled, zip(*groups)):
            flux, errors = (np.concatenate(arrays, axis=-1) for arrays in zip(*parts))
            if tallies:
                beside = Tally.join(tallies).spread(flux.shape[-1])
            else:
                shape = bench.collector.subdivision.shape
                n_channels = flux.shape[-1]
                beside = Tally.empty(bench.shape[0], shape, n_channels, WEIGHT_SCALE)
            found.append(Integrals.beside(beside, flux, errors))
        return found

    def _launches(self, bench: Bench) -> Launches:
        """Launches at a bench, which know how long those before took."""
        launches = Launches(bench, self.settings, self.points, self._pace)
        self._pace = launches.pace
        return launches

    def record(self, bench: Bench, tally: Tally, seed: int) -> Record:
        """Record of a finished `tally`, with all that is needed to repeat it."""
        if 0 < tally.ledger.missed == tally.ledger.emitted:
            raise SpecimenError(
                f"the footprint {self.settings.footprint} must meet the specimen, "
                f"but all {tally.ledger.emitted} rays missed it"
            )
        _check_arrived(tally.ledger)
        functions = "sample() or eval()" if self.deposits else "sample()"
        _warn_of_invalid(tally.ledger, functions, bench.beam.collimated)
        _warn_of_astray(tally.ledger)
        if not mi.is_spectral and tally.achromatic:
            tally = tally.first(1)
        return Record(
            subdivision=bench.collector.subdivision,
            theta_i=np.array([bench.theta_i]),
            phi_i=np.array([bench.phi_i]),
            channels=channel_names(self.wavelengths, tally.channels),
            tallies=(tally,),
            settings=self.describe(bench, seed) | {"batches": tally.n_batches},
        )

    def describe(self, bench: Bench, seed: int) -> dict[str, object]:
        """Settings of the measurement, in JSON's types."""
        return described(self.settings, bench, seed, self.samples(bench))


def _warn_of_invalid(ledger: Ledger, functions: str, collimated: bool) -> None:
    if ledger.invalid:
        near = "" if collimated else " or the emitter is too near for single rays,"
        warnings.warn(
            f"the BSDF's {functions} returned a negative, infinite or NaN weight, or "
            f"no unit direction,{near} for {ledger.invalid} of {ledger.emitted} "
            "rays; they are in the ledger's row invalid and in no patch",
            RuntimeWarning,
            stacklevel=3,
        )


def _check_arrived(ledger: Ledger) -> None:
    """Raise SpecimenError where all rays that met the specimen went astray."""
    met = ledger.emitted - ledger.missed - ledger.unlit
    if 0 < ledger.astray == met:
        raise SpecimenError(
            "a shape with a medium must be closed, and overlap no other, but all "
            f"{met} rays that met it left the scene inside of a medium, or met a "
            "surface of another one; layers that are open at their sides are measured "
            "with --period box, and two shapes about one medium share it by a reference"
        )


def _warn_of_astray(ledger: Ledger) -> None:
    if ledger.astray:
        warnings.warn(
            "a shape with a medium must be closed, and overlap no other, but "
            f"{ledger.astray} of {ledger.emitted} rays left the scene inside of a "
            "medium or met a surface that is said to lie in another one; they are in "
            "the ledger's row astray and in no patch; layers that are open at their "
            "sides are measured with --period box",
            RuntimeWarning,
            stacklevel=3,
        )

"""Integrator `goniophotometer`: sends rays batch by batch and tallies where they go."""

import datetime
import platform
import warnings
from importlib.metadata import version

import drjit as dr
import mitsuba as mi
import numpy as np

from gonio_mi import llvm, properties
from gonio_mi.errors import SpecimenError, VariantError
from gonio_mi.quadrature.plane import check_integrable, integrals
from gonio_mi.results.record import Record
from gonio_mi.results.tally import WEIGHT_SCALE, Tally, batch_sizes
from gonio_mi.transport.beam import EMISSIONS, Beam, checked_footprint
from gonio_mi.transport.bench import Bench
from gonio_mi.transport.kernels import launches_kernels
from gonio_mi.transport.launch import Pace, traces
from gonio_mi.transport.next_event import MOST_POINTS, check_traced
from gonio_mi.transport.sampling import sampler_name
from gonio_mi.transport.scattering_order import checked_order
from gonio_mi.transport.specimen import Specimen, checked_period
from gonio_mi.transport.spectral_coverage import check_covered
from gonio_mi.transport.sums import packet_width
from gonio_mi.transport.trial import check_works
from gonio_mi.transport.variants import is_usable
from gonio_mi.transport.wavelengths import (
    channel_names,
    checked_wavelengths,
    passes,
    wavelength_lanes,
)

# Rays per kernel launch, at most. For samplers other than `sobol` it takes part in the
# seeding: a change of it changes the random numbers.
LAUNCH = 2**24

# Rays of the batches that share a launch: many for its overhead, few for the progress
# bar and Ctrl-C; and the numbers that they add up to, kept apart for each thread and
# in its cache.
FUSED_RAYS = 2**22
FUSED_SUMS = 2**19

# Rays of the first launch, traced and on a plane; then as many as take a second.
FIRST_TRACED, FIRST_PLANE = 2**18, 2**20

ESTIMATORS = ("weighted", "analog", "quadrature", "next_event")
DEFAULT_RAYS = 1_000_000
DEFAULT_BATCHES = 16
DEFAULT_WAVELENGTHS = "550"

# Relative error of each patch to which the estimator `quadrature` integrates.
DEFAULT_INTEGRAL_ERR = 1e-4


class Goniophotometer(mi.SamplingIntegrator):
    r"""Virtual goniophotometer (:monosp:`goniophotometer`).

    Sends light from the scene's one emitter to the specimen (every shape that does not
    emit) and tallies each ray in the patches of a :monosp:`collector` sensor with a
    :monosp:`patches` film. ``mi.render(scene)`` returns the film's map;
    ``mi.render(scene, spp=n)`` measures with ``n`` rays instead of `rays`.

    .. pluginparameters::

     * - rays
       - |int|
       - Rays to send. (Default: 1e6)

     * - batches
       - |int|
       - Independent batches, from whose scatter uncertainties come. (Default: 16)

     * - estimator
       - |string|
       - ``weighted`` sums throughput; ``analog`` lets a ray survive or end at each
         event and counts it (the paper's eq. 5); ``quadrature`` integrates ``eval``
         over the patches, for a flat specimen that is the same everywhere in a
         collimated beam, and samples delta components only; ``next_event`` deposits
         ``eval`` towards points in random patches at every event on geometry, and
         counts rays by the part that the balance heuristic leaves to them.
         (Default: ``weighted``)

     * - points
       - |int|
       - Points for each event, of the estimator ``next_event``. (Default: 1)

     * - rel_err
       - |float|
       - Relative error of each patch to which ``quadrature`` converges, down to a
         millionth of the mean patch. (Default: 1e-4)

     * - max_depth
       - |int|
       - Surface events after which a ray is truncated. (Default: 1000)

     * - rr_depth
       - |int|
       - Surface events after which Russian roulette sets in, for the weighted
         estimator; -1 for never. (Default: -1)

     * - footprint
       - |string| or |float|
       - ``full`` (the whole top of the specimen), ``point`` (its middle), or the radius
         of a disk about the middle, in scene units. (Default: ``full``)

     * - emission
       - |string|
       - ``radiometric`` (rays weighted by radiance, cosines and distance, as light is)
         or ``equal_power`` (the paper's section 2.2). (Default: ``radiometric``)

     * - trace
       - |bool|
       - Trace rays even where a flat specimen does not need it. (Default: false)

     * - period
       - |string| or |float|
       - ``none``; ``box``: the specimen's bounding box is one cell of an infinite
         surface, and what leaves through a side of it enters through the opposite one;
         or the cell's extents in x and y, such as ``2,3``. What passes its openings is
         transmitted. (Default: ``none``)

     * - order
       - |string|
       - Surface events of the rays that are collected: ``2`` for two, ``3+`` for three
         or more, ``0`` for direct light; the others are in the ledger. (Default:
         ``all``)

     * - wavelengths
       - |string|
       - Wavelengths in nm of the channels in spectral variants, separated by commas.
         The data of specimen and lamp must cover them. (Default: 550)

    .. tabs::
        .. code-tab:: xml

            <integrator type="goniophotometer">
                <integer name="rays" value="1000000"/>
            </integrator>

        .. code-tab:: python

            'type': 'goniophotometer',
            'rays': 1000000
    """

    def __init__(self, props):
        _check_variant()
        self.settings = {
            "rays": properties.count(props, "rays", DEFAULT_RAYS),
            "batches": properties.count(
                props, "batches", DEFAULT_BATCHES, maximum=65536
            ),
            "estimator": properties.choice(props, "estimator", "weighted", ESTIMATORS),
            "rel_err": properties.number(
                props, "rel_err", DEFAULT_INTEGRAL_ERR, 1e-9, 1, "in [1e-9, 1)"
            ),
            "points": properties.count(props, "points", 1, maximum=MOST_POINTS),
            "max_depth": properties.count(props, "max_depth", 1000, maximum=2**31),
            "rr_depth": properties.count(props, "rr_depth", -1, minimum=-1),
            "footprint": checked_footprint(props.get("footprint", "full")),
            "emission": properties.choice(props, "emission", EMISSIONS[0], EMISSIONS),
            "trace": properties.flag(props, "trace", False),
            "period": checked_period(props.get("period", "none")),
            "order": checked_order(props.get("order", "all")),
            "wavelengths": props.get("wavelengths", DEFAULT_WAVELENGTHS),
        }
        self.rays = self.settings["rays"]
        self.batches = self.settings["batches"]
        self.analog = self.settings["estimator"] == "analog"
        self.integrates = self.settings["estimator"] == "quadrature"
        self.deposits = self.settings["estimator"] == "next_event"
        self._pace = None
        self.wavelengths = checked_wavelengths(self.settings["wavelengths"])
        super().__init__(props)

    # ------------------------------------------------------------------ measuring

    @launches_kernels()
    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        """Measure; see the class. The film keeps the record."""
        del evaluate
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        specimen = Specimen(scene, self.settings["period"])
        self.check(specimen)
        bench = self.bench(specimen, scene.emitters(), sensor)
        key = (int(mi.UInt32(seed)[0]), 0)
        sizes = batch_sizes(spp or self.rays, self.batches)
        tallies = list(self.tallies(bench, key, sizes)) if self.samples(bench) else []
        if self.integrates:
            tallies = [self.integrated(bench, tallies)]
        record = self.record(bench, Tally.join(tallies), key[0])
        if self.samples(bench):
            record.settings["rays"] = sum(sizes)
        sensor.film().record = record
        return sensor.film().develop() if develop else None

    def check(self, specimen):
        """Raise what a BSDF of the specimen raises, or SpecimenError beyond its data.

        Once for each specimen, before its benches.
        """
        lanes = wavelength_lanes(passes(self.wavelengths)[0])
        bsdfs = [surface.bsdf() for surface in specimen.surfaces]
        check_works(bsdfs, lanes, self.settings["estimator"])
        if mi.is_spectral:
            check_covered(bsdfs, self.wavelengths)

    def bench(self, specimen, emitters, sensor, incident=None, lamp=None):
        """Set up a :class:`Bench` for the one emitter of `emitters`.

        `incident` is the pair of angles in degrees that it was made for, if any, and
        `lamp` the digest of the emitter before it was turned there.
        """
        if not hasattr(sensor, "arrival"):
            raise SpecimenError(
                "the integrator goniophotometer needs a sensor of type collector, "
                f"got {sensor.class_name()}"
            )
        if len(emitters) != 1:
            raise SpecimenError(
                "the scene must have one emitter, or an incident angle be given, "
                f"got {len(emitters)} emitters"
            )
        corner = np.abs([specimen.low, specimen.high]).max(axis=0)
        if 0 < sensor.radius <= np.linalg.norm(corner):
            raise SpecimenError(
                "collector.radius must enclose the specimen, whose corner is at "
                f"{corner}, got {sensor.radius}"
            )
        beam = self._beam(specimen, emitters[0])
        bench = Bench(specimen, beam, sensor, incident, lamp)
        if self.integrates:
            lanes = wavelength_lanes(passes(self.wavelengths)[0])
            check_integrable(bench, self.settings, lanes)
        if self.deposits:
            check_traced(bench, self.settings)
        return bench

    def _beam(self, specimen, emitter):
        """Light of `emitter`, at wavelengths that it has."""
        emission = self.settings["emission"]
        collimated = mi.has_flag(emitter.flags(), mi.EmitterFlags.DeltaDirection)
        by_shape = emission == "equal_power" and emitter.get_shape() is not None
        # of the other two, no power is asked for
        if mi.is_spectral and not collimated and not by_shape:
            check_covered([emitter], self.wavelengths)
        nm = self.wavelengths if mi.is_spectral else None
        return Beam(specimen, emitter, self.settings["footprint"], emission, nm)

    def tallies(self, bench, key, sizes, first=0, start=0, progress=None):
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
        capacity = self._capacity(bench)
        if self._pace is None:
            traced = traces(bench, self.settings)
            self._pace = Pace(FIRST_TRACED if traced else FIRST_PLANE)
        while sizes:
            most = min(FUSED_RAYS, self._pace.rays)
            several = max(1, min(len(sizes), capacity, most // sizes[0]))
            groups = []
            for number, nm in enumerate(passes(self.wavelengths)):
                keys = [(*key, first + i, number) for i in range(several)]
                lanes = wavelength_lanes(nm)
                tally = self._part(bench, keys, sizes[:several], start, lanes, progress)
                groups.append(tally if nm is None else tally.first(len(nm)))
            yield groups[0] if len(groups) == 1 else Tally.join_channels(groups)
            first, sizes = first + several, sizes[several:]

    def samples(self, bench):
        """Whether rays are needed: always, but for integrals without delta lobes."""
        return not self.integrates or mi.has_flag(
            bench.specimen.plane.bsdf.flags(), mi.BSDFFlags.Delta
        )

    def integrated(self, bench, tallies):
        """Tally of all but the delta components, and of the `tallies` of those."""
        lanes = [(wavelength_lanes(nm), nm) for nm in passes(self.wavelengths)]
        parts = [
            integrals(bench, wavelengths, self.settings["rel_err"], nm and len(nm))
            for wavelengths, nm in lanes
        ]
        flux, errors = (np.concatenate(arrays, axis=-1) for arrays in zip(*parts))
        if tallies:
            sampled = Tally.join(tallies).spread(flux.shape[-1])
        else:
            sampled = Tally.empty(
                bench.shape[0],
                bench.film.subdivision.shape,
                flux.shape[-1],
                WEIGHT_SCALE,
            )
        return sampled.with_integrals(flux, errors)

    def _capacity(self, bench):
        """Batches that may share a launch: the same for all launches at a bench."""
        if not hasattr(bench.sensor.sampler(), "start"):
            return 1
        fitting = FUSED_SUMS // (bench.n_bins * packet_width())
        return max(1, min(fitting, self.batches))

    def _part(self, bench, keys, sizes, start, wavelengths, progress):
        """Tally of the batches of `keys`, by one launch or more for a single one."""
        total, capacity = None, self._capacity(bench)
        divisible = hasattr(bench.sensor.sampler(), "start")
        begin, end = start, start + sizes[0]
        while begin < end:
            n = min(LAUNCH, end - begin)
            if divisible:
                n = min(n, self._pace.next_part(begin, end))
            parts = [min(n, start + size - begin) for size in sizes]
            totals = self._pace.launch(
                bench, self.settings, keys, parts, begin, wavelengths, capacity
            )
            total = totals if total is None else total + totals
            if progress is not None:
                progress(sum(parts))
            begin += n
        return total.tally()

    def record(self, bench, tally, seed):
        """Record of a finished `tally`, with all that is needed to repeat it."""
        if 0 < tally.ledger.missed == tally.ledger.emitted:
            raise SpecimenError(
                f"the footprint {self.settings['footprint']} must meet the specimen, "
                f"but all {tally.ledger.emitted} rays missed it"
            )
        functions = "sample() or eval()" if self.deposits else "sample()"
        _warn_of_invalid(tally.ledger, functions, bench.beam.collimated)
        if not mi.is_spectral and tally.achromatic:
            tally = tally.first(1)
        return Record(
            subdivision=bench.film.subdivision,
            theta_i=np.array([bench.theta_i]),
            phi_i=np.array([bench.phi_i]),
            channels=channel_names(self.wavelengths, tally.channels),
            tallies=(tally,),
            settings=self.describe(bench, seed) | {"batches": tally.n_batches},
        )

    # --------------------------------------------------------------------- description

    @property
    def passes(self):
        """How often the rays are sent: once for every four wavelengths."""
        return len(passes(self.wavelengths))

    def describe(self, bench, seed):
        """Settings of the measurement, in JSON's types."""
        sampler = bench.sensor.sampler()
        return {
            "specimen": bench.specimen.name,
            "surface": bench.specimen.description,
            **bench.digests,
            "transmission": bench.specimen.transmission,
            "emitter": bench.beam.emitter.class_name(),
            "emission": self.settings["emission"],
            "footprint": self.settings["footprint"],
            "side": "front" if bench.beam.side > 0 else "back",
            "estimator": self.settings["estimator"],
            "transport": "traced" if traces(bench, self.settings) else "plane",
            "sampler": sampler_name(sampler),
            "seed": seed,
            "rays": self.rays if self.samples(bench) else 0,
            "passes": self.passes,
            "max_depth": self.settings["max_depth"],
            "rr_depth": self.settings["rr_depth"],
            "period": self.settings["period"],
            "order": self.settings["order"],
            "collector_radius": bench.sensor.radius,
            "variant": mi.variant(),
            **({"rel_err": self.settings["rel_err"]} if self.integrates else {}),
            **({"points": self.settings["points"]} if self.deposits else {}),
            "versions": {
                "gonio_mi": version("gonio-mi"),
                "mitsuba": mi.__version__,
                "drjit": dr.__version__,
                "numpy": np.__version__,
                "python": platform.python_version(),
            },
            "created": datetime.datetime.now(datetime.timezone.utc).isoformat(
                "T", "seconds"
            ),
        }

    def to_string(self):
        """Return a readable description."""
        return f"Goniophotometer{self.settings}"


def _check_variant():
    variant = mi.variant()
    if not is_usable(variant):
        raise VariantError(
            "gonio_mi needs an unpolarised llvm or cuda variant, such as "
            f"mi.set_variant('llvm_ad_mono'), got {variant}"
        )
    if variant.startswith("llvm"):
        llvm.check()


def _warn_of_invalid(ledger, functions, collimated):
    if ledger.invalid:
        near = "" if collimated else " or the emitter is too near for single rays,"
        warnings.warn(
            f"the BSDF's {functions} returned a negative, infinite or NaN weight, or "
            f"no unit direction,{near} for {ledger.invalid} of {ledger.emitted} "
            "rays; they are in the ledger's row invalid and in no patch",
            RuntimeWarning,
            stacklevel=3,
        )


mi.register_integrator("goniophotometer", Goniophotometer)

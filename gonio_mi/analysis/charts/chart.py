"""Speed against accuracy for a specimen: every method at rising numbers of rays."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from ...array_types import Floats
from ...campaigns.measure import measure_whole
from ...errors import (
    SettingError,
    SpecimenError,
    checked_count,
    checked_number,
    shown,
    warn,
)
from ...kernels import launches_kernels
from ...results.planning import patch_values, rms_expectation
from ...results.record import Record
from ...specimen.loading import load_specimen
from ...specimen.specimen_text import SpecimenLike, specimen_name
from .curves import Chart, Curve, Point, Reference

NEEDS_GEOMETRY = "the estimator next_event needs geometry, got a flat rectangle"

ESTIMATORS = ("analog", "weighted", "quadrature", "next_event")
SAMPLERS = ("independent", "sobol")

# Rays of the first points, and of each further one in those of the one before.
FIRST_RAYS = 2**12
GROWTH = 4
MAX_RAYS = 2**40

# Tolerances of integrals, as points of the estimator `quadrature`.
TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)

# Tolerance of the integral that is taken for true; the second if it is quick.
REFERENCE_ERRS = (1e-4, 1e-6)
MAX_QUICK_FRACTION = 0.05

# Rays from which the speed of a long reference run is foretold, and the part of the
# time that it gets.
PILOT_RAYS = 2**18
REFERENCE_FRACTION = 0.5

# Relative error of what Mitsuba computes, in single precision.
SINGLE_PRECISION = 1e-6

# A root mean square of this many times what error bars promise is no accident.
MAX_RMS_RATIO = 3.0
# For a single value, that may be by chance.
MAX_STD_ERRS = 5.0

PILOT_SETTINGS = {"estimator": "weighted", "sampler": "sobol"}


@launches_kernels()
def chart(
    specimen: SpecimenLike,
    theta_i: ArrayLike | None = None,
    phi_i: ArrayLike = 0.0,
    *,
    estimators: Sequence[str] = ESTIMATORS,
    samplers: Sequence[str] = SAMPLERS,
    seconds: float = 60,
    repeats: int = 4,
    seed: int = 0,
    parameters: dict[str, Any] | None = None,
    progress: bool = False,
    **settings: Any,
) -> Chart:
    """Measure a specimen by every method, at rising numbers of rays.

    The error is the root mean square over all patches, as in the paper's Table 1, here
    relative to the mean BSDF: counting independent rays gives the same error on all
    specimens of the same reflectance. The truth is the estimator ``quadrature`` to 1e-6
    (1e-4 if that takes long) where it applies and agrees with rays, else a run with the
    sampler ``sobol`` that takes half of the time.

    The cost is the CPU time of the process, all threads together, of whole calls of
    :func:`gonio_mi.measure` on a loaded scene. Each method is run once before, so that
    no kernel is compiled in it.

    Parameters
    ----------
    specimen, theta_i, phi_i, parameters
        As for :func:`gonio_mi.measure`, of one incident direction.
    estimators, samplers : sequence of str
        Every pair of them is a method. ``quadrature`` is left out where it does not
        apply, and gets finer tolerances instead of more rays; for a BSDF with delta
        components, more rays of the sampler ``sobol``. ``next_event`` is left out on
        flat specimens.
    seconds : float
        About how long all of it may take.
    repeats : int
        Measurements of different seeds for each point, at least 2.
    seed : int
    progress : bool
        Show a progress bar on standard error.
    **settings
        Further arguments of :func:`gonio_mi.measure`, such as `collector`, `side` or
        `batches`.

    Returns
    -------
    Chart

    Raises
    ------
    TypeError, ValueError, SpecimenError
        As :func:`gonio_mi.measure`; and if `seconds` is not positive.
    """
    seconds = checked_number("seconds", seconds, 1e-3, np.inf, "a positive number")
    repeats = checked_count("repeats", repeats, 2)
    for name, words in (("estimators", estimators), ("samplers", samplers)):
        if isinstance(words, str) or not len(words):
            raise SettingError(
                f"{name} must be a sequence of names, got {shown(words)}"
            )
    scene = load_specimen(specimen, parameters, settings.get("period"))
    runs = Runs(scene, {"theta_i": theta_i, "phi_i": phi_i, **settings}, seed, repeats)
    with _Clock(seconds, progress) as clock:
        clock.show("reference")
        pilot, reference, integrates = find_reference(runs, seconds)
        flat = pilot.provenance.transport == "plane"
        if flat or pilot.provenance.media:
            estimators = [name for name in estimators if name != "next_event"]
        methods = _methods(estimators, samplers, integrates)
        if not methods:
            raise SpecimenError(reference.refused or NEEDS_GEOMETRY)
        curves = _curves(runs, clock, reference, methods)
    patches = pilot.subdivision
    p = reference.values * patches.projected_solid_angles[..., None]
    square, _ = rms_expectation(patches, np.moveaxis(p, -1, 0), 1)
    result = Chart(
        specimen=specimen_name(specimen, parameters),
        theta_i=float(pilot.theta_i[0]),
        phi_i=float(pilot.phi_i[0]),
        collector=str(patches),
        curves=curves,
        reference=reference,
        independent=float(np.sqrt(square) / reference.mean),
        settings={
            "side": pilot.asked.side,
            "transport": pilot.provenance.transport,
            "batches": pilot.n_batches,
            "repeats": repeats,
            "seed": seed,
            "variant": mi.variant(),
        },
    )
    _warn_of_reference(result)
    return result


class _Clock(tqdm):
    """Progress bar in seconds, with the time that is left."""

    def __init__(self, seconds: float, shown: bool) -> None:
        self.seconds = seconds
        self.started = time.perf_counter()
        super().__init__(
            total=round(seconds),
            disable=not shown,
            leave=False,
            bar_format="{desc}: {bar} {n_fmt} of {total_fmt} s",
        )

    @property
    def left(self) -> float:
        """Seconds that are left."""
        return self.started + self.seconds - time.perf_counter()

    def show(self, words: str) -> None:
        """Say what is being done."""
        self.set_description_str(words, refresh=False)
        self.n = min(round(self.seconds - self.left), self.total)
        self.refresh()


def _methods(
    estimators: Sequence[str], samplers: Sequence[str], integrates: str
) -> list[Method]:
    """Every pair of an estimator and a sampler that applies."""
    methods = []
    for estimator in dict.fromkeys(estimators):
        of_all = list(dict.fromkeys(samplers))
        if estimator == "quadrature":
            of_all = {"flat": [""], "delta": ["sobol"]}.get(integrates, [])
        methods += [Method(estimator, sampler) for sampler in of_all]
    return methods


def _curves(
    runs: Runs, clock: _Clock, reference: Reference, methods: Sequence[Method]
) -> tuple[Curve, ...]:
    """Curve of each method; all of them grow point by point while there is time."""
    points: list[list[Point]] = [[] for _ in methods]
    spent = [[0.0] for _ in methods]  # seconds of each point
    for method in methods:
        clock.show("compiling")
        runs.measure(0, **method.settings, **method.effort(0))
    growing = list(range(len(methods)))
    while growing:
        for m in growing:
            level = len(points[m])
            clock.show(f"{' '.join(methods[m].settings.values())}, point {level + 1}")
            started = time.perf_counter()
            points[m].append(runs.point(methods[m], level, reference))
            spent[m].append(time.perf_counter() - started)
        growing = [m for m in growing if methods[m].effort(len(points[m]))]
        # the dearest ones are left behind
        growing.sort(key=lambda m: _next(spent[m]))
        while growing and sum(_next(spent[m]) for m in growing) > clock.left:
            growing.pop()
    return tuple(
        Curve(method.estimator, method.sampler, tuple(of_method))
        for method, of_method in zip(methods, points)
    )


def _next(spent: Sequence[float]) -> float:
    """Seconds of the next point: a fixed part, and one that grows with the rays."""
    return spent[-1] + GROWTH * max(spent[-1] - spent[-2], 0)


def _warn_of_reference(result: Chart) -> None:
    """Say so if the last points are further from the reference than they claim."""
    for curve in result.curves:
        last = curve.points[-1]
        if last.error > max(MAX_RMS_RATIO * last.claimed, result.least):
            warn(
                f"{curve.label}: {last.rays:.2g} rays are off the reference by "
                f"{last.error:.2g}, and their error bars say {last.claimed:.2g}"
            )


# ------------------------------------------------------------ measurements


@dataclass(frozen=True)
class Method:
    """An estimator and a sampler; no sampler for integrals without rays."""

    estimator: str
    sampler: str

    @property
    def settings(self) -> dict[str, str]:
        """Arguments of :func:`gonio_mi.measure`."""
        own = {"sampler": self.sampler} if self.sampler else {}
        return {"estimator": self.estimator} | own

    def effort(self, level: int) -> Any:
        """Rays, or tolerance, of the `level`-th point; None after the last."""
        if not self.sampler:
            return {"rel_err": TOLERANCES[level]} if level < len(TOLERANCES) else None
        rays = FIRST_RAYS * GROWTH**level
        return {"rays": rays} if rays <= MAX_RAYS else None


@dataclass(frozen=True)
class Runs:
    """Measurements of one specimen that differ in method, effort and seed."""

    scene: object
    settings: dict[str, Any]
    seed: int
    repeats: int

    def measure(self, seed: int, **settings: Any) -> Record:
        """Record of one measurement; seed 0 is for the reference and first runs."""
        given = self.settings | settings
        return measure_whole(self.scene, seed=self.seed + seed, **given)

    def point(self, method: Method, level: int, reference: Reference) -> Point:
        """:class:`.curves.Point` of a method at its `level`-th effort."""
        effort = method.effort(level)
        seconds, squares, claims = [], [], []
        for number in range(self.repeats):
            before = time.process_time()
            seed = 1 + level * self.repeats + number
            record = self.measure(seed, **method.settings, **effort)
            seconds.append(time.process_time() - before)
            values, std_err = arrays(record)
            squares.append(np.mean((values - reference.values) ** 2))
            claims.append(np.mean(std_err**2))
        error = np.sqrt(np.mean(squares)) / reference.mean
        scatter = np.std(squares, ddof=1) / np.sqrt(self.repeats) / reference.mean**2
        return Point(
            effort.get("rays", 0),
            float(np.median(seconds)),
            # no error can be told from less than the reference's own
            max(float(error), reference.error) if "rel_err" in effort else float(error),
            float(scatter / (2 * error)) if error else 0.0,
            float(np.sqrt(np.mean(claims)) / reference.mean),
        )


def find_reference(runs: Runs, seconds: float) -> tuple[Record, Reference, str]:
    """Return a first record of the specimen, and what is taken for true.

    Parameters
    ----------
    runs : Runs
    seconds : float
        Time for all of the chart, of which a long run takes a half.

    Returns
    -------
    pilot : Record
    reference : Reference
    integrates : {"", "flat", "delta"}
        Whether the estimator ``quadrature`` applies, and needs rays for delta lobes.

    Raises
    ------
    ValueError
        If there is more than one incident direction.
    SpecimenError
        If nothing reaches the collector.
    """
    runs.measure(0, rays=FIRST_RAYS, **PILOT_SETTINGS)
    started = time.perf_counter()
    pilot = runs.measure(0, rays=PILOT_RAYS, **PILOT_SETTINGS)
    rate = PILOT_RAYS / (time.perf_counter() - started)
    if len(pilot) > 1:
        raise SettingError(
            f"theta_i and phi_i must be one incident direction, got {len(pilot)}"
        )
    rays = max(PILOT_RAYS, int(rate * seconds * REFERENCE_FRACTION))
    refused = ""
    try:
        record = _integral(runs, pilot, rays, seconds)
        integrates = "delta" if record.ledger.emitted else "flat"
        words = f"quadrature to {record.asked.rel_err:g}"
        if integrates == "delta":
            words += f", {rays:.2g} rays for delta lobes"
    except SpecimenError as error:
        record = runs.measure(0, rays=rays, **PILOT_SETTINGS)
        integrates, refused = "", str(error)
        words = f"{rays:.2g} rays, weighted, sobol"
    return pilot, _reference(record, words, refused), integrates


def _reference(record: Record, source: str, refused: str) -> Reference:
    """:class:`gonio_mi.analysis.charts.curves.Reference` from a record."""
    values, std_err = arrays(record)
    weights = record.subdivision.projected_solid_angles[..., None]
    mean = float(np.average(values, weights=np.broadcast_to(weights, values.shape)))
    if not mean > 0:
        raise SpecimenError("the specimen must send some light to the collector")
    error = np.hypot(_rms(std_err), SINGLE_PRECISION * _rms(values)) / mean
    return Reference(values, float(error), mean, source, refused)


def _integral(runs: Runs, pilot: Record, rays: int, seconds: float) -> Record:
    """Record of integrals, or SpecimenError that says why there is none."""
    record: Any = None
    for rel_err in REFERENCE_ERRS:
        started = time.perf_counter()
        settings = {"estimator": "quadrature", "sampler": "sobol", "rel_err": rel_err}
        try:
            finer = runs.measure(0, rays=rays, **settings)
        except SpecimenError:
            if record is None:
                raise
            break
        record = finer
        if time.perf_counter() - started > MAX_QUICK_FRACTION * seconds:
            break
    # the integral knows eval only, and everything else knows sample only
    if _differ(pilot, record):
        raise SpecimenError("eval and sample disagree")
    return record


def _differ(pilot: Record, record: Record) -> bool:
    """Whether patches or totals of two records are further apart than they may be."""
    values, std_err = arrays(pilot)
    if _rms(values - arrays(record)[0]) > MAX_RMS_RATIO * _rms(std_err):
        return True
    for total in ("dhr", "dht") if pilot.has_lower else ("dhr",):
        a, b = getattr(pilot, total), getattr(record, total)
        error = np.hypot(*(getattr(r, f"{total}_std_err") for r in (pilot, record)))
        if np.any(np.abs(a - b) > MAX_STD_ERRS * np.hypot(error, SINGLE_PRECISION * a)):
            return True
    return False


def arrays(record: Record) -> tuple[Floats, Floats]:
    """BSDF and standard error, ``(n_hemispheres, n_theta, n_phi, channels)``.

    The standard error is 0 for a patch without a hit, and NaN for a single batch.
    """
    errors = patch_values(record, "brdf_std_err", "btdf_std_err")
    unknown = record.n_batches == 1 and record.provenance.rays
    std_err = np.nan_to_num(errors, nan=np.nan if unknown else 0.0)
    return patch_values(record, "brdf", "btdf"), std_err


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))

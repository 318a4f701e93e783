"""The measurements behind a chart: points of a method, and what is taken for true."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..array_types import Floats
from ..errors import SettingError, SpecimenError
from ..instrument.measurement import measure_whole
from ..results.record import Record
from .curves import Point, Reference

__all__ = ["FIRST_RAYS", "GROWTH", "Method", "Runs", "find_reference"]

# Rays of the first points, and of each further one in those of the one before.
FIRST_RAYS = 2**12
GROWTH = 4
MOST_RAYS = 2**40

# Tolerances of integrals, as points of the estimator `quadrature`.
TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)

# Tolerance of the integral that is taken for true; the second if it is quick.
REFERENCE_ERRS = (1e-4, 1e-6)
QUICK = 0.05

# Rays from which the speed of a long reference run is foretold, and the part of the
# time that it gets.
PILOT_RAYS = 2**18
REFERENCE_SHARE = 0.5

# Relative error of what Mitsuba computes, in single precision.
SINGLE_PRECISION = 1e-6

# A root mean square of this many times what error bars promise is no accident.
TOO_FAR = 3.0
# For a single value, that may be by chance.
FAR_OFF = 5.0

EVEN = {"estimator": "weighted", "sampler": "sobol"}


@dataclass(frozen=True)
class Method:
    """An estimator and a sampler; no sampler for integrals without rays."""

    estimator: str
    sampler: str

    @property
    def settings(self) -> dict[str, str]:
        """Arguments of :func:`gonio_mi.measure`."""
        settings = {"estimator": self.estimator, "sampler": self.sampler}
        return {name: word for name, word in settings.items() if word}

    def effort(self, level: int) -> Any:
        """Rays, or tolerance, of the `level`-th point; None after the last."""
        if not self.sampler:
            return {"rel_err": TOLERANCES[level]} if level < len(TOLERANCES) else None
        rays = FIRST_RAYS * GROWTH**level
        return {"rays": rays} if rays <= MOST_RAYS else None


@dataclass(frozen=True)
class Runs:
    """Measurements of one specimen that differ in method, effort and seed."""

    scene: object
    settings: dict[str, Any]
    seed: int
    repeats: int

    def measure(self, seed: int, **settings: Any) -> Record:
        """Record of one measurement; seed 0 is for the reference and first runs."""
        return measure_whole(
            self.scene, seed=self.seed + seed, **{**self.settings, **settings}
        )

    def warm_up(self, method: Method) -> None:
        """Run a method once, so that its kernels are there."""
        self.measure(0, **method.settings, **method.effort(0))

    def point(self, method: Method, level: int, reference: Reference) -> Point:
        """:class:`.curves.Point` of a method at its `level`-th effort."""
        effort = method.effort(level)
        seconds, squares, claims = [], [], []
        for number in range(self.repeats):
            before = time.process_time()
            record = self.measure(
                1 + level * self.repeats + number, **method.settings, **effort
            )
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
    runs.measure(0, rays=FIRST_RAYS, **EVEN)
    started = time.perf_counter()
    pilot = runs.measure(0, rays=PILOT_RAYS, **EVEN)
    rate = PILOT_RAYS / (time.perf_counter() - started)
    if len(pilot) > 1:
        raise SettingError(
            f"theta_i and phi_i must be one incident direction, got {len(pilot)}"
        )
    rays = max(PILOT_RAYS, int(rate * seconds * REFERENCE_SHARE))
    refused = ""
    try:
        record = _integral(runs, pilot, rays, seconds)
        integrates = "delta" if record.ledger.emitted else "flat"
        words = f"quadrature to {record.settings['rel_err']:g}"
        if integrates == "delta":
            words += f", {rays:.2g} rays for delta lobes"
    except SpecimenError as error:
        record = runs.measure(0, rays=rays, **EVEN)
        integrates, refused = "", str(error)
        words = f"{rays:.2g} rays, weighted, sobol"
    return pilot, _reference(record, words, refused), integrates


def _reference(record: Record, source: str, refused: str) -> Reference:
    """:class:`gonio_mi.charts.curves.Reference` from a record."""
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
        if time.perf_counter() - started > QUICK * seconds:
            break
    # the integral knows eval only, and everything else knows sample only
    if _differ(pilot, record):
        raise SpecimenError("eval is not what sample sends")
    return record


def _differ(pilot: Record, record: Record) -> bool:
    """Whether patches or totals of two records are further apart than they may be."""
    values, std_err = arrays(pilot)
    if _rms(values - arrays(record)[0]) > TOO_FAR * _rms(std_err):
        return True
    for total in ("dhr", "dht") if pilot.has_lower else ("dhr",):
        a, b = getattr(pilot, total), getattr(record, total)
        error = np.hypot(*(getattr(r, f"{total}_std_err") for r in (pilot, record)))
        if np.any(np.abs(a - b) > FAR_OFF * np.hypot(error, SINGLE_PRECISION * a)):
            return True
    return False


def arrays(record: Record) -> tuple[Floats, Floats]:
    """BSDF and standard error, ``(n_hemispheres, n_theta, n_phi, channels)``.

    The standard error is 0 for a patch without a hit, and NaN for a single batch.
    """
    values: list[Any] = [record.brdf]
    errors: list[Any] = [record.brdf_std_err]
    if record.has_lower:
        values.append(record.btdf)
        errors.append(record.btdf_std_err)
    unknown = record.n_batches == 1 and record.settings["rays"] > 0
    std_err = np.nan_to_num(np.stack(errors), nan=np.nan if unknown else 0.0)
    return np.stack(values), std_err


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))

"""Speed against accuracy for a specimen: every method at rising numbers of rays."""

import time
import warnings
from dataclasses import dataclass

import mitsuba as mi
import numpy as np
from tqdm import tqdm

from .curves import Chart, Curve, Point, Reference
from .errors import SpecimenError, checked_count, checked_number
from .goniophotometer import measure
from .plugins.specimen import Specimen
from .quadrature import integrate
from .specimen import load_specimen, specimen_name

__all__ = ["ESTIMATORS", "SAMPLERS", "chart"]

ESTIMATORS = ("analog", "weighted")
SAMPLERS = ("independent", "sobol")

# Rays of the first points, and of each further one in those of the one before.
FIRST_RAYS = 2**12
GROWTH = 4
MOST_RAYS = 2**40

# Rays from which the speed of a long reference run is foretold, and the part of the
# time that it gets.
PILOT_RAYS = 2**18
REFERENCE_SHARE = 0.5

# Relative error of what Mitsuba computes, in single precision.
SINGLE_PRECISION = 1e-6

# A deviation of this many times what error bars promise is no accident.
TOO_FAR = 3.0


def chart(
    specimen,
    theta_i=None,
    phi_i=0.0,
    *,
    estimators=ESTIMATORS,
    samplers=SAMPLERS,
    seconds=60,
    repeats=4,
    seed=0,
    parameters=None,
    progress=False,
    **settings,
):
    """Measure a specimen by every method, at rising numbers of rays.

    The error is the root mean square over all patches, as in the paper's Table 1, here
    relative to the mean BSDF: counting independent rays gives the same error on all
    specimens of the same reflectance. The truth is the converged integral of ``eval``
    for flat specimens without delta components, else a run with the sampler ``sobol``
    that takes half of the time.

    The cost is the CPU time of the process, all threads together, of whole calls of
    :func:`gonio_mi.measure` on a loaded scene. Each method is run once before, so that
    no kernel is compiled in it.

    Parameters
    ----------
    specimen, theta_i, phi_i, parameters
        As for :func:`gonio_mi.measure`, of one incident direction.
    estimators, samplers : sequence of str
        Every pair of them is a method.
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
            raise ValueError(f"{name} must be a sequence of names, got {words!r}")
    scene = load_specimen(specimen, parameters)
    runs = _Runs(scene, {"theta_i": theta_i, "phi_i": phi_i, **settings}, seed, repeats)
    with _Clock(seconds, progress) as clock:
        pilot, reference = _reference(runs, clock)
        curves = _curves(runs, clock, reference, estimators, samplers)
    result = Chart(
        specimen=specimen_name(specimen, parameters),
        theta_i=float(pilot.theta_i[0]),
        phi_i=float(pilot.phi_i[0]),
        collector=str(pilot.subdivision),
        curves=curves,
        reference=reference,
        independent=_independent(pilot.subdivision, reference),
        settings={
            "side": pilot.settings["side"],
            "transport": pilot.settings["transport"],
            "batches": pilot.n_batches,
            "repeats": repeats,
            "seed": seed,
            "variant": mi.variant(),
        },
    )
    _warn_of_reference(result)
    return result


@dataclass(frozen=True)
class _Runs:
    """Measurements of one specimen that differ in method, rays and seed."""

    scene: object
    settings: dict
    seed: int
    repeats: int

    def measure(self, method, rays, seed):
        """Record of one measurement."""
        return measure(
            self.scene, rays=rays, seed=self.seed + seed, **self.settings, **method
        )

    def point(self, method, level, reference):
        """:class:`Point` of a method at the `level`-th number of rays."""
        rays = FIRST_RAYS * GROWTH**level
        seconds, squares, claims = [], [], []
        for number in range(self.repeats):
            before = time.process_time()
            # seed 0 is that of the reference
            record = self.measure(method, rays, 1 + level * self.repeats + number)
            seconds.append(time.process_time() - before)
            values, std_err = _map(record)
            squares.append(np.mean((values - reference.values) ** 2))
            claims.append(np.mean(std_err**2))
        error = np.sqrt(np.mean(squares))
        scatter = np.std(squares, ddof=1) / np.sqrt(self.repeats)
        return Point(
            rays,
            float(np.median(seconds)),
            float(error / reference.mean),
            float(scatter / (2 * error) / reference.mean) if error else 0.0,
            float(np.sqrt(np.mean(claims)) / reference.mean),
        )


class _Clock(tqdm):
    """Progress bar in seconds, with the time that is left."""

    def __init__(self, seconds, shown):
        self.seconds = seconds
        self.started = time.perf_counter()
        super().__init__(
            total=round(seconds),
            disable=not shown,
            leave=False,
            bar_format="{desc}: {bar} {n_fmt} of {total_fmt} s",
        )

    @property
    def left(self):
        """Seconds that are left."""
        return self.started + self.seconds - time.perf_counter()

    def show(self, words):
        """Say what is being done."""
        self.set_description_str(words, refresh=False)
        self.n = min(round(self.seconds - self.left), self.total)
        self.refresh()


# ------------------------------------------------------------------ points


def _curves(runs, clock, reference, estimators, samplers):
    """Curve of each method; all of them grow level by level while there is time."""
    methods = [
        {"estimator": estimator, "sampler": sampler}
        for estimator in dict.fromkeys(estimators)
        for sampler in dict.fromkeys(samplers)
    ]
    points = [[] for _ in methods]
    spent = [[0.0] for _ in methods]  # seconds of each level
    growing = list(range(len(methods)))
    for method in methods:
        clock.show("compiling")
        runs.measure(method, FIRST_RAYS, 0)
    level = 0
    while growing and FIRST_RAYS * GROWTH**level <= MOST_RAYS:
        for m in growing:
            clock.show(f"{' '.join(methods[m].values())}, level {level}")
            started = time.perf_counter()
            points[m].append(runs.point(methods[m], level, reference))
            spent[m].append(time.perf_counter() - started)
        level += 1
        # the dearest ones are left behind
        growing.sort(key=lambda m: _next(spent[m]))
        while growing and sum(_next(spent[m]) for m in growing) > clock.left:
            growing.pop()
    return tuple(
        Curve(method["estimator"], method["sampler"], tuple(of_method))
        for method, of_method in zip(methods, points)
    )


def _next(spent):
    """Seconds of the next level: a fixed part, and one that grows with the rays."""
    return spent[-1] + GROWTH * max(spent[-1] - spent[-2], 0)


# ------------------------------------------------------------------ the truth


def _reference(runs, clock):
    """A first record of the specimen, and the :class:`Reference`."""
    clock.show("reference")
    even = {"sampler": "sobol", "estimator": "weighted"}
    runs.measure(even, FIRST_RAYS, 0)
    started = time.perf_counter()
    pilot = runs.measure(even, PILOT_RAYS, 0)
    rate = PILOT_RAYS / (time.perf_counter() - started)
    if len(pilot) > 1:
        raise ValueError(
            f"theta_i and phi_i must be one incident direction, got {len(pilot)}"
        )
    try:
        return pilot, _integral(runs.scene, pilot)
    except SpecimenError as error:
        reason = str(error)
    rays = max(PILOT_RAYS, int(rate * clock.left * REFERENCE_SHARE))
    record = runs.measure(even, rays, 0)
    values, std_err = _map(record)
    mean = _mean(record.subdivision, values)
    source = f"{rays:.2g} rays of weighted, sobol ({reason})"
    return pilot, Reference(values, _rms(std_err) / mean, mean, source)


def _integral(scene, pilot):
    """Converged integrals, or :class:`SpecimenError` that says why there are none."""
    specimen = Specimen(scene)
    if specimen.plane is None:
        raise SpecimenError("the specimen is not flat")
    if mi.is_spectral or np.isnan(pilot.theta_i[0]):
        raise SpecimenError("wavelengths and emitters of finite size are sampled")
    bsdf = specimen.plane.bsdf
    if mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta):
        raise SpecimenError("the BSDF has delta components")
    grid = pilot.subdivision
    angles = float(pilot.theta_i[0]), float(pilot.phi_i[0])
    found = integrate(bsdf, *angles, grid, side=pilot.settings["side"])
    hemispheres = slice(1 + pilot.has_lower)
    channels = slice(len(pilot.channels))
    values = found.values[hemispheres, ..., channels]
    sampled, std_err = _map(pilot)
    if _rms(sampled - values) > TOO_FAR * _rms(std_err):
        raise SpecimenError("eval over the middle is not what sample sends")
    error = (found.error / grid.projected_solid_angles[..., None])[
        hemispheres, ..., channels
    ]
    mean = _mean(grid, values)
    return Reference(
        values,
        float(np.hypot(_rms(error), SINGLE_PRECISION * _rms(values)) / mean),
        mean,
        f"integral of eval, {found.n_evaluations:.2g} evaluations",
    )


def _independent(grid, reference):
    """Expected relative error of one counted independent ray."""
    from .reference_cases import rms_expectation  # imports SciPy's statistics, slow

    p = reference.values * grid.projected_solid_angles[..., None]
    square, _ = rms_expectation(grid, np.moveaxis(p, -1, 0), 1)
    return float(np.sqrt(square) / reference.mean)


def _warn_of_reference(result):
    """Say so if the last points are further from the reference than they claim."""
    for curve in result.curves:
        last = curve.points[-1]
        if last.error > max(TOO_FAR * last.claimed, result.least):
            warnings.warn(
                f"{curve.label}: {last.rays:.2g} rays are off the reference by "
                f"{last.error:.2g}, and their error bars say {last.claimed:.2g}",
                RuntimeWarning,
                stacklevel=3,
            )


def _map(record):
    """BSDF and standard error, ``(n_hemispheres, n_theta, n_phi, channels)``.

    The standard error is 0 for a patch without a hit.
    """
    values, std_err = [record.brdf], [record.brdf_std_err]
    if record.has_lower:
        values.append(record.btdf)
        std_err.append(record.btdf_std_err)
    unknown = np.nan if record.n_batches == 1 else 0.0
    return np.stack(values), np.nan_to_num(np.stack(std_err), nan=unknown)


def _mean(grid, values):
    """Mean over all patches by projected solid angle, and over the channels."""
    weights = np.broadcast_to(grid.projected_solid_angles[..., None], values.shape)
    mean = float(np.average(values, weights=weights))
    if not mean > 0:
        raise SpecimenError("the specimen must send some light to the collector")
    return mean


def _rms(values):
    return float(np.sqrt(np.mean(np.square(values))))

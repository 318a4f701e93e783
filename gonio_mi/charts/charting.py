"""Speed against accuracy for a specimen: every method at rising numbers of rays."""

import time
import warnings
from collections.abc import Sequence
from typing import Any

import mitsuba as mi
import numpy as np
from tqdm import tqdm

from ..collector.hemisphere import Subdivision
from ..errors import SettingError, SpecimenError, checked_count, checked_number, shown
from ..instrument.loading import load_specimen, specimen_name
from ..results.ray_bounds import rms_expectation
from ..transport.kernels import launches_kernels
from .curves import Chart, Curve, Point, Reference
from .runs import GROWTH, TOO_FAR, Method, Runs, find_reference

__all__ = ["ESTIMATORS", "SAMPLERS", "chart"]

NEEDS_GEOMETRY = "the estimator next_event needs geometry, got a flat rectangle"

ESTIMATORS = ("analog", "weighted", "quadrature", "next_event")
SAMPLERS = ("independent", "sobol")


@launches_kernels()
def chart(
    specimen: Any,
    theta_i: Any = None,
    phi_i: Any = 0.0,
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
        flat = pilot.settings["transport"] == "plane"
        if flat or "media" in pilot.settings:
            estimators = [name for name in estimators if name != "next_event"]
        methods = _methods(estimators, samplers, integrates)
        if not methods:
            raise SpecimenError(reference.refused or NEEDS_GEOMETRY)
        curves = _curves(runs, clock, reference, methods)
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
        runs.warm_up(method)
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


def _independent(patches: Subdivision, reference: Reference) -> float:
    """Expected relative error of one counted independent ray."""
    p = reference.values * patches.projected_solid_angles[..., None]
    square, _ = rms_expectation(patches, np.moveaxis(p, -1, 0), 1)
    return float(np.sqrt(square) / reference.mean)


def _warn_of_reference(result: Chart) -> None:
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

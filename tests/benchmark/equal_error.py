"""What a map of a given error costs: CPU seconds for each incident direction."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import mitsuba as mi
import numpy as np

from gonio_mi.array_types import Floats
from gonio_mi.collector import EqualProjectedSolidAngle, Subdivision
from gonio_mi.collector.directions import direction
from gonio_mi.quadrature import integrate

from . import groove
from .baselines import (
    PATCHES,
    THETA_I,
    Baseline,
    chi2_rays,
    gonio_rays,
    patch_integrals,
    without_renderer,
)
from .renderers import (
    KLEMS,
    RADIANCE_GROOVE,
    RADIANCE_PLATE,
    path_directions,
    path_samples,
    radiance_genbsdf,
)
from .table import print_table
from .timing import cpu_seconds, in_turns

Contests = dict[str, list[tuple[Baseline, Floats]]]

WHITE = {"type": "diffuse", "reflectance": 1.0}
CONDUCTOR = {"type": "roughconductor", "alpha": 0.2, "distribution": "ggx"}
COARSE = EqualProjectedSolidAngle(12, 12)

# Seeds whose squared errors are averaged, of methods that have a seed.
SEEDS = 2


# -------------------------------------------------------------------------- contests


def contests() -> tuple[Contests, list[str]]:
    """All comparisons that can run here, of :class:`Baseline` with their exact flux.

    Returns
    -------
    contests : dict of str to list of (Baseline, ndarray)
        The first of each list is our default.
    absent : list of str
        One sentence for each that is left out.
    """
    lambert = PATCHES.projected_solid_angles / np.pi
    # a renderer's scene: the instrument's own copy of it would be one mesh
    walls = mi.load_dict({"type": "scene", **groove.walls()}, optimize=False)
    lit = direction(np.radians([THETA_I]), np.zeros(1))
    conductor = integrate(mi.load_dict(CONDUCTOR), THETA_I, 0, PATCHES).flux[0, ..., 0]
    fine, coarse = (_groove_flux(lit, g).reshape(g.shape) for g in (PATCHES, COARSE))
    histogram = chi2_rays(WHITE)
    others, absent = without_renderer()
    found: Contests = {
        "white plate, 900 patches": [
            *((baseline, lambert) for baseline in _ours(WHITE)),
            (patch_integrals(WHITE), lambert),
            (path_directions(WHITE), lambert),
            (histogram, histogram.subdivision.projected_solid_angles / np.pi),
            *((baseline, lambert) for baseline in others),
        ],
        "rough conductor, 900 patches": [
            *((baseline, conductor) for baseline in _ours(CONDUCTOR)),
            (patch_integrals(CONDUCTOR), conductor),
            (path_directions(CONDUCTOR), conductor),
        ],
        "diffuse V-groove, 900 patches": [
            (baseline, fine)
            for baseline in (
                *_ours(walls, footprint="full"),
                *_deposits(walls, PATCHES),
                path_samples(groove.walls, 1),
                path_samples(groove.walls, 2),
                path_samples(groove.walls, 1, "multijitter"),
            )
        ],
        "white plate, 145 patches": [
            (baseline, COARSE.projected_solid_angles / np.pi)
            for baseline in _ours(WHITE, subdivision=COARSE)
        ],
        "diffuse V-groove, 145 patches": [
            (baseline, coarse)
            for baseline in (
                *_ours(walls, subdivision=COARSE, footprint="full"),
                *_deposits(walls, COARSE),
            )
        ],
    }
    return found, absent + _add_radiance(found)


def _add_radiance(found: Contests) -> list[str]:
    """Add what Radiance offers; a sentence if it is left out."""
    try:
        plate = radiance_genbsdf(RADIANCE_PLATE, groove.REFLECTANCE)
        grooves = radiance_genbsdf(RADIANCE_GROOVE, groove.REFLECTANCE)
    except ImportError:
        return ["Radiance is left out: pip install '.[benchmark]'"]
    every = np.broadcast_to(KLEMS.projected_solid_angles / np.pi, (145, 145, 1))
    found["white plate, 145 patches"].append((plate, groove.REFLECTANCE * every))
    found["diffuse V-groove, 145 patches"].append((grooves, klems_groove_flux()))
    return []


def _ours(specimen: dict[str, Any], **settings: Any) -> list[Baseline]:
    """Our samplers, the default first; one batch has no error bars, as the others."""
    designs = (("sobol", 32), ("sobol", 8), ("sobol", 1), ("independent", 32))
    return [
        gonio_rays(specimen, "weighted", sampler, batches=batches, **settings)
        for sampler, batches in designs
    ]


def _deposits(specimen: dict[str, Any], patches: Subdivision) -> list[Baseline]:
    """Light sent to as many points as there are patches, at every event of few rays."""
    return [
        gonio_rays(
            specimen,
            "next_event",
            "sobol",
            batches=batches,
            subdivision=patches,
            footprint="full",
            points=patches.n_patches,
        )
        for batches in (32, 16, 8)
    ]


def _groove_flux(wi: Floats, patches: Subdivision) -> Floats:
    """Exact flux fractions of the V-groove, shape (len(wi), patches)."""
    points = patches.points(4)
    flux = groove.patch_means(wi, points)
    return flux * np.ravel(patches.projected_solid_angles)


def klems_groove_flux() -> Floats:
    """Exact flux fractions from each Klems patch into each, shape (145, 145, 1).

    Means over incident patches too; Radiance numbers them by the way light takes.
    """
    points = KLEMS.points(3) * [-1, -1, 1]
    flux = _groove_flux(points.reshape(-1, 3), KLEMS)
    return flux.reshape(145, -1, 145).mean(axis=1)[..., None]


# ------------------------------------------------------------------- error and cost


def error(baseline: Baseline, exact: Floats, size: int, seeds: int = SEEDS) -> float:
    """RMS error of the BRDF over the patches (and seeds), over its mean."""
    omega = baseline.subdivision.projected_solid_angles
    squares = [
        np.mean(((baseline.flux(size, seed) - exact) / omega) ** 2)
        for seed in range(seeds if baseline.random else 1)
    ]
    return np.sqrt(np.mean(squares)) / np.mean(exact / omega)


@dataclass(frozen=True)
class Found:
    """Size of a baseline that reaches an error.

    Attributes
    ----------
    size : int
        Largest that was run.
    error : float
        At that size.
    scale : float
        How many times as large it has to be: 1 unless extrapolated.
    """

    size: int
    error: float
    scale: float = 1.0


def search(baseline: Baseline, exact: Floats, target: float, limit: float) -> Found:
    """Find the size of a baseline whose error is at most `target`.

    By factors of four, then by three bisections. If one run takes more than `limit` CPU
    seconds before, the size is extrapolated by the power law of all errors so far.
    """
    sizes: list[int] = []
    errors: list[float] = []
    spent = 0.0
    while not errors or errors[-1] > target:
        if spent > limit:
            order = 0.5  # of independent samples
            if len(sizes) > 1:
                order = -np.polyfit(np.log(sizes), np.log(errors), 1)[0]
            scale = (errors[-1] / target) ** (1 / order)
            return Found(sizes[-1], errors[-1], float(scale))
        sizes.append(4 * sizes[-1] if sizes else baseline.first)
        start = cpu_seconds()
        errors.append(error(baseline, exact, sizes[-1]))
        spent = (cpu_seconds() - start) / (SEEDS if baseline.random else 1)
    low, high, reached = sizes[-1] // 4, sizes[-1], errors[-1]
    for _ in range(3):
        middle = round((low * high) ** 0.5)
        if not max(low, baseline.first) < middle < high:
            break
        tried = error(baseline, exact, middle)
        if tried <= target:
            high, reached = middle, tried
        else:
            low = middle
    return Found(high, reached)


def print_costs(target: float, repeats: int, limit: float) -> None:
    """Print what a map of the relative RMS error `target` costs by each method."""
    print_contests(*contests(), target, repeats, limit)


def print_contests(
    found: Contests, absent: Sequence[str], target: float, repeats: int, limit: float
) -> None:
    """Print a table for each of some contests, and what is absent from them."""
    print(
        f"\nEqual error: {target:.2%} RMS over the patches, relative to the mean BRDF. "
        "CPU time for one\nincident direction, medians of "
        f"{repeats} runs in turns; ~ is extrapolated from the errors of\nsmaller runs, "
        "the largest of which is shown."
    )
    for contest, baselines in found.items():
        results = {r.name: search(r, exact, target, limit) for r, exact in baselines}
        times = in_turns(
            {r.name: partial(r.flux, results[r.name].size, 1) for r, _ in baselines},
            repeats,
        )
        costs = {
            r.name: times[r.name].cpu * results[r.name].scale / r.incident
            for r, _ in baselines
        }
        first = next(iter(costs.values()))
        print_table(
            contest,
            ("method", "size", "error", "CPU ms", "cost"),
            [
                _row(r, results[r.name], costs[r.name], costs[r.name] / first)
                for r, _ in baselines
            ],
        )
    for sentence in absent:
        print(sentence)


def _row(
    baseline: Baseline, found: Found, cost: float, ratio: float
) -> tuple[str, ...]:
    mark = "~" if found.scale > 1 else ""
    return (
        baseline.name,
        f"{found.size:g} {baseline.size}",
        f"{found.error:.2%}",
        f"{mark}{1e3 * cost:.3g}",
        f"{mark}{ratio:.2g}",
    )

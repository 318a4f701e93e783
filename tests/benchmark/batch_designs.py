"""How many Sobol' rays, and how much time, give the error of many independent rays."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import mitsuba as mi
import numpy as np

from gonio_mi.array_types import Floats
from gonio_mi.campaigns.measure import measure
from gonio_mi.quadrature import integrate

from .baselines import PATCHES
from .table import print_table
from .timing import in_turns

# The paper's materials and its angles, then stock BSDFs of Mitsuba.
MATERIALS: dict[str, tuple[dict[str, Any], float]] = {
    "diffuse": ({"type": "diffuse", "reflectance": 1.0}, 45),
    "specular (cosinelobe)": ({"type": "cosinelobe", "exponent": 16.0}, 30),
    "glossy (glossymixture)": ({"type": "glossymixture"}, 30),
    "anisotropic (anisotropicphong)": ({"type": "anisotropicphong"}, 30),
    "roughconductor 0.2": ({"type": "roughconductor", "alpha": 0.2}, 45),
    "roughplastic 0.2": ({"type": "roughplastic", "alpha": 0.2}, 45),
    "principled": ({"type": "principled", "roughness": 0.3, "specular": 0.5}, 45),
    "roughdielectric 0.3": ({"type": "roughdielectric", "alpha": 0.3}, 45),
}

# One scrambling has no error bars.
BATCHES = (32, 16, 8, 1)

# Independent rays from which the error of any number of them is known: 1 / sqrt(rays).
PILOT_RAYS = 2**21


def measured(
    material: str, sampler: str, batches: int, rays: float, *, seed: int = 0
) -> Floats:
    """BRDF and BTDF of one of the `MATERIALS`, shape (2, 30, 30, 1)."""
    specimen, theta_i = MATERIALS[material]
    how: dict[str, Any] = {"collector": PATCHES, "hemispheres": "both"}
    how |= {"footprint": "point", "sampler": sampler, "batches": batches, "seed": seed}
    record: Any = measure(specimen, theta_i, rays=round(rays), **how)
    return np.stack([record.brdf, record.btdf])


def mean_squares(exact: Floats, seeds: int, *method: Any) -> Floats:
    """Mean squared errors over all patches, one for each seed, of :func:`measured`."""
    maps = (measured(*method, seed=seed) for seed in range(seeds))
    return np.array([np.mean((values - exact) ** 2) for values in maps])


@dataclass(frozen=True)
class Crossing:
    """Rays at which an error falls to a given one.

    Attributes
    ----------
    rays, std_err : float
        By a straight line between two measured errors, in logarithms; the standard
        error comes from the scatter over the seeds, of the given error too.
    """

    rays: float
    std_err: float


def crossing(goal: Floats, squares: Callable[[int], Floats]) -> Crossing:
    """Find where errors fall to that of `goal`.

    Parameters
    ----------
    goal : ndarray
        Mean squared errors of the goal, one for each seed.
    squares : callable
        ``squares(rays)`` gives those of a method, one for each seed.

    Returns
    -------
    Crossing
    """
    rays, previous = 2**14, None
    while (tried := squares(rays)).mean() > goal.mean():
        rays, previous = 2 * rays, tried
    if previous is None:
        raise ValueError(f"the goal must be beyond the first {rays} rays")
    slope = np.log2(previous.mean() / tried.mean())
    part = np.log2(previous.mean() / goal.mean()) / slope
    relative = [
        values.std(ddof=1) / values.mean() / len(values) ** 0.5
        for values in (previous, tried, goal)
    ]
    spread = np.hypot((1 - part) * relative[0], part * relative[1])
    found = rays / 2 * 2**part
    return Crossing(found, found * np.hypot(spread, relative[2]) / slope)


def print_ratios(rays: int, seeds: int, repeats: int) -> None:
    """Print the share of rays and of CPU time that `sobol` needs, by batch design."""
    print(
        f"\nWhat sobol needs for the RMS error of {rays:g} independent rays on\n"
        f"30 x 30 patches, {seeds} seeds; CPU time beside that of independent rays in\n"
        f"32 batches, medians of {repeats} runs in turns."
    )
    for name, (specimen, theta_i) in MATERIALS.items():
        exact = integrate(mi.load_dict(specimen), theta_i, 0, PATCHES).values
        pilot = mean_squares(exact, seeds, name, "independent", 32, PILOT_RAYS)
        goal = pilot * (PILOT_RAYS / rays)
        found = {
            b: crossing(goal, partial(mean_squares, exact, seeds, name, "sobol", b))
            for b in BATCHES
        }
        runs: dict[Any, Callable[[], Floats]] = {
            b: partial(measured, name, "sobol", b, found[b].rays) for b in BATCHES
        }
        runs["independent"] = partial(measured, name, "independent", 32, rays)
        times = in_turns(runs, repeats)
        print_table(
            name,
            ("sobol", "error [1/sr]", "rays", "1 / share of rays", "1 / share of CPU"),
            [
                (
                    f"{b} batches" if b > 1 else "1 batch, no error bars",
                    f"{goal.mean() ** 0.5:.2e}",
                    f"{f.rays:.3g} +- {f.std_err:.1g}",
                    f"{rays / f.rays:.0f} +- {rays * f.std_err / f.rays**2:.1g}",
                    f"{times['independent'].cpu / times[b].cpu:.0f}",
                )
                for b, f in found.items()
            ],
        )

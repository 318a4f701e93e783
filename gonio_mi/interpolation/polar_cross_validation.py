"""How lobes move between polar angles: tried where records are between two others."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Integers
from ..collector.directions import direction
from .azimuth_cross_validation import BENT, tried_indices
from .interpolated_bsdf import InterpolatedBSDF
from .interpolated_lobes import Way
from .lobes import MeasuredLobes

__all__ = ["best_ways"]

# Records that are predicted from their neighbours, at most, and the part of their
# radiance that is looked at: on the patches that have most of it, or some of these.
TRIALS, LOOKED_AT, MOST_PATCHES = 6, 0.99, 2**13

# Points per side of a patch.
N_POINTS = 4

# Of a refractive index: the part of it by which it may be wrong at first, and at last.
NEAR, FINELY = 0.05, {"xatol": 1e-3}


def best_ways(lobes: MeasuredLobes) -> list[Way]:
    """How lobes move between polar angles, as a record's own directions say.

    On a leg by quantiles (:class:`.QuantileTransport`), or with micro-normals that stay
    where these predict the nearest record better, as a camera sees it, from those of
    the next smaller and the next larger angle.
    """
    n_angles = len(lobes.grid.theta_i)
    if n_angles < 3:
        return []
    angles = np.unique(np.linspace(1, n_angles - 2, TRIALS).round().astype(int))
    trials = [_Trial(lobes, n / len(angles), k) for n, k in enumerate(angles.tolist())]
    ways = []
    for hemisphere in range(lobes.flux.shape[1]):
        eta = _index(lobes, trials) if hemisphere else None
        if hemisphere and eta is None:
            continue
        errors = [
            [one.error(hemisphere, keeps, eta) for one in trials]
            for keeps in (False, True)
        ]
        ways.append(Way(hemisphere, eta, _better(angles, *errors)))
    return [way for way in ways if any(way.legs)]


def _better(
    angles: Integers, by_quantiles: Sequence[float], by_normals: Sequence[float]
) -> tuple[bool, ...]:
    """On which legs micro-normals are better, where records nearest to it are tried.

    `angles` are the numbers of these records' polar angles.
    """
    gains = np.subtract(by_quantiles, by_normals)
    legs = []
    for leg in range(angles.max() + 1):
        distance = np.abs(angles - leg - 0.5)
        legs.append(bool(gains[distance == distance.min()].sum() > 0))
    return tuple(legs)


def _index(lobes: MeasuredLobes, trials: Sequence[_Trial]) -> float | None:
    """Refractive index of transmission that predicts a record best, or None.

    That of the ways between azimuths, if there is one.
    """
    grid = lobes.grid
    if grid.eta is not None:
        return grid.eta
    azimuth, angle = np.nonzero(grid.index >= 0)
    measured = zip(azimuth.tolist(), angle.tolist())
    brdf = [lobes.brdf([n], [k])[0, 0, 1].mean(axis=-1) for n, k in measured]
    light = np.array(brdf) * lobes.patches.projected_solid_angles
    incidents = grid.theta_i[angle], grid.phi_i[azimuth]
    tried = tried_indices(light, *incidents, lobes.patches)
    if not tried:
        return None
    error = partial(trials[len(trials) // 2].error, 1, True)
    best = min(tried, key=error)
    around = best * (1 - NEAR), best * (1 + NEAR)
    from scipy.optimize import minimize_scalar  # half a second, which no other needs

    found = minimize_scalar(error, bounds=around, method="bounded", options=FINELY)
    # so near to 1 that no light is bent, there is none to find
    finer = [float(found.x)] if abs(found.x - 1) > BENT else []
    return min([best, *finer], key=error)


class _Trial:
    """A record between two others of the same azimuth.

    Parameters
    ----------
    lobes : MeasuredLobes
    part : float
        Which of the azimuths: 0 for the first that were measured there, to 1.
    angle : int
        Number of its polar angle.
    """

    def __init__(self, lobes: MeasuredLobes, part: float, angle: int) -> None:
        grid = lobes.grid
        known = np.flatnonzero(grid.index[:, angle] >= 0)
        azimuth = int(known[int(part * len(known))])
        self.part = lobes.table([azimuth], [angle - 1, angle + 1])
        self.lobes = lobes.brdf([azimuth], [angle])[0, 0].mean(axis=-1)
        incident = grid.theta_i[angle], grid.phi_i[azimuth]
        self.wi = direction(*np.radians(incident))

    def error(self, hemisphere: int, keeps: bool, eta: float | None = None) -> float:
        """Light in wrong places as a camera sees it, on the patches looked at.

        If micro-normals are kept, or not; with the refractive index of transmission.
        By radiance: a diffuse part that moves with micro-normals is up to some times
        brighter near the horizon, where flux is too small to show it.
        """
        patches = self.part.patches
        light = (self.lobes[hemisphere] * patches.solid_angles).ravel()
        if not light.any():
            return 0.0
        order = np.argsort(-light, kind="stable")
        few = np.searchsorted(np.cumsum(light[order]), LOOKED_AT * light.sum())
        number = np.sort(order[: few + 1 : 1 + few // MOST_PATCHES])
        points = patches.points(N_POINTS, number)
        points[..., 2] *= -1 if hemisphere else 1
        wo = mi.Vector3f(np.ascontiguousarray(points.reshape(-1, 3).T))
        wi = mi.Vector3f(self.wi.tolist())
        dr.make_opaque(wi, wo)
        ways = [Way(hemisphere, eta, (True,))] if keeps else []
        values, _, wanted = InterpolatedBSDF(self.part, ways=ways).values(wi, wo)
        mean = dr.select(wanted, sum(values) / len(values), 0.0)
        means = dr.block_sum(mean, N_POINTS**2).numpy() / N_POINTS**2
        areas = patches.solid_angles.ravel()[number]
        return float(np.abs(means * areas - light[number]).sum())

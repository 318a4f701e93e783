"""Whether quantiles or half vectors transport lobes better between polar angles.

Cross-validated where a record lies between two others.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Integers
from ..collector.directions import direction
from .incident_grid import MIN_BENDING, tried_indices
from .interpolated_bsdf import InterpolatedBSDF
from .interpolated_lobes import HalfVectorLegs
from .lobes import MeasuredLobes

# Records that are predicted from their neighbours, at most, and the part of their
# radiance that is looked at: on the patches that have most of it, or some of these.
MAX_TRIALS, RADIANCE_LOOKED_AT, MAX_PATCHES = 6, 0.99, 2**13

# Points per side of a patch.
N_POINTS = 4

# Of a refractive index: the part of it by which it may be wrong at first, and at last.
INDEX_MARGIN, INDEX_OPTIONS = 0.05, {"xatol": 1e-3}


def half_vector_legs(lobes: MeasuredLobes) -> list[HalfVectorLegs]:
    """How lobes move between polar angles, as a record's own directions say.

    On a leg by quantiles (:class:`.QuantileTransport`), or with micro-normals that stay
    where these predict the nearest record better, as a camera sees it, from those of
    the next smaller and the next larger angle.
    """
    n_angles = len(lobes.grid.theta_i)
    if n_angles < 3:
        return []
    angles = np.unique(np.linspace(1, n_angles - 2, MAX_TRIALS).round().astype(int))
    trials = [_Trial(lobes, n / len(angles), k) for n, k in enumerate(angles.tolist())]
    found = []
    for hemisphere in range(lobes.flux.shape[1]):
        eta = _index(lobes, trials) if hemisphere else None
        if hemisphere and eta is None:
            continue
        by_normals = [HalfVectorLegs(hemisphere, eta, (True,))]
        legs = _better(
            angles,
            [one.error(hemisphere, []) for one in trials],
            [one.error(hemisphere, by_normals) for one in trials],
        )
        found.append(HalfVectorLegs(hemisphere, eta, legs))
    return [one for one in found if any(one.legs)]


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

    That of transmission between azimuths, if there is one.
    """
    grid = lobes.grid
    if grid.eta is not None:
        return grid.eta
    azimuth, angle = np.nonzero(grid.index >= 0)
    measured = zip(azimuth.tolist(), angle.tolist())
    brdf = [lobes.brdf([n], [k])[0, 0, 1].mean(axis=-1) for n, k in measured]
    flux = np.array(brdf) * lobes.patches.projected_solid_angles
    incidents = grid.theta_i[angle], grid.phi_i[azimuth]
    tried = tried_indices(flux, *incidents, lobes.patches)
    if not tried:
        return None
    middle = trials[len(trials) // 2]

    def error(eta: float) -> float:
        return middle.error(1, [HalfVectorLegs(1, eta, (True,))])

    best = min(tried, key=error)
    around = best * (1 - INDEX_MARGIN), best * (1 + INDEX_MARGIN)
    from scipy.optimize import minimize_scalar  # half a second, which no other needs

    found = minimize_scalar(
        error, bounds=around, method="bounded", options=INDEX_OPTIONS
    )
    # so near to 1 that nothing is refracted, there is none to find
    finer = [float(found.x)] if abs(found.x - 1) > MIN_BENDING else []
    return min([best, *finer], key=error)


class _Trial:
    """A record between two others of the same azimuth.

    Parameters
    ----------
    lobes : MeasuredLobes
    position : float
        Which of the azimuths: 0 for the first that were measured there, to 1.
    angle : int
        Number of its polar angle.
    """

    def __init__(self, lobes: MeasuredLobes, position: float, angle: int) -> None:
        grid = lobes.grid
        known = np.flatnonzero(grid.index[:, angle] >= 0)
        azimuth = int(known[int(position * len(known))])
        self.table = lobes.table([azimuth], [angle - 1, angle + 1])
        self.lobes = lobes.brdf([azimuth], [angle])[0, 0].mean(axis=-1)
        incident = grid.theta_i[angle], grid.phi_i[azimuth]
        self.wi = direction(*np.radians(incident))

    def error(self, hemisphere: int, half_vectors: Sequence[HalfVectorLegs]) -> float:
        """Sum of absolute errors of radiance over the patches looked at.

        With these `half_vectors`, else by quantiles. By radiance: a diffuse part that
        moves with micro-normals is up to some times brighter near the horizon, where
        flux is too small to show it.
        """
        patches = self.table.patches
        radiance = (self.lobes[hemisphere] * patches.solid_angles).ravel()
        if not radiance.any():
            return 0.0
        order = np.argsort(-radiance, kind="stable")
        needed = RADIANCE_LOOKED_AT * radiance.sum()
        few = np.searchsorted(np.cumsum(radiance[order]), needed)
        number = np.sort(order[: few + 1 : 1 + few // MAX_PATCHES])
        points = patches.points(N_POINTS, number)
        points[..., 2] *= -1 if hemisphere else 1
        wo = mi.Vector3f(np.ascontiguousarray(points.reshape(-1, 3).T))
        wi = mi.Vector3f(self.wi.tolist())
        dr.make_opaque(wi, wo)
        face = InterpolatedBSDF(self.table, half_vectors=half_vectors)
        values, _, wanted = face.values(wi, wo)
        mean = dr.select(wanted, sum(values) / len(values), 0.0)
        means = dr.block_sum(mean, N_POINTS**2).numpy() / N_POINTS**2
        areas = patches.solid_angles.ravel()[number]
        return float(np.abs(means * areas - radiance[number]).sum())

"""How lobes move between polar angles: tried where records are between two others."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.optimize import minimize_scalar

from ..array_types import Floats
from ..collector.directions import direction
from .azimuth_trials import tried_indices
from .lit_face import LitFace
from .lobes import LobeTable
from .moving_points import Ways

__all__ = ["best_face"]

# Records that are predicted from their neighbours, and the part of their light that is
# looked at: on the patches that have most of it.
TRIALS, LOOKED_AT = 3, 0.99

# Points per side of a patch.
N_POINTS = 4

# Of a refractive index: the part of it by which it may be wrong at first, and at last.
NEAR, FINELY = 0.05, {"xatol": 1e-3}


def best_face(table: LobeTable, wavelengths: Floats | None = None) -> LitFace:
    """Face whose lobes move between polar angles as its own records say.

    All of a hemisphere move alike: by quantiles (:class:`.moving_points.Legs`), or with
    micro-normals that stay where these predict records better, from those of the next
    smaller and the next larger angle.

    Parameters
    ----------
    table : LobeTable
    wavelengths : sequence of float, optional
        See :class:`.lit_face.LitFace`.
    """
    known = np.argwhere(table.grid.index[:, 1:-1] >= 0)
    chosen = np.unique(np.linspace(0, len(known) - 1, TRIALS, dtype=int))
    trials = [_Trial(table, *known[n]) for n in (chosen if len(known) else [])]
    ways = [
        way
        for hemisphere in range(table.brdf.shape[2] if trials else 0)
        for way in _best(table, hemisphere, trials)
    ]
    return LitFace(table, wavelengths, ways)


def _best(table: LobeTable, hemisphere: int, trials: Sequence[_Trial]) -> Ways:
    """Way of a hemisphere by micro-normals, if it is better than that by quantiles."""

    def error(way: Ways) -> float:
        return sum(one.error(hemisphere, way) for one in trials)

    eta = _index(table, trials) if hemisphere else None
    if hemisphere and eta is None:
        return []
    ways: list[Ways] = [[], [(hemisphere, eta)]]
    return min(ways, key=error)


def _index(table: LobeTable, trials: Sequence[_Trial]) -> float | None:
    """Refractive index of transmission that predicts a record best, or None.

    That of the ways between azimuths, if there is one.
    """
    if table.grid.eta is not None:
        return table.grid.eta
    areas = table.patches.projected_solid_angles
    theta_i, phi_i = np.meshgrid(table.grid.theta_i, table.grid.phi_i)
    light = table.brdf[:, :, 1].mean(axis=-1).reshape(-1, *areas.shape) * areas
    tried = tried_indices(light, theta_i.ravel(), phi_i.ravel(), table.patches)
    if not tried:
        return None
    middle = trials[len(trials) // 2]

    def error(eta: float) -> float:
        return middle.error(1, [(1, eta)])

    best = min(tried, key=error)
    around = best * (1 - NEAR), best * (1 + NEAR)
    found = minimize_scalar(error, bounds=around, method="bounded", options=FINELY)
    return min(best, float(found.x), key=error)


class _Trial:
    """A record between two others of the same azimuth.

    Parameters
    ----------
    table : LobeTable
    azimuth, before : int
        Number of its azimuth, and of the polar angle before its own.
    """

    def __init__(self, table: LobeTable, azimuth: int, before: int) -> None:
        self.part = table.part(azimuth, (before, before + 2))
        self.lobes = table.brdf[azimuth, before + 1].mean(axis=-1)
        angles = table.grid.theta_i[before + 1], table.grid.phi_i[azimuth]
        self.wi = direction(*np.radians(angles))

    def error(self, hemisphere: int, ways: Ways) -> float:
        """Light in wrong places, on the patches that are looked at."""
        patches = self.part.patches
        light = (self.lobes[hemisphere] * patches.projected_solid_angles).ravel()
        if not light.any():
            return 0.0
        order = np.argsort(-light, kind="stable")
        few = np.searchsorted(np.cumsum(light[order]), LOOKED_AT * light.sum())
        number = np.sort(order[: few + 1])
        points = patches.points(N_POINTS, number)
        points[..., 2] *= -1 if hemisphere else 1
        wo = mi.Vector3f(np.ascontiguousarray(points.reshape(-1, 3).T))
        wi = mi.Vector3f(self.wi.tolist())
        dr.make_opaque(wi, wo)
        values, _, wanted = LitFace(self.part, ways=ways).values(wi, wo)
        mean = dr.select(wanted, sum(values) / len(values), 0.0)
        means = dr.block_sum(mean, N_POINTS**2).numpy() / N_POINTS**2
        areas = patches.projected_solid_angles.ravel()[number]
        return float(np.abs(means * areas - light[number]).sum())

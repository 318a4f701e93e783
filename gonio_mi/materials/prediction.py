"""What a material predicts: flux fractions at any incident direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats, Integers
from ..collector.directions import direction
from ..mitsuba_compat import floats
from ..results.patch_means import PatchMeans
from ..results.record import Record
from .interpolation.interpolated_bsdf import InterpolatedBSDF, half_vector_segments
from .interpolation.lobes import MeasuredLobes

# Part of a tolerance that points may be spared for.
SPARED = 1 / 100

# Points of all patches together that cost less than the choice of those that matter.
MAX_FULL_POINTS = 2**20

# How many times fewer points on a side other patches get, and the part of their second
# differences that n points on a side may miss, times n: lobes are linear within patches
# and jump between them, by up to a fourth of it, and where is known to half a step.
POINT_REDUCTION, MISSED_FRACTION = 4, 1 / 8

# Tables of few lobes each that are kept for more directions between the same records.
MAX_CACHED = 64


class Prediction:
    """The material of a record, asked for flux fractions at any incident direction.

    Parameters
    ----------
    record : Record or PatchMeans
        A stack that `goniometric` takes.
    n_points : int
        Points per side of each patch, at which its mean is taken.
    spared : float
        Part of the light that may be in the wrong place because patches get four times
        fewer points per side, where lobes are dark or even; where patches are few, all
        get all points.
    """

    def __init__(
        self, record: Record | PatchMeans, n_points: int, spared: float = 0
    ) -> None:
        self.lobes = MeasuredLobes(record)
        self.half_vectors = half_vector_segments(self.lobes)
        self.subdivision = record.subdivision
        self.n_hemispheres = record.flux_fraction.shape[-4]
        self.n_points, self.spared = n_points, spared
        n_all = self.n_hemispheres * self.subdivision.n_patches
        self.sparing = spared > 0 and n_all * n_points**2 > MAX_FULL_POINTS
        self.n_first = n_points // POINT_REDUCTION if self.sparing else n_points
        self._face = lru_cache(MAX_CACHED)(self._between)
        self.every = np.arange(n_all)
        self.wo = self._points(self.every, self.n_first)

    @classmethod
    def within(cls, tolerance: float, record: Record | PatchMeans) -> Prediction:
        """Prediction as right as a `tolerance` of the light that leaves asks.

        The error of means over points is below a tenth of it where the collector
        resolves the lobes, and a hundredth of it is spared.
        """
        n_points = 8 if tolerance >= 0.005 else 16 if tolerance >= 0.001 else 32
        return cls(record, n_points, SPARED * tolerance)

    def flux(self, theta_i: float, phi_i: float) -> Floats:
        """Flux fractions, shape ``(n_hemispheres, n_theta, n_phi, channels)``.

        Parameters
        ----------
        theta_i, phi_i : float
            In degrees, from the normal of the lit face.
        """
        face = self.local_bsdf(theta_i, phi_i)
        towards = direction(np.radians(theta_i), np.radians(phi_i))
        wi = mi.Vector3f(towards.tolist())
        dr.make_opaque(wi)
        shape = self.n_hemispheres, *self.subdivision.shape, -1
        brdf = self._means(face, wi, self.wo, self.n_first)
        if self.sparing:
            number = self.every[self._rough(brdf.reshape(shape)).ravel()]
            if len(number):
                wo = self._points(number, self.n_points)
                brdf[number] = self._means(face, wi, wo, self.n_points)
        solid = self.subdivision.projected_solid_angles[..., None]
        flux: Floats = brdf.reshape(shape) * solid
        return flux

    def local_bsdf(self, theta_i: float, phi_i: float) -> InterpolatedBSDF:
        """The material, of what lies around a direction alone; the same there."""
        return self._face(*self.lobes.grid.around(theta_i, phi_i))

    def _points(self, number: Integers, n: int) -> mi.Vector3f:
        """Directions of ``n x n`` points in patches of both hemispheres."""
        lower, patch = np.divmod(number, self.subdivision.n_patches)
        points = self.subdivision.points(n, patch)
        points[..., 2] *= np.where(lower, -1, 1)[:, None]
        return mi.Vector3f(*map(floats, points.reshape(-1, 3).T))

    def _between(
        self, azimuths: Sequence[int], angles: Sequence[int]
    ) -> InterpolatedBSDF:
        half_vectors = [
            replace(one, segments=(True,))
            for one in self.half_vectors
            if one.segments[angles[0]]
        ]
        return InterpolatedBSDF(
            self.lobes.table(azimuths, angles), half_vectors=half_vectors
        )

    def _means(
        self, face: InterpolatedBSDF, wi: mi.Vector3f, wo: mi.Vector3f, n: int
    ) -> Floats:
        """Means over ``n x n`` points each, a column for each channel."""
        values, _, wanted = face.values(wi, wo)
        lit = [mi.Float64(dr.select(wanted, value, 0.0)) for value in values]
        sums = [dr.block_sum(value, n * n) for value in lit]
        dr.eval(sums)
        return np.stack([one.numpy() for one in sums], axis=-1) / (n * n)

    def _rough(self, brdf: Floats) -> Flags:
        """Patches whose means few points may miss: of the others all are spared."""
        solid = self.subdivision.projected_solid_angles[..., None]
        inner = np.diff(brdf, axis=1, prepend=brdf[:, :1], append=brdf[:, -1:])
        second = np.abs(np.diff(inner, axis=1))
        around = np.roll(brdf, 1, axis=2) + np.roll(brdf, -1, axis=2) - 2 * brdf
        missed = ((second + np.abs(around)) * solid).sum(axis=-1)
        missed *= MISSED_FRACTION / self.n_first
        order = np.sort(missed, axis=None)
        allowed = self.spared * (brdf * solid).sum()
        spared = np.searchsorted(np.cumsum(order), allowed)
        return missed >= order[spared] if spared < len(order) else missed < 0

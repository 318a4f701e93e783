"""Interpolation between values of scattered directions, and where there are none."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CloughTocher2DInterpolator
from scipy.spatial import Delaunay, QhullError, cKDTree

from ...array_types import Flags, Floats, Integers
from ...collector.directions import angles
from .points import Points

# Decimals of unit vectors that tell directions apart.
DIGITS = 7

# Longest side of a triangle between neighbours, in units of how far apart the
# directions at its corners usually are: a single missing direction of a grid leaves
# sides of 2.83.
MAX_SIDE = 2.9

# Values at the corners of a triangle that differ by more than this factor, beyond so
# many standard errors, resolve no lobe: within it anything between them may be.
MAX_RATIO, MAX_STD_ERRS = 3.0, 3.0


class Interpolation:
    """Triangles of directions of one hemisphere, in a map that keeps polar angles.

    Of a grid of polar angles and azimuths neighbours along a ring may be many times as
    far apart as along a meridian, or the other way round: a direction's usual distance
    is that of its third nearest neighbour in the triangulation (Delaunay's).

    Parameters
    ----------
    wo : ndarray, shape (n, 3)
        Unit vectors with z > 0.
    points : Points
    half_angle : float
        Of the cone about each direction for which its value stands, in radians; 0 for
        the direction alone.
    """

    def __init__(self, wo: Floats, points: Points, half_angle: float = 0.0) -> None:
        keys, self._number = np.unique(
            np.round(wo, DIGITS), axis=0, return_inverse=True
        )
        self._number = self._number.ravel()
        self._repeats = np.bincount(self._number)
        self._tree = cKDTree(keys)
        self._reach = 2 * np.sin(half_angle / 2) + 10.0**-DIGITS
        self._mean = np.bincount(self._number, points.value) / self._repeats
        try:
            self._triangles: Delaunay | None = Delaunay(_plane(keys))
        except (QhullError, ValueError):  # all in one plane, or fewer than three
            self._triangles = None
            return
        corners = self._triangles.simplices
        ends = keys[corners]
        sides = np.linalg.norm(ends - np.roll(ends, 1, axis=1), axis=-1)
        usual = _usual_distance(corners, sides, len(keys))
        most = MAX_SIDE * usual[corners].max(axis=1)
        self._fine = sides.max(axis=1) <= most
        each = self._mean[corners]
        noise = np.bincount(self._number, points.std_err**2) / self._repeats**2
        margin = MAX_STD_ERRS * np.sqrt(noise)[corners]
        low, high = (each + margin).min(axis=1), (each - margin).max(axis=1)
        steep = high > MAX_RATIO * np.maximum(low, 0)
        self._half_range = np.where(steep, np.ptp(each, axis=1) / 2, 0.0)
        self._smooth = CloughTocher2DInterpolator(self._triangles, self._mean)

    @property
    def is_flat(self) -> bool:
        """Whether all directions lie in one plane, so that none is between them."""
        return self._triangles is None

    def covers(self, wo: Floats) -> Flags:
        """Whether directions, shape (m, 3), lie between neighbours or in a cone."""
        near = self._tree.query(wo)[0] <= self._reach
        if self._triangles is None:
            return np.asarray(near)
        inside = self._triangles.find_simplex(_plane(wo))
        return near | ((inside >= 0) & self._fine[inside])

    def weights(self, wo: Floats, weight: Floats) -> Floats:
        """Weights of the values, shape (n,), in a sum of linear interpolations.

        Beyond all triangles the nearest value counts.
        """
        corner, part = self._corners(wo)
        each = np.bincount(
            corner.ravel(), (part * weight[:, None]).ravel(), len(self._repeats)
        )
        return np.asarray((each / self._repeats)[self._number])

    def values(self, wo: Floats) -> Floats:
        """Smooth interpolation at directions, with cubic triangles; else the nearest.

        After Clough and Tocher (Alfeld 1984, Computer Aided Geometric Design 1, 169).
        """
        nearest = self._mean[self._tree.query(wo)[1]]
        if self._triangles is None:
            return np.asarray(nearest)
        smooth = self._smooth(_plane(wo))
        return np.where(np.isnan(smooth), nearest, smooth)

    def unresolved(self, wo: Floats, weight: Floats) -> float:
        """Bound of a weighted sum where the table resolves no lobe."""
        if self._triangles is None:
            return 0.0
        inside = self._triangles.find_simplex(_plane(wo))
        n = len(self._half_range)
        net = np.bincount(inside[inside >= 0], weight[inside >= 0], n)
        return float(np.abs(net) @ self._half_range)

    def nearest(self, wo: Floats, weight: Floats) -> float:
        """Light of a weighted sum of the nearest values, whatever its signs."""
        net = np.bincount(self._tree.query(wo)[1], weight, len(self._mean))
        return float(np.abs(net * self._mean).sum())

    def _corners(self, wo: Floats) -> tuple[Integers, Floats]:
        """Directions between which others lie, and barycentric coordinates."""
        near = np.repeat(self._tree.query(wo)[1][:, None], 3, axis=1)
        part = np.tile([1.0, 0.0, 0.0], (len(wo), 1))
        if self._triangles is None:
            return near, part
        plane = _plane(wo)
        inside = self._triangles.find_simplex(plane)
        found = inside >= 0
        to = self._triangles.transform[inside[found]]
        first = np.einsum("kij,kj->ki", to[:, :2], plane[found] - to[:, 2])
        part[found] = np.column_stack([first, 1 - first.sum(axis=1)])
        near[found] = self._triangles.simplices[inside[found]]
        return near, part


def _plane(wo: Floats) -> Floats:
    """Directions in a plane, at their polar angles from the origin in radians."""
    theta, phi = angles(wo)
    return np.stack([theta * np.cos(phi), theta * np.sin(phi)], axis=-1)


def _usual_distance(corners: Integers, sides: Floats, n: int) -> Floats:
    """Of each of n corners the third shortest side that ends there.

    Or that of a neighbour, if it is longer: those of the ring about a pole that has no
    value of its own are next to each other across it.
    """
    pairs = np.stack([corners, np.roll(corners, 1, axis=1)], axis=-1).reshape(-1, 2)
    both = np.concatenate([pairs, pairs[:, ::-1]])
    rows, first = np.unique(both, axis=0, return_index=True)
    length = np.tile(sides.ravel(), 2)[first]
    order = np.lexsort((length, rows[:, 0]))
    ends = np.searchsorted(rows[:, 0], np.arange(n + 1))
    third = np.minimum(ends[:-1] + 2, ends[1:] - 1)
    # 0 for a direction that no triangle has
    own = np.where(np.diff(ends) > 0, length[order][third], 0.0)
    usual = own.copy()
    np.maximum.at(usual, rows[:, 0], own[rows[:, 1]])
    return usual

"""A collector hemisphere that is cut into patches: rings of polar angle times sectors.

It is described by the angle from its own pole; the lower hemisphere mirrors the upper.
"""

from types import SimpleNamespace
from typing import ClassVar

import numpy as np

from .directions import direction

__all__ = ["BORDER", "Subdivision"]

# A direction this close to a border counts as on it: a few float32 rounding errors.
# Relative in the ring coordinate, so that no ring gains or loses more than this
# fraction of its size; absolute in azimuth, where it only turns the collector.
BORDER = 2.0**-20

_NUMPY = SimpleNamespace(
    sqrt=np.sqrt,
    atan2=np.arctan2,
    floor=np.floor,
    ceil=np.ceil,
    minimum=np.minimum,
    where=np.where,
    count_below=lambda borders, x: np.searchsorted(borders, x, side="right"),
    take=lambda table, index: table[index.astype(int)],
)


class Subdivision:
    r"""Rings times sectors of one collector hemisphere.

    Patch ``(i, j)`` spans ``theta_edges[i] <= theta < theta_edges[i + 1]`` and
    ``phi_edges[j] <= phi < phi_edges[j + 1]``: half open, so that each direction of
    the open hemisphere belongs to exactly one patch. A direction within ``2**-20`` of a
    border counts as on it, so that single precision cannot decide. The pole belongs
    to patch ``(0, 0)``. The horizon, theta = 90 degrees, belongs to no patch.

    Attributes
    ----------
    n_theta, n_phi : int
        Number of rings and of sectors.
    name : str
        Word before the colon in the name from which :func:`subdivision` rebuilds it.
    """

    n_theta: int
    n_phi: int
    name: ClassVar[str] = ""
    #: Where the patches' cells have their poles, shape (n_patches, 3); None for +z.
    axes: ClassVar[np.ndarray | None] = None

    @property
    def shape(self):
        """``(n_theta, n_phi)``."""
        return self.n_theta, self.n_phi

    @property
    def n_patches(self):
        """Number of patches of one hemisphere."""
        return self.n_theta * self.n_phi

    @property
    def theta_edges(self):
        """Ring borders in radians, shape ``(n_theta + 1,)``, 0 (pole) to pi/2."""
        raise NotImplementedError

    @property
    def phi_edges(self):
        """Sector borders in radians, shape ``(n_phi + 1,)``, from 0 to 2 pi."""
        raise NotImplementedError

    @property
    def theta(self):
        """Middle of each ring in radians, shape ``(n_theta,)``: halves its flux.

        That is the angle that halves the ring's projected solid angle.
        """
        sin2 = np.sin(self.theta_edges) ** 2
        return np.arcsin(np.sqrt((sin2[1:] + sin2[:-1]) / 2))

    @property
    def phi(self):
        """Middle of each sector in radians, shape ``(n_phi,)``."""
        return (self.phi_edges[1:] + self.phi_edges[:-1]) / 2

    @property
    def middles(self):
        """Polar angles and azimuths of the patches' middles in radians.

        Two arrays of the shape ``(n_theta, n_phi)``; NaN for a patch without a middle.
        """
        return np.meshgrid(self.theta, self.phi, indexing="ij")

    @property
    def cells(self):
        """Borders of each patch in radians, shape ``(n_patches, 4)``.

        Columns: lower and upper polar angle, lower and upper azimuth, both about the
        patch's own pole in `axes`.
        """
        low, high = (np.repeat(e, self.n_phi) for e in _pairs(self.theta_edges))
        left, right = (np.tile(e, self.n_theta) for e in _pairs(self.phi_edges))
        return np.stack([low, high, left, right], axis=-1)

    def points(self, n):
        """Directions of ``n x n`` points in each patch, with z > 0.

        Each stands for the same projected solid angle of its patch.

        Returns
        -------
        ndarray, shape (n_patches, n * n, 3)

        Raises
        ------
        ValueError
            If the patches have poles of their own.
        """
        if self.axes is not None:
            raise ValueError(f"the patches must have a common pole, got {self!s:.60}")
        low, high, left, right = self.cells.T[:, :, None]
        step = (np.arange(n) + 0.5) / n
        along, around = (
            axis.ravel() for axis in np.meshgrid(step, step, indexing="ij")
        )
        begin, end = np.sin(low) ** 2, np.sin(high) ** 2
        sin2 = begin + along * (end - begin)
        return direction(np.arcsin(np.sqrt(sin2)), left + around * (right - left))

    @property
    def solid_angles(self):
        """Exact solid angle of each patch in sr, ``(n_theta, n_phi)``; sum 2 pi."""
        low, high = self.theta_edges[:-1], self.theta_edges[1:]
        ring = 2 * np.sin((high + low) / 2) * np.sin((high - low) / 2)
        return self._over_sectors(ring)

    @property
    def projected_solid_angles(self):
        """Exact integral of cos(theta) over each patch in sr; sum pi.

        Shape ``(n_theta, n_phi)``: the paper's adjusted solid angle (eq. 12).
        """
        low, high = self.theta_edges[:-1], self.theta_edges[1:]
        return self._over_sectors(np.sin(high - low) * np.sin(high + low) / 2)

    def adjusted_solid_angles(self, theta_r):
        """Solid angle times cos(theta_r), the paper's eq. 2, in sr.

        Parameters
        ----------
        theta_r : {"theta", "cosine"}
            The paper's two choices in section 3.1: ``"theta"`` averages the borders'
            angles, ``"cosine"`` their cosines. The second equals
            :attr:`projected_solid_angles`; the first does not (Figure 2).

        Returns
        -------
        ndarray, shape (n_theta, n_phi)
        """
        low, high = self.theta_edges[:-1], self.theta_edges[1:]
        if theta_r == "theta":
            cos_theta_r = np.cos((low + high) / 2)
        elif theta_r == "cosine":
            cos_theta_r = (np.cos(low) + np.cos(high)) / 2
        else:
            raise ValueError(f"theta_r must be 'theta' or 'cosine', got {theta_r!r}")
        return self.solid_angles * cos_theta_r[:, None]

    def patch(self, v):
        """Index ``i * n_phi + j`` of the patch that each direction hits.

        Parameters
        ----------
        v : array_like, shape (..., 3)
            Unit vectors; the sign of z is ignored (the lower hemisphere mirrors).

        Returns
        -------
        ndarray of int, shape (...)
        """
        x, y, z = np.moveaxis(np.asarray(v, dtype=float), -1, 0)
        index = self.patch_index(_NUMPY, x, y, np.abs(z))
        return np.clip(index, 0, self.n_patches - 1).astype(int)

    def patch_index(self, xp, x, y, z):
        """Patch index as a whole floating-point number, in any array library.

        Parameters
        ----------
        xp : namespace
            Has ``sqrt``, ``atan2``, ``floor``, ``ceil``, ``minimum``, ``where`` and
            ``count_below(borders, x)``, the number of ascending borders not above x.
        x, y, z : array
            Components of unit vectors, z > 0.
        """
        return self._ring(xp, x * x + y * y, z) * self.n_phi + self._sector(xp, x, y)

    def _over_sectors(self, ring):
        """Spread a ring's integral per radian of azimuth over its sectors."""
        return ring[:, None] * np.diff(self.phi_edges)

    def _ring(self, xp, sin2, z):
        """Ring of a direction, as a whole floating-point number."""
        raise NotImplementedError

    def _sector(self, xp, x, y):
        """Sector of a direction, as a whole floating-point number."""
        raise NotImplementedError


def _pairs(edges):
    return edges[:-1], edges[1:]

"""The Klems full basis: the patches of window metrology and of Radiance's matrices.

Source: J. H. Klems, *A new method for predicting the solar heat gain of complex
fenestration systems*, ASHRAE Transactions 100, 1994; edges as in Radiance's
``LBNL/Klems Full``.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from .borders import Borders
from .hemisphere import EDGE, RingsAndSectors, Subdivision

__all__ = ["Klems"]

THETA_DEG = (0, 5, 15, 25, 35, 45, 55, 65, 75, 90)
N_PHI = (1, 8, 16, 20, 24, 24, 24, 16, 12)

# Smallest number of sectors whose edges hold those of all rings.
COMMON = 480


@dataclass(frozen=True)
class Klems(Subdivision):
    """Nine rings of 1, 8, 16, 20, 24, 24, 24, 16 and 12 sectors: 145 patches.

    The first sector of each ring is centred on the azimuth 0. As a map it has as many
    rows as patches and one column. The pole is in patch 0, and the horizon in none.
    """

    name: ClassVar[str] = "klems"

    def __str__(self) -> str:
        return self.name

    @property
    def shape(self) -> tuple[int, int]:
        """``(145, 1)``."""
        return sum(N_PHI), 1

    @property
    def cells(self) -> NDArray[np.float64]:
        """Edges of each patch in radians, shape ``(145, 4)``.

        Columns: lower and upper polar angle, lower and upper azimuth.
        """
        rows = []
        for low, high, n in zip(THETA_DEG, THETA_DEG[1:], N_PHI):
            half = 180 / n
            rows += [
                (low, high, k * 2 * half - half, k * 2 * half + half) for k in range(n)
            ]
        return np.radians(rows)

    @property
    def middles(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Polar angles and azimuths of the patches' middles in radians.

        Two arrays of shape ``(145, 1)``; the basis takes the mean of the polar angles,
        and the pole for the first patch.
        """
        low, high, left, right = self.cells.T
        theta = np.where(low == 0, 0.0, (low + high) / 2)
        return theta[:, None], (left + right)[:, None] / 2

    @property
    def solid_angles(self) -> NDArray[np.float64]:
        """Exact solid angle of each patch in sr, shape ``(145, 1)``; sum 2 pi."""
        low, high, left, right = self.cells.T
        return ((np.cos(low) - np.cos(high)) * (right - left))[:, None]

    @property
    def projected_solid_angles(self) -> NDArray[np.float64]:
        """Exact integral of cos(theta) over each patch, ``(145, 1)``; sum pi."""
        low, high, left, right = self.cells.T
        ring = np.sin(high - low) * np.sin(high + low) / 2
        return (ring * (right - left))[:, None]

    def patch_index(self, xp: Any, x: Any, y: Any, z: Any) -> Any:
        """Index of the patch of each direction; see `Subdivision.patch_index`."""
        ring = self._rings._ring(xp, x * x + y * y, z)
        sectors = np.array(N_PHI, dtype=np.float32)
        first = np.concatenate([[0], np.cumsum(sectors)[:-1]]).astype(np.float32)
        n = xp.take(sectors, ring)
        sector = xp.floor((xp.atan2(y, x) + EDGE) * (n / (2 * np.pi)) + 0.5)
        sector = xp.where(sector < 0, sector + n, sector)
        sector = xp.where(sector >= n, 0.0, sector)
        return xp.take(first, ring) + sector

    @property
    def _rings(self) -> Borders:
        return Borders(THETA_DEG, (0, 360))

    def in_rings(self, values: NDArray[Any]) -> tuple[RingsAndSectors, NDArray[Any]]:
        """Rings of sectors that are common to all, and `values` in them.

        Parameters
        ----------
        values : ndarray, shape (..., 145, 1, channels)
            Any mean over patches.

        Returns
        -------
        patches : Borders
            Nine rings of 480 sectors.
        values : ndarray, shape (..., 9, 480, channels)
        """
        patches = Borders(THETA_DEG, tuple(np.arange(COMMON + 1) * (360 / COMMON)))
        theta, phi = np.meshgrid(patches.theta, patches.phi, indexing="ij")
        sine = np.sin(theta)
        middles = np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)], -1)
        return patches, values[..., self.patch(middles), 0, :]

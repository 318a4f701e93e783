"""The Klems bases: patches of window metrology and of Radiance's BSDF matrices.

Source: J. H. Klems, *A new method for predicting the solar heat gain of complex
fenestration systems*, ASHRAE Transactions 100, 1994; edges as in Radiance's
``LBNL/Klems Full``, ``Half`` and ``Quarter``.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..array_types import Floats
from ..errors import checked_choice
from .borders import Borders
from .directions import direction
from .hemisphere import EDGE, RingsAndSectors, Subdivision

# Edges of the rings in degrees, and sectors of each.
RINGS = {
    "full": (
        (0, 5, 15, 25, 35, 45, 55, 65, 75, 90),
        (1, 8, 16, 20, 24, 24, 24, 16, 12),
    ),
    "half": ((0, 6.5, 19.5, 32.5, 45.5, 58.5, 71.5, 90), (1, 8, 12, 16, 20, 12, 8)),
    "quarter": ((0, 9, 27, 45, 63, 90), (1, 8, 12, 12, 8)),
}

# Smallest number of sectors whose edges hold those of all rings of a basis.
COMMON = {"full": 480, "half": 480, "quarter": 48}


@dataclass(frozen=True)
class Klems(Subdivision):
    """145, 77 or 41 patches of similar size: each ring has its own number of sectors.

    The first sector of each ring is centred on the azimuth 0. A map has one row per
    patch and one column. Patch 0 contains the pole; no patch contains the horizon.

    Attributes
    ----------
    size : {"full", "half", "quarter"}
        Nine rings of 1, 8, 16, 20, 24, 24, 24, 16 and 12 sectors; seven of 1, 8, 12,
        16, 20, 12 and 8; or five of 1, 8, 12, 12 and 8.
    """

    size: str = "full"

    name: ClassVar[str] = "klems"

    def __post_init__(self) -> None:
        checked_choice("size", self.size, tuple(RINGS))

    def __str__(self) -> str:
        return self.name if self.size == "full" else f"{self.name}-{self.size}"

    @property
    def theta_deg(self) -> tuple[float, ...]:
        """Edges of the rings in degrees."""
        return RINGS[self.size][0]

    @property
    def n_phi(self) -> tuple[int, ...]:
        """Sectors of each ring."""
        return RINGS[self.size][1]

    @property
    def shape(self) -> tuple[int, int]:
        """Number of patches, and 1."""
        return sum(self.n_phi), 1

    @property
    def cells(self) -> Floats:
        """Edges of each patch in radians, shape ``(n_patches, 4)``.

        Columns: lower and upper polar angle, lower and upper azimuth.
        """
        rows = []
        for low, high, n in zip(self.theta_deg, self.theta_deg[1:], self.n_phi):
            half = 180 / n
            rows += [
                (low, high, k * 2 * half - half, k * 2 * half + half) for k in range(n)
            ]
        return np.radians(rows)

    @property
    def middles(self) -> tuple[Floats, Floats]:
        """Polar angles and azimuths of the patches' middles in radians.

        Two arrays of shape ``(n_patches, 1)``; the basis takes the mean of the polar
        angles, and the pole for the first patch.
        """
        low, high, left, right = self.cells.T
        theta = np.where(low == 0, 0.0, (low + high) / 2)
        return theta[:, None], (left + right)[:, None] / 2

    @property
    def solid_angles(self) -> Floats:
        """Exact solid angle of each patch in sr, ``(n_patches, 1)``; sum 2 pi."""
        low, high, left, right = self.cells.T
        return ((np.cos(low) - np.cos(high)) * (right - left))[:, None]

    @property
    def projected_solid_angles(self) -> Floats:
        """Exact integral of cos(theta) over each patch, ``(n_patches, 1)``; sum pi."""
        low, high, left, right = self.cells.T
        ring = np.sin(high - low) * np.sin(high + low) / 2
        return (ring * (right - left))[:, None]

    def patch_index(self, xp: Any, x: Any, y: Any, z: Any) -> Any:
        """Index of the patch of each direction; see `Subdivision.patch_index`."""
        ring = self._rings._ring(xp, x * x + y * y, z)
        sectors = np.array(self.n_phi, dtype=np.float32)
        first = np.concatenate([[0], np.cumsum(sectors)[:-1]]).astype(np.float32)
        n = xp.take(sectors, ring)
        sector = xp.floor((xp.atan2(y, x) + EDGE) * (n / (2 * np.pi)) + 0.5)
        sector = xp.where(sector < 0, sector + n, sector)
        sector = xp.where(sector >= n, 0.0, sector)
        return xp.take(first, ring) + sector

    @property
    def _rings(self) -> Borders:
        return Borders(self.theta_deg, (0, 360))

    def in_rings(self, values: NDArray[Any]) -> tuple[RingsAndSectors, NDArray[Any]]:
        """Rings that share their sectors, and `values` in them.

        Parameters
        ----------
        values : ndarray, shape (..., n_patches, 1, channels)
            Any mean over patches.

        Returns
        -------
        patches : Borders
            As many rings, of 480 or 48 sectors.
        values : ndarray, shape (..., n_rings, n_sectors, channels)
        """
        n = COMMON[self.size]
        patches = Borders(self.theta_deg, tuple(np.arange(n + 1) * (360 / n)))
        return patches, values[..., self.patch(direction(*patches.middles)), 0, :]


# All bases by their names.
KLEMS = {str(basis): basis for basis in map(Klems, RINGS)}

"""A collector hemisphere that is cut into patches, most often into rings and sectors.

It is described by the angle from its own pole; the lower hemisphere mirrors the upper.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..array_types import Flags, Floats, Integers
from ..errors import SettingError, checked_choice
from ..single_precision import FEW_ROUNDINGS
from .directions import direction

# A direction this close to an edge counts as on it: a few rounding errors.
# Relative in the ring coordinate, so that no ring gains or loses more than this
# fraction of its size; absolute in azimuth, where it only turns the collector.
EDGE = FEW_ROUNDINGS

# Functions that Dr.Jit names as NumPy does.
SHARED_NAMES = ("sqrt", "sin", "cos", "floor", "ceil", "minimum")

_NUMPY = SimpleNamespace(
    **{name: getattr(np, name) for name in SHARED_NAMES},
    atan2=np.arctan2,
    where=np.where,
    parameter=lambda x: x,
    count_below=lambda edges, x: np.searchsorted(edges, x, side="right"),
    take=lambda table, index: table[index.astype(int)],
)


class Subdivision(ABC):
    """The patches of one collector hemisphere: all that an instrument asks of them.

    Each direction of the open hemisphere belongs to exactly one patch, and the
    horizon, theta = 90 degrees, to none. A direction within ``2**-20`` of an edge
    counts as on it, so that single precision cannot decide. The text of a subdivision,
    ``str(patches)``, is the name from which :func:`subdivision` rebuilds it.

    Attributes
    ----------
    name : str
        Word before the colon in that text.
    """

    name: ClassVar[str] = ""

    @property
    @abstractmethod
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a map of the patches."""

    @property
    def n_patches(self) -> int:
        """Number of patches of one hemisphere."""
        n_rows, n_columns = self.shape
        return n_rows * n_columns

    @property
    def n_detectors(self) -> int:
        """Number of leading patches that are detectors, not gaps between them."""
        return self.n_patches

    @property
    def aperture_half_angle(self) -> float | None:
        """In degrees, of detectors that are cones; None for others."""
        return None

    @property
    @abstractmethod
    def solid_angles(self) -> Floats:
        """Exact solid angle of each patch in sr, of the shape `shape`; sum 2 pi."""

    @property
    @abstractmethod
    def projected_solid_angles(self) -> Floats:
        """Exact integral of cos(theta) over each patch in sr; sum pi.

        Of the shape `shape`: the paper's adjusted solid angle (eq. 12).
        """

    @property
    @abstractmethod
    def middles(self) -> tuple[Floats, Floats]:
        """Polar angles and azimuths of the patches' middles in radians.

        Two arrays of the shape `shape`; NaN for a patch without a middle.
        """

    @property
    def cells(self) -> Floats:
        """Edges of each patch in radians, shape ``(n_patches, 4)``.

        Columns: lower and upper polar angle, lower and upper azimuth, both about the
        patch's own pole in `axes`.

        Raises
        ------
        ValueError
            If the patches are no parts of rings.
        """
        raise SettingError(f"{self!s:.40} has no rings and sectors")

    @property
    def fills_cells(self) -> bool:
        """Whether each detector is the whole of its cell."""
        return True

    @property
    def axes(self) -> Floats | None:
        """Poles of the patches' cells, shape ``(n_patches, 3)``; None for +z."""
        return None

    @abstractmethod
    def patch_index(self, xp: Any, x: Any, y: Any, z: Any) -> Any:
        """Patch index as a whole floating-point number, in any array library.

        Parameters
        ----------
        xp : namespace
            Has ``sqrt``, ``sin``, ``cos``, ``atan2``, ``floor``, ``ceil``, ``minimum``,
            ``where``, ``parameter(x)``, a float that is no constant of a kernel,
            ``count_below(edges, x)``, the number of ascending edges not above x, and
            ``take(table, index)``, the entries of a float table at whole floating-point
            numbers.
        x, y, z : array
            Components of unit vectors, z > 0.
        """

    def in_rings(
        self,
        values: NDArray[Any],  # noqa: ARG002
    ) -> tuple["RingsAndSectors", NDArray[Any]]:
        """Rings and sectors to draw or to tabulate instead, and `values` in them.

        Each ring and sector lies within one patch.

        Parameters
        ----------
        values : ndarray
            Any mean over patches, of shape ``(..., rows, columns, channels)``.

        Raises
        ------
        ValueError
            If the patches are not made of rings and sectors.
        """
        raise SettingError(
            f"{self!s:.40} has no rings and sectors: gonio-mi compare takes any patches"
        )

    def patch(self, v: ArrayLike) -> Integers:
        """Number of the patch that each direction hits, row by row of the map.

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

    def detectors(self, v: Floats) -> tuple[Integers, Flags]:
        """Patch that measures each direction, and a validity mask.

        Parameters
        ----------
        v : ndarray, shape (n, 3)
            Unit vectors; the sign of z is ignored.
        """
        return self.patch(v), np.ones(len(v), bool)

    def within(self, windows: Sequence[tuple[float, ...]]) -> Flags | None:  # noqa: ARG002
        """Patches within windows of :class:`~gonio_mi.collector.receptors.Receptors`.

        None if the hemisphere is not cut along these windows.
        """
        return None

    def points(self, n: int, chosen: Integers | None = None) -> Floats:
        """Directions of ``n x n`` points in each patch, with z > 0.

        Each stands for the same projected solid angle of its patch.

        Parameters
        ----------
        n : int
        chosen : ndarray of int, optional
            Numbers of the patches that are wanted; all of them, if none are given.

        Returns
        -------
        ndarray, shape (n_patches, n * n, 3)

        Raises
        ------
        ValueError
            If the patches have poles of their own.
        """
        cells = self.cells_about_pole()
        cells = cells if chosen is None else cells[chosen]
        low, high, left, right = cells.T[:, :, None]
        step = (np.arange(n) + 0.5) / n
        begin, end = np.sin(low) ** 2, np.sin(high) ** 2
        theta = np.arcsin(np.sqrt(begin + step * (end - begin)))
        phi = left + step * (right - left)
        return direction(theta[:, :, None], phi[:, None]).reshape(-1, n * n, 3)

    def frame_of(self, number: int) -> tuple[float, ...]:
        """Numbers that tell where a patch is, for :meth:`drawn`."""
        low, high, left, right = self.cells_about_pole()[number]
        span = np.sin(high - low) * np.sin(high + low)
        return np.sin(low) ** 2, np.cos(high) ** 2, span, left, right - left

    def drawn(self, xp: Any, frame: Any, u: Any, v: Any) -> tuple[Any, Any, Any]:
        """Directions that fill a patch, uniformly in projected solid angle.

        Parameters
        ----------
        xp : namespace
            See `patch_index`.
        frame : sequence of float or array
            Of `frame_of`.
        u, v : array
            In (0, 1).

        Returns
        -------
        x, y, z : array
            Components of unit vectors, z > 0.
        """
        sin2, cos2, span, left, turn = frame
        # sine and cosine each by what keeps its precision
        sine, cosine = xp.sqrt(sin2 + u * span), xp.sqrt(cos2 + (1 - u) * span)
        phi = left + v * turn
        return sine * xp.cos(phi), sine * xp.sin(phi), cosine

    def cells_about_pole(self) -> Floats:
        """Return `cells`, or raise ValueError if they have poles of their own."""
        if self.axes is not None:
            raise SettingError(f"the patches must have a common pole, got {self!s:.60}")
        return self.cells


class RingsAndSectors(Subdivision):
    r"""Rings of polar angle times sectors of azimuth.

    Patch ``(i, j)`` spans ``theta_edges[i] <= theta < theta_edges[i + 1]`` and
    ``phi_edges[j] <= phi < phi_edges[j + 1]``, half open. The pole belongs to patch
    ``(0, 0)``.

    Attributes
    ----------
    n_theta, n_phi : int
        Number of rings and of sectors.
    """

    n_theta: int
    n_phi: int

    @property
    def shape(self) -> tuple[int, int]:
        """``(n_theta, n_phi)``."""
        return self.n_theta, self.n_phi

    @property
    @abstractmethod
    def theta_edges(self) -> Floats:
        """Ring edges in radians, shape ``(n_theta + 1,)``, 0 (pole) to pi/2."""

    @property
    @abstractmethod
    def phi_edges(self) -> Floats:
        """Sector edges in radians, shape ``(n_phi + 1,)``, from 0 to 2 pi."""

    @property
    def theta(self) -> Floats:
        """Middle of each ring in radians, shape ``(n_theta,)``: halves its flux.

        That is the angle that halves the ring's projected solid angle.
        """
        sin2 = np.sin(self.theta_edges) ** 2
        return np.arcsin(np.sqrt((sin2[1:] + sin2[:-1]) / 2))

    @property
    def phi(self) -> Floats:
        """Middle of each sector in radians, shape ``(n_phi,)``."""
        return (self.phi_edges[1:] + self.phi_edges[:-1]) / 2

    @property
    def middles(self) -> tuple[Floats, Floats]:
        """Polar angles and azimuths of the patches' middles in radians.

        Two arrays of the shape ``(n_theta, n_phi)``.
        """
        theta, phi = np.meshgrid(self.theta, self.phi, indexing="ij")
        return theta, phi

    @property
    def cells(self) -> Floats:
        """Edges of each patch in radians, shape ``(n_patches, 4)``.

        Columns: lower and upper polar angle, lower and upper azimuth.
        """
        theta, phi = self.theta_edges, self.phi_edges
        low, high = (np.repeat(edges, self.n_phi) for edges in (theta[:-1], theta[1:]))
        left, right = (np.tile(edges, self.n_theta) for edges in (phi[:-1], phi[1:]))
        return np.stack([low, high, left, right], axis=-1)

    @property
    def solid_angles(self) -> Floats:
        """Exact solid angle of each patch in sr, ``(n_theta, n_phi)``; sum 2 pi."""
        low, high = self.theta_edges[:-1], self.theta_edges[1:]
        ring = 2 * np.sin((high + low) / 2) * np.sin((high - low) / 2)
        return self._over_sectors(ring)

    @property
    def projected_solid_angles(self) -> Floats:
        """Exact integral of cos(theta) over each patch in sr; sum pi.

        Shape ``(n_theta, n_phi)``: the paper's adjusted solid angle (eq. 12).
        """
        low, high = self.theta_edges[:-1], self.theta_edges[1:]
        return self._over_sectors(np.sin(high - low) * np.sin(high + low) / 2)

    def adjusted_solid_angles(self, theta_r: str) -> Floats:
        """Solid angle times cos(theta_r), the paper's eq. 2, in sr.

        Parameters
        ----------
        theta_r : {"theta", "cosine"}
            The paper's two choices in section 3.1: ``"theta"`` averages the edges'
            angles, ``"cosine"`` their cosines. The second equals
            :attr:`projected_solid_angles`; the first does not (Figure 2).

        Returns
        -------
        ndarray, shape (n_theta, n_phi)
        """
        low, high = self.theta_edges[:-1], self.theta_edges[1:]
        cos_theta_r = {
            "theta": np.cos((low + high) / 2),
            "cosine": (np.cos(low) + np.cos(high)) / 2,
        }
        checked_choice("theta_r", theta_r, list(cos_theta_r))
        return self.solid_angles * cos_theta_r[theta_r][:, None]

    def patch_index(self, xp: Any, x: Any, y: Any, z: Any) -> Any:
        """Number ``i * n_phi + j`` of the patch; see `Subdivision.patch_index`."""
        before = self._ring(xp, x * x + y * y, z) * xp.parameter(float(self.n_phi))
        return before + self._sector(xp, x, y)

    def in_rings(self, values: NDArray[Any]) -> tuple["RingsAndSectors", NDArray[Any]]:
        """Return what it is, and `values`."""
        return self, values

    def _over_sectors(self, ring: Floats) -> Floats:
        """Spread a ring's integral per radian of azimuth over its sectors."""
        return ring[:, None] * np.diff(self.phi_edges)

    @abstractmethod
    def _ring(self, xp: Any, sin2: Any, z: Any) -> Any:
        """Ring of a direction, as a whole floating-point number."""

    @abstractmethod
    def _sector(self, xp: Any, x: Any, y: Any) -> Any:
        """Sector of a direction, as a whole floating-point number."""

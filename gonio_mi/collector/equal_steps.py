"""Hemispheres cut in equal steps of a coordinate (the paper's section 3)."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..array_types import Floats
from ..errors import SettingError, checked_count
from .hemisphere import EDGE, RingsAndSectors

# Single precision, in which patches are numbered, counts no further.
MAX_PATCHES = 2**24


@dataclass(frozen=True)
class _Regular(RingsAndSectors):
    """Equal steps of a coordinate of the polar angle, and of azimuth.

    Parameters
    ----------
    n_theta, n_phi : int
        Number of rings and of sectors, each at least 1.

    Raises
    ------
    TypeError, ValueError
        If a number is not an integer or is below 1, or if there are more than 2**24
        patches.
    """

    n_theta: int
    n_phi: int

    def __post_init__(self) -> None:
        for field in ("n_theta", "n_phi"):
            object.__setattr__(self, field, checked_count(field, getattr(self, field)))
        if self.n_patches > MAX_PATCHES:
            raise SettingError(
                f"a collector must have at most {MAX_PATCHES} patches, got {self}"
            )

    def __str__(self) -> str:
        return f"{self.name}:{self.n_theta}x{self.n_phi}"

    @property
    def theta_edges(self) -> Floats:
        """Ring edges in radians, shape ``(n_theta + 1,)``, 0 (pole) to pi/2."""
        edges = self._edges(np.arange(self.n_theta + 1) / self.n_theta)
        edges[-1] = np.pi / 2
        return edges

    @property
    def phi_edges(self) -> Floats:
        """Sector edges in radians, shape ``(n_phi + 1,)``, from 0 to 2 pi."""
        return np.linspace(0, 2 * np.pi, self.n_phi + 1)

    def _ring(self, xp: Any, sin2: Any, z: Any) -> Any:
        """Ring of a direction, counted from whichever end keeps its precision."""
        from_pole, from_horizon = self._coordinates(xp, sin2, z)
        n = float(self.n_theta)
        above = xp.floor(from_pole * xp.parameter(n * (1 + EDGE)))
        ceiling = xp.ceil(from_horizon * xp.parameter(n * (1 - EDGE)))
        ring = xp.where(sin2 < z * z, above, xp.parameter(n) - ceiling)
        return xp.minimum(ring, xp.parameter(n - 1))

    def _sector(self, xp: Any, x: Any, y: Any) -> Any:
        """Sector of a direction; the collector is turned by ``EDGE`` radians."""
        n = xp.parameter(float(self.n_phi))
        turn = (xp.atan2(y, x) + EDGE) * xp.parameter(self.n_phi / (2 * np.pi))
        sector = xp.floor(xp.where(turn < 0, turn + n, turn))
        # the pole, and what rounding lifted to a full turn, are in the first sector
        return xp.where(((x == 0) & (y == 0)) | (sector >= n), 0.0, sector)

    @abstractmethod
    def _edges(self, fraction: Floats) -> Floats:
        """Polar angle of a ring edge, given its fraction of all rings."""

    @abstractmethod
    def _coordinates(self, xp: Any, sin2: Any, z: Any) -> tuple[Any, Any]:
        """Ring coordinate in [0, 1], measured from the pole and from the horizon."""


class EqualAngle(_Regular):
    """Equal steps of polar angle and azimuth (the paper's section 3.1)."""

    name: ClassVar[str] = "angle"

    def _edges(self, fraction: Floats) -> Floats:
        return fraction * (np.pi / 2)

    def _coordinates(self, xp: Any, sin2: Any, z: Any) -> tuple[Any, Any]:
        sin = xp.sqrt(sin2)
        return xp.atan2(sin, z) * (2 / np.pi), xp.atan2(z, sin) * (2 / np.pi)


class EqualSolidAngle(_Regular):
    """Patches of equal solid angle: equal steps of cos(theta) (eq. 11)."""

    name: ClassVar[str] = "solid"

    @property
    def solid_angles(self) -> Floats:
        """Solid angle of each patch in sr, shape ``(n_theta, n_phi)``: all the same."""
        return np.full(self.shape, 2 * np.pi / self.n_patches)

    def _edges(self, fraction: Floats) -> Floats:
        # 1 - cos(theta) = 2 sin^2(theta / 2), without cancellation at the pole
        return 2 * np.arcsin(np.sqrt(fraction / 2))

    def _coordinates(self, xp: Any, sin2: Any, z: Any) -> tuple[Any, Any]:  # noqa: ARG002
        return sin2 / (1.0 + z), z


class EqualProjectedSolidAngle(_Regular):
    """Patches of equal projected solid angle: equal steps of sin^2(theta) (eq. 13)."""

    name: ClassVar[str] = "projected"

    @property
    def projected_solid_angles(self) -> Floats:
        """Projected solid angle of each patch in sr: all the same."""
        return np.full(self.shape, np.pi / self.n_patches)

    def _edges(self, fraction: Floats) -> Floats:
        return np.arcsin(np.sqrt(fraction))

    def _coordinates(self, xp: Any, sin2: Any, z: Any) -> tuple[Any, Any]:  # noqa: ARG002
        return sin2, z * z


class EqualSine(_Regular):
    """Equal steps of sin(theta): many small patches at the top.

    The paper's Figure 11 uses "the reverse of the equal adjusted solid angle
    subdivision" with "a larger number of smaller patches on the top". Equal projected
    rings are their own mirror image, so it cannot be meant literally; eq. 11 applied to
    the elevation fits the words. That reading is an inference.
    """

    name: ClassVar[str] = "sine"

    def _edges(self, fraction: Floats) -> Floats:
        return np.arcsin(fraction)

    def _coordinates(self, xp: Any, sin2: Any, z: Any) -> tuple[Any, Any]:
        sin = xp.sqrt(sin2)
        return sin, z * z / (1.0 + sin)

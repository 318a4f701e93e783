"""How a collector hemisphere is cut into patches (the paper's section 3).

Every subdivision has rings of polar angle times sectors of azimuth, and describes one
hemisphere by the angle from its own pole; the lower hemisphere mirrors the upper one.
"""

from dataclasses import dataclass
from itertools import pairwise
from types import SimpleNamespace
from typing import ClassVar

import numpy as np

from .errors import checked_count, checked_number

__all__ = [
    "Borders",
    "EqualAngle",
    "EqualProjectedSolidAngle",
    "EqualSine",
    "EqualSolidAngle",
    "Subdivision",
    "adapted",
    "subdivision",
]

# A direction this close to a border counts as on it: a few float32 rounding errors.
# Relative in the ring coordinate, so that no ring gains or loses more than this
# fraction of its size; absolute in azimuth, where it only turns the collector.
BORDER = 2.0**-20

# Single precision, in which patches are numbered, counts no further.
MOST_PATCHES = 2**24

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


@dataclass(frozen=True)
class _Regular(Subdivision):
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

    def __post_init__(self):
        for field in ("n_theta", "n_phi"):
            object.__setattr__(self, field, checked_count(field, getattr(self, field)))
        if self.n_patches > MOST_PATCHES:
            raise ValueError(
                f"a collector must have at most {MOST_PATCHES} patches, got {self}"
            )

    def __str__(self):
        return f"{self.name}:{self.n_theta}x{self.n_phi}"

    @property
    def theta_edges(self):
        """Ring borders in radians, shape ``(n_theta + 1,)``, 0 (pole) to pi/2."""
        edges = self._edges(np.arange(self.n_theta + 1) / self.n_theta)
        edges[-1] = np.pi / 2
        return edges

    @property
    def phi_edges(self):
        """Sector borders in radians, shape ``(n_phi + 1,)``, from 0 to 2 pi."""
        return np.linspace(0, 2 * np.pi, self.n_phi + 1)

    def _ring(self, xp, sin2, z):
        """Ring of a direction, counted from whichever end keeps its precision."""
        from_pole, from_horizon = self._coordinates(xp, sin2, z)
        n = float(self.n_theta)
        above = xp.floor(from_pole * (n * (1 + BORDER)))
        below = n - xp.ceil(from_horizon * (n * (1 - BORDER)))
        return xp.minimum(xp.where(sin2 < z * z, above, below), n - 1)

    def _sector(self, xp, x, y):
        """Sector of a direction; the collector is turned by ``BORDER`` radians."""
        n = float(self.n_phi)
        turn = (xp.atan2(y, x) + BORDER) * (n / (2 * np.pi))
        sector = xp.floor(xp.where(turn < 0, turn + n, turn))
        # the pole, and what rounding lifted to a full turn, are in the first sector
        return xp.where(((x == 0) & (y == 0)) | (sector >= n), 0.0, sector)

    def _edges(self, fraction):
        """Polar angle of a ring border, given its fraction of all rings."""
        raise NotImplementedError

    def _coordinates(self, xp, sin2, z):
        """Ring coordinate in [0, 1], measured from the pole and from the horizon."""
        raise NotImplementedError


class EqualAngle(_Regular):
    """Equal steps of polar angle and azimuth (the paper's section 3.1)."""

    name = "angle"

    def _edges(self, fraction):
        return fraction * (np.pi / 2)

    def _coordinates(self, xp, sin2, z):
        sin = xp.sqrt(sin2)
        return xp.atan2(sin, z) * (2 / np.pi), xp.atan2(z, sin) * (2 / np.pi)


class EqualSolidAngle(_Regular):
    """Patches of equal solid angle: equal steps of cos(theta) (eq. 11)."""

    name = "solid"

    @property
    def solid_angles(self):
        """Solid angle of each patch in sr, shape ``(n_theta, n_phi)``: all the same."""
        return np.full(self.shape, 2 * np.pi / self.n_patches)

    def _edges(self, fraction):
        # 1 - cos(theta) = 2 sin^2(theta / 2), without cancellation at the pole
        return 2 * np.arcsin(np.sqrt(fraction / 2))

    def _coordinates(self, xp, sin2, z):  # noqa: ARG002
        return sin2 / (1.0 + z), z


class EqualProjectedSolidAngle(_Regular):
    """Patches of equal projected solid angle: equal steps of sin^2(theta) (eq. 13)."""

    name = "projected"

    @property
    def projected_solid_angles(self):
        """Projected solid angle of each patch in sr: all the same."""
        return np.full(self.shape, np.pi / self.n_patches)

    def _edges(self, fraction):
        return np.arcsin(np.sqrt(fraction))

    def _coordinates(self, xp, sin2, z):  # noqa: ARG002
        return sin2, z * z


class EqualSine(_Regular):
    """Equal steps of sin(theta): many small patches at the top.

    The paper's Figure 11 uses "the reverse of the equal adjusted solid angle
    subdivision" with "a larger number of smaller patches on the top". Equal projected
    rings are their own mirror image, so it cannot be meant literally; eq. 11 applied to
    the elevation fits the words. That reading is an inference.
    """

    name = "sine"

    def _edges(self, fraction):
        return np.arcsin(fraction)

    def _coordinates(self, xp, sin2, z):
        sin = xp.sqrt(sin2)
        return sin, z * z / (1.0 + sin)


@dataclass(frozen=True)
class Borders(Subdivision):
    """Rings and sectors between given borders, in degrees.

    Parameters
    ----------
    theta_deg : sequence of float
        Ring borders, ascending from 0 to 90.
    phi_deg : sequence of float
        Sector borders, ascending from 0 to 360.

    Raises
    ------
    ValueError
        If the borders do not ascend, or do not begin and end there.
    """

    theta_deg: tuple[float, ...]
    phi_deg: tuple[float, ...]

    name = "borders"

    def __post_init__(self):
        for field, end in (("theta_deg", 90), ("phi_deg", 360)):
            borders = tuple(float(x) for x in getattr(self, field))
            ascends = all(low < high for low, high in pairwise(borders))
            if len(borders) < 2 or borders[0] != 0 or borders[-1] != end or not ascends:
                raise ValueError(
                    f"{field} must ascend from 0 to {end} degrees, got {borders}"
                )
            object.__setattr__(self, field, borders)

    def __str__(self):
        theta, phi = (
            ",".join(map(repr, borders)) for borders in (self.theta_deg, self.phi_deg)
        )
        return f"{self.name}:{theta}x{phi}"

    @property
    def n_theta(self):
        """Number of rings."""
        return len(self.theta_deg) - 1

    @property
    def n_phi(self):
        """Number of sectors."""
        return len(self.phi_deg) - 1

    @property
    def theta_edges(self):
        """Ring borders in radians, shape ``(n_theta + 1,)``, 0 (pole) to pi/2."""
        return np.radians(self.theta_deg)

    @property
    def phi_edges(self):
        """Sector borders in radians, shape ``(n_phi + 1,)``, from 0 to 2 pi."""
        return np.radians(self.phi_deg)

    def _ring(self, xp, sin2, z):
        # inner borders passed, by whichever of sin^2 and cos^2 keeps its precision
        above = xp.count_below(np.sin(self.theta_edges[1:-1]) ** 2, sin2 * (1 + BORDER))
        beyond = xp.count_below(
            -(np.cos(self.theta_edges[1:-1]) ** 2), -z * z * (1 - BORDER)
        )
        return xp.where(sin2 < z * z, above, beyond)

    def _sector(self, xp, x, y):
        turn = xp.atan2(y, x) + BORDER
        turn = xp.where(turn < 0, turn + 2 * np.pi, turn)
        sector = xp.count_below(self.phi_edges[1:-1], turn)
        return xp.where(((x == 0) & (y == 0)) | (turn >= 2 * np.pi), 0.0, sector)


_KINDS = {
    kind.name: kind
    for kind in (EqualAngle, EqualSolidAngle, EqualProjectedSolidAngle, EqualSine)
}


def subdivision(text):
    """Build the subdivision that a name such as ``"projected:30x30"`` describes.

    Parameters
    ----------
    text : str or Subdivision
        ``angle``, ``solid``, ``projected`` or ``sine``, a colon, rings, ``x``, sectors;
        or ``borders:`` and the borders in degrees, ``borders:0,30,90x0,180,360``;
        or ``apertures:`` and cones, see :class:`gonio_mi.apertures.Apertures`;
        or ``klems``, see :class:`gonio_mi.klems.Klems`. A subdivision is returned as
        it is.

    Raises
    ------
    TypeError, ValueError
        If the name is not of that form, or a number is out of range.
    """
    if isinstance(text, Subdivision):
        return text
    form = f"collector must look like projected:30x30 (one of {', '.join(_KINDS)})"
    if not isinstance(text, str):
        raise TypeError(f"{form}, got {text!r}")
    name, _, size = text.partition(":")
    rings, _, sectors = size.partition("x")
    if name == Borders.name:
        try:
            return Borders(_numbers(rings), _numbers(sectors))
        except ValueError as error:
            raise ValueError(f"collector {text!r}: {error}") from None
    if name == "apertures":
        from .apertures import Apertures  # which builds on this module

        try:
            return Apertures.parse(size)
        except ValueError as error:
            raise ValueError(f"collector {text!r}: {error}") from None
    if text == "klems":
        from .klems import Klems  # which builds on this module

        return Klems()
    if name not in _KINDS or not (_is_integer(rings) and _is_integer(sectors)):
        raise ValueError(f"{form}, got {text!r}")
    return _KINDS[name](int(rings), int(sectors))


def adapted(brdf, grid, n_theta, n_phi, uniform=0.25):
    """Subdivision whose rings and sectors are narrow where a pilot found the light.

    After the paper's section 4 (and Greenberg et al. 1997): borders are quantiles of
    the pilot's flux over polar angle and over azimuth, mixed with a share of equal
    projected solid angles so that no direction is left without patches.

    Parameters
    ----------
    brdf : array_like, shape (grid.n_theta, grid.n_phi)
        Pilot's BRDF in 1/sr, or anything proportional to it.
    grid : Subdivision
        The pilot's patches.
    n_theta, n_phi : int
        Rings and sectors to make.
    uniform : float
        Share of the patches that are spread uniformly, in (0, 1].

    Returns
    -------
    Borders
    """
    uniform = checked_number(
        "uniform", uniform, 2.0**-30, 1 + 2.0**-52, "a number in (0, 1]"
    )
    n_theta, n_phi = checked_count("n_theta", n_theta), checked_count("n_phi", n_phi)
    flux = np.asarray(brdf, dtype=float) * grid.projected_solid_angles
    if flux.shape != grid.shape or not flux.sum() > 0:
        raise ValueError(
            f"brdf must have the shape {grid.shape} and carry light, got {flux.shape}"
        )

    def quantiles(marginal, measure, edges, n):
        density = (1 - uniform) * marginal / marginal.sum() + uniform * measure
        cumulative = np.append(0, np.cumsum(density))
        return np.interp(np.arange(1, n) / n, cumulative / cumulative[-1], edges)

    sin2 = np.sin(grid.theta_edges) ** 2
    inner = quantiles(flux.sum(axis=1), np.diff(sin2), sin2, n_theta)
    theta = np.degrees(np.arcsin(np.sqrt(inner)))
    share = np.diff(grid.phi_edges) / (2 * np.pi)
    phi = np.degrees(quantiles(flux.sum(axis=0), share, grid.phi_edges, n_phi))
    return Borders((0, *theta, 90), (0, *phi, 360))


def _pairs(edges):
    return edges[:-1], edges[1:]


def _numbers(text):
    return tuple(float(word) for word in text.split(","))


def _is_integer(text):
    return text.removeprefix("-").isascii() and text.removeprefix("-").isdigit()

"""Hemispheres cut at given edges, or at edges adapted to a pilot measurement."""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Floats
from ..errors import SettingError, checked_count, checked_number
from .hemisphere import EDGE, RingsAndSectors


@dataclass(frozen=True)
class Borders(RingsAndSectors):
    """Rings and sectors between given edges, in degrees.

    Parameters
    ----------
    theta_deg : sequence of float
        Ring edges, ascending from 0 to 90.
    phi_deg : sequence of float
        Sector edges, ascending from 0 to 360.

    Raises
    ------
    ValueError
        If the edges do not ascend, or do not begin and end there.
    """

    theta_deg: tuple[float, ...]
    phi_deg: tuple[float, ...]
    n_theta: int = field(init=False, repr=False, compare=False)
    n_phi: int = field(init=False, repr=False, compare=False)

    name: ClassVar[str] = "borders"

    def __post_init__(self) -> None:
        for angle, n, end in (("theta_deg", "n_theta", 90), ("phi_deg", "n_phi", 360)):
            edges = tuple(float(x) for x in getattr(self, angle))
            ascends = all(low < high for low, high in pairwise(edges))
            if len(edges) < 2 or edges[0] != 0 or edges[-1] != end or not ascends:
                raise SettingError(
                    f"{angle} must ascend from 0 to {end} degrees, got {edges}"
                )
            object.__setattr__(self, angle, edges)
            object.__setattr__(self, n, len(edges) - 1)

    def __str__(self) -> str:
        theta, phi = (
            ",".join(map(repr, edges)) for edges in (self.theta_deg, self.phi_deg)
        )
        return f"{self.name}:{theta}x{phi}"

    @property
    def theta_edges(self) -> Floats:
        """Ring edges in radians, shape ``(n_theta + 1,)``, 0 (pole) to pi/2."""
        return np.radians(self.theta_deg)

    @property
    def phi_edges(self) -> Floats:
        """Sector edges in radians, shape ``(n_phi + 1,)``, from 0 to 2 pi."""
        return np.radians(self.phi_deg)

    def _ring(self, xp: Any, sin2: Any, z: Any) -> Any:
        # inner edges passed, by whichever of sin^2 and cos^2 keeps its precision
        above = xp.count_below(np.sin(self.theta_edges[1:-1]) ** 2, sin2 * (1 + EDGE))
        beyond = xp.count_below(
            -(np.cos(self.theta_edges[1:-1]) ** 2), -z * z * (1 - EDGE)
        )
        return xp.where(sin2 < z * z, above, beyond)

    def _sector(self, xp: Any, x: Any, y: Any) -> Any:
        turn = xp.atan2(y, x) + EDGE
        turn = xp.where(turn < 0, turn + 2 * np.pi, turn)
        sector = xp.count_below(self.phi_edges[1:-1], turn)
        return xp.where(((x == 0) & (y == 0)) | (turn >= 2 * np.pi), 0.0, sector)


def adapted(
    brdf: ArrayLike,
    subdivision: RingsAndSectors,
    n_theta: int,
    n_phi: int,
    uniform: float = 0.25,
) -> Borders:
    """Subdivision with narrow rings and sectors where a pilot measured most light.

    After the paper's section 4 (and Greenberg et al. 1997): edges are quantiles of
    the pilot's flux over polar angle and over azimuth, mixed with a share of equal
    projected solid angles so that all directions keep some patches.

    Parameters
    ----------
    brdf : array_like, shape (subdivision.n_theta, subdivision.n_phi)
        Pilot's BRDF in 1/sr, or anything proportional to it.
    subdivision : RingsAndSectors
        The pilot's patches.
    n_theta, n_phi : int
        Rings and sectors to make.
    uniform : float
        Share of the patches that are spread uniformly, in (0, 1].

    Returns
    -------
    Borders

    Raises
    ------
    TypeError, ValueError
        If a number is out of its range, or `brdf` has another shape or no light.
    """
    uniform = checked_number(
        "uniform", uniform, 2.0**-30, 1 + 2.0**-52, "a number in (0, 1]"
    )
    n_theta, n_phi = checked_count("n_theta", n_theta), checked_count("n_phi", n_phi)
    brdf = np.asarray(brdf, dtype=float)
    if brdf.shape != subdivision.shape or not brdf.sum() > 0:
        raise SettingError(
            f"brdf must have the shape {subdivision.shape} and carry light, "
            f"got {brdf.shape}"
        )
    flux = brdf * subdivision.projected_solid_angles

    def _quantiles(marginal: Floats, measure: Floats, edges: Floats, n: int) -> Floats:
        density = (1 - uniform) * marginal / marginal.sum() + uniform * measure
        cumulative = np.append(0, np.cumsum(density))
        return np.interp(np.arange(1, n) / n, cumulative / cumulative[-1], edges)

    sin2 = np.sin(subdivision.theta_edges) ** 2
    inner = _quantiles(flux.sum(axis=1), np.diff(sin2), sin2, n_theta)
    theta = np.degrees(np.arcsin(np.sqrt(inner)))
    share = np.diff(subdivision.phi_edges) / (2 * np.pi)
    phi = np.degrees(_quantiles(flux.sum(axis=0), share, subdivision.phi_edges, n_phi))
    return Borders((0, *theta, 90), (0, *phi, 360))

"""Lobes between directions of incidence: sent by micro-normals that stay.

A brushed surface looks the same from everywhere, but for where it reflects light to:
light that was measured in one direction was reflected, if once, at the normal halfway
to where it came from (the half vector; Torrance and Sparrow 1967,
doi:10.1364/JOSA.57.001105), and at the same normal it is reflected elsewhere when it
comes from another direction. Rough glass refracts likewise (Walter et al. 2007,
doi:10.2312/EGWR/EGSR07/195-206). What would be sent beyond the horizon, or to where no
normal refracts, stays where it is, so that no light is lost.

The formulas are for NumPy and Dr.Jit alike.
"""

from typing import Any

import numpy as np

from ...array_types import Floats
from ...collector import RingsAndSectors
from ...collector.directions import direction

# Light is not moved so near to the horizon that it is seen as more times brighter.
MAX_BRIGHTENING = 4

# Points per side of a patch whose light is moved.
N_POINTS = 4


def reflected(wo: Any, before: Any, after: Any) -> tuple[list[Any], Any]:
    """Where a micro-normal reflects light to that comes from another direction.

    Parameters
    ----------
    wo, before, after : sequence of three coordinates
        Unit vectors away from the surface: to where the normal reflects light, to
        where that light came from, and to where other light comes from.

    Returns
    -------
    list of three coordinates
        Unit vector, perhaps below the horizon.
    float or array
        Solid angle there for one at `wo`.
    """
    half = [a + b for a, b in zip(wo, before)]
    turned = [a - b for a, b in zip(after, before)]
    # by differences: light that comes from the same direction stays, to the last digit
    more = _dot(half, turned) / _dot(half, before)
    to = [a + more * b - c for a, b, c in zip(wo, half, turned)]
    return to, 1 + more


def _dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def refracted(
    wo: Any, before: Any, after: Any, eta: Any, xp: Any
) -> tuple[list[Any], Any, Any]:
    """Where a micro-normal refracts light to that comes from another direction.

    Parameters
    ----------
    wo, before, after : sequence of three coordinates
        As for :func:`reflected`, but `wo` and what is returned are on the other side
        of the surface, and z is their depth.
    eta : float or array
        Refractive index of that side, relative to that of the light, which is not 1.
    xp : module
        NumPy or Dr.Jit.

    Returns
    -------
    list of three coordinates
        Unit vector, perhaps above the horizon.
    float or array
        Solid angle there for one at `wo` (Walter et al. 2007,
        doi:10.2312/EGWR/EGSR07/195-206, equation 17).
    bool or array
        Whether any normal refracts both; what is returned is finite where none does.
    """
    side = xp.sign(1 - eta)
    through = [wo[0], wo[1], -wo[2]]
    half = [side * (b + eta * o) for b, o in zip(before, through)]
    length = xp.sqrt(xp.maximum(_dot(half, half), 2.0**-60))
    normal = [one / length for one in half]
    came, went = _dot(normal, before), -_dot(normal, through)
    comes = _dot(normal, after)
    cos2 = 1 - (1 - comes * comes) / eta**2
    goes_on = xp.sqrt(xp.maximum(cos2, 0))
    valid = (normal[2] > 0) & (came > 0) & (went > 0) & (comes > 0) & (cos2 > 2.0**-40)
    to = [(comes / eta - goes_on) * n - a / eta for n, a in zip(normal, after)]
    rate = went * ((comes - eta * goes_on) / (came - eta * went)) ** 2
    return [to[0], to[1], -to[2]], rate / xp.maximum(goes_on, 2.0**-20), valid


def redirected(
    wo: Any, before: Any, after: Any, eta: Any, xp: Any
) -> tuple[list[Any], Any, Any]:
    """:func:`refracted`, or without `eta` :func:`reflected`, which is always valid."""
    if eta is None:
        return *reflected(wo, before, after), wo[2] > 0
    return refracted(wo, before, after, eta, xp)


def is_redirected(z: Any, to: Any) -> Any:
    """Whether light moves from the height `z` to the height `to` of a direction."""
    return (z > 0) & (to > 0) & (z <= MAX_BRIGHTENING * to)


def predicted_lobes(
    flux: Floats,
    patches: RingsAndSectors,
    theta_i: float,
    phi_i: tuple[float, float],
    eta: float | None = None,
) -> tuple[Floats, Floats]:
    """Lobe for another azimuth of incidence: turned, and sent by its micro-normals.

    Parameters
    ----------
    flux : ndarray, shape (n_theta, n_phi, channels)
        Flux fractions.
    patches : RingsAndSectors
    theta_i : float
        In degrees.
    phi_i : (float, float)
        Azimuths in degrees at which it was measured, and for which it is wanted.
    eta : float, optional
        Of a lobe of transmission the refractive index.

    Returns
    -------
    turned, moved : ndarray, shape (n_theta, n_phi, channels)
        As it is if it turns with incidence, and if micro-normals stay where they are.
        Both hold the same light in all.
    """
    wo = np.moveaxis(patches.points(N_POINTS), -1, 0)
    before, after = (direction(np.radians(theta_i), np.radians(phi)) for phi in phi_i)
    turn = np.radians(phi_i[1] - phi_i[0])
    x, y, z = wo
    own = [
        x * np.cos(turn) + y * np.sin(turn),
        y * np.cos(turn) - x * np.sin(turn),
        z,
    ]
    lobe = _Lobe(flux, patches)
    unmoved = lobe.at(own)
    source, scale, valid = redirected(wo, after, before, eta, np)
    comes = valid & is_redirected(source[2], z)
    stretch = np.where(comes, source[2] * scale / z, 0)[..., None]
    to, _, valid = redirected(own, before, after, eta, np)
    stays = ~(valid & is_redirected(z, to[2]))[..., None]
    source[2] = np.where(comes, source[2], 1)
    moved = stretch * lobe.at(source) + stays * unmoved
    return lobe.means(unmoved), lobe.means(moved)


class _Lobe:
    """Lobe on patches, linear within each."""

    def __init__(self, flux: Floats, patches: RingsAndSectors) -> None:
        self.flux, self.patches = flux, patches
        self.areas = patches.projected_solid_angles[..., None]
        self.brdf = flux / self.areas
        edges = patches.theta_edges, patches.phi_edges
        self.edges = np.sin(edges[0]) ** 2, edges[1]
        self.changes = gradients(self.brdf, *edges)

    def at(self, wo: Any) -> Floats:
        """BRDF at unit vectors above the horizon, a column for each channel."""
        directions = np.stack(list(wo), axis=-1)
        number = self.patches.patch(directions)
        place = np.unravel_index(number, self.patches.shape)
        value = self.brdf[place]
        coordinates = wo[0] ** 2 + wo[1] ** 2, np.arctan2(wo[1], wo[0]) % (2 * np.pi)
        for edges, own, change, at in zip(self.edges, place, self.changes, coordinates):
            part = (at - edges[own]) / (edges[own + 1] - edges[own]) - 0.5
            value = value + np.clip(part, -0.5, 0.5)[..., None] * change[place]
        return value

    def means(self, values: Floats) -> Floats:
        """Flux fractions of values at the points of each patch; no light is lost."""
        flux = values.mean(axis=1).reshape(self.flux.shape) * self.areas
        total, wanted = flux.sum(axis=(0, 1)), self.flux.sum(axis=(0, 1))
        return flux * np.divide(wanted, total, where=total > 0, out=np.ones_like(total))


def gradients(brdf: Floats, theta_edges: Floats, phi_edges: Floats) -> Floats:
    r"""Changes of a lobe across each patch, estimated from the patches around it.

    With coordinates from 0 to 1 across a patch, uniform in :math:`\sin^2\theta` and in
    azimuth, the lobe is the mean plus the gradients times the coordinates less 1/2:
    whatever they are, the mean is kept. They are central differences, one-sided at the
    pole and the horizon, and reduced to where nothing becomes negative (van Leer 1977,
    doi:10.1016/0021-9991(77)90095-X).

    Parameters
    ----------
    brdf : ndarray, shape (..., n_theta, n_phi, channels)
        Patch means.
    theta_edges, phi_edges : ndarray, shapes (n_theta + 1,), (n_phi + 1,)
        In radians, the latter all around.

    Returns
    -------
    ndarray, shape (2, ..., n_theta, n_phi, channels)
        From the lower to the upper edge in polar angle, and in azimuth.
    """
    found = np.zeros((2, *brdf.shape))
    sin2, n_theta = np.sin(theta_edges) ** 2, brdf.shape[-3]
    middle, width = (sin2[1:] + sin2[:-1]) / 2, np.diff(sin2)
    below = np.maximum(np.arange(n_theta) - 1, 0)
    above = np.minimum(np.arange(n_theta) + 1, n_theta - 1)
    if n_theta > 1:
        steps = (width / (middle[above] - middle[below]))[:, None, None]
        found[0] = (brdf[..., above, :, :] - brdf[..., below, :, :]) * steps
    width = np.diff(phi_edges)
    around = width + (np.roll(width, 1) + np.roll(width, -1)) / 2
    before, after = np.roll(brdf, 1, axis=-2), np.roll(brdf, -1, axis=-2)
    found[1] = (after - before) * (width / around)[:, None]
    most = np.abs(found).sum(axis=0) / 2
    return found * np.divide(brdf, most, where=most > brdf, out=np.ones(brdf.shape))

"""Beckmann's and GGX's micro-normals, and Smith's masking, in closed form.

After Walter et al. 2007 (doi:10.2312/EGWR/EGSR07/195-206) and Heitz 2014 (JCGT 3(2)).
"""

import numpy as np
from scipy import special

from ..array_types import Floats

DISTRIBUTIONS = ("beckmann", "ggx")

# Points of azimuth over which the density is averaged: exact to rounding unless one
# alpha is many times the other.
N_AZIMUTHS = 256

# Alpha of a direction without slopes, of which the models have none.
MIN_ALPHA = 1e-6

# Rounds of a fixed point that gains a digit in three.
N_ITERATIONS = 60


def ring_shares(
    distribution: str, edges: Floats, alpha_u: float, alpha_v: float
) -> Floats:
    """Parts of the projected area of all facets in rings with `edges` in degrees.

    Slopes over their alphas have a length whose distribution is known, at azimuths that
    are uniform: however narrow a lobe is, none of it is missed.
    """
    turn = 2 * np.pi * (np.arange(N_AZIMUTHS) + 0.5) / N_AZIMUTHS
    alpha = np.hypot(np.cos(turn) * alpha_u, np.sin(turn) * alpha_v)
    square = (np.tan(np.radians(edges))[:, None] / alpha) ** 2
    beckmann = distribution == "beckmann"
    within = -np.expm1(-square) if beckmann else square / (1 + square)
    return np.diff(within.mean(axis=1))


def ring_means(
    distribution: str, edges: Floats, alpha_u: float, alpha_v: float
) -> Floats:
    """Means in 1/sr of the density of micro-normals over rings with `edges` in degrees.

    Of ``n + 1`` edges from 0 to 90, ascending, shape ``(n,)``. Integrals over the part
    of the facets, and not over angles: a lobe however narrow is met.
    """
    turn = 2 * np.pi * (np.arange(N_AZIMUTHS) + 0.5) / N_AZIMUTHS
    alpha2 = (np.cos(turn) * alpha_u) ** 2 + (np.sin(turn) * alpha_v) ** 2
    with np.errstate(over="ignore"):
        square = np.tan(np.radians(edges))[:, None] ** 2 / alpha2
        # the square of it is the part of the projected area that is steeper
        beckmann = distribution == "beckmann"
        root = np.exp(-square / 2) if beckmann else (1 + square) ** -0.5
    nodes, weights = np.polynomial.legendre.leggauss(16)
    high, low = root[:-1, :, None], root[1:, :, None]
    at = (high + low) / 2 + nodes * (high - low) / 2
    at = np.maximum(at, np.finfo(float).tiny)  # of an empty ring
    slope2 = (-2 * np.log(at) if beckmann else at**-2.0 - 1) * alpha2[:, None]
    area = (2 * at * np.sqrt(1 + slope2) * weights).sum(axis=-1)
    area = (area * (root[:-1] - root[1:]) / 2).mean(axis=-1)
    return area / (-2 * np.pi * np.diff(np.cos(np.radians(edges))))


def smith_lambda(
    distribution: str, theta: Floats, phi: Floats, alpha_u: float, alpha_v: float
) -> Floats:
    """Smith's auxiliary function of a direction, by angles in radians."""
    alpha = np.hypot(np.cos(phi) * alpha_u, np.sin(phi) * alpha_v)
    with np.errstate(divide="ignore"):
        a = 1 / (alpha * np.tan(theta))
    if distribution == "ggx":
        return (np.sqrt(1 + a**-2.0) - 1) / 2
    return special.erfc(a) / -2 + np.exp(-(a**2)) / (2 * np.sqrt(np.pi) * a)


def masking(
    distribution: str, theta: Floats, phi: Floats, alpha_u: float, alpha_v: float
) -> Floats:
    """Smith's visible part of the facets that look towards a direction."""
    return 1 / (1 + smith_lambda(distribution, theta, phi, alpha_u, alpha_v))


def fitted_alphas(
    distribution: str, slope_u: Floats, slope_v: Floats, weight: Floats
) -> Floats:
    """Both alphas of largest likelihood for the slopes of facets.

    `weight` is projected area. For Beckmann they are sqrt(2) times the rms slopes; for
    GGX, whose slopes have no variance, those in which a steep facet counts less. Where
    all slopes lie in one direction, as those of grooves, the density that is fitted is
    the marginal one of that direction, (1 + slope^2 / alpha^2)^(-3/2) for GGX.
    """
    weight = weight / weight.sum()
    squares = np.stack([slope_u, slope_v]) ** 2
    alphas = np.maximum(np.sqrt(2 * squares @ weight), MIN_ALPHA)
    if distribution == "beckmann":
        return alphas
    # twice the exponent of the density
    exponent = 4 if np.all(alphas > MIN_ALPHA) else 3
    for _ in range(N_ITERATIONS):
        steepness = alphas**-2.0 @ squares
        variances = exponent * squares @ (weight / (1 + steepness))
        alphas = np.maximum(np.sqrt(variances), MIN_ALPHA)
    return alphas

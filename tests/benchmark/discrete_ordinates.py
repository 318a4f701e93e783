"""Exact theory of light in plane-parallel media: discrete ordinates."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gonio_mi.array_types import Floats
from gonio_mi.collector import Subdivision, subdivision

# Optical thickness, albedo, and the Legendre coefficient of each order.
Layer = tuple[float, float, Callable[[int], float]]

# The program solves for albedos below 1 only; it loses 1e-7 at each scattering.
NEARLY_1 = 1 - 1e-7

# Points of the rule over each patch, along either side.
NODES = 6


def henyey_greenstein(g: float) -> Callable[[int], float]:
    """Legendre coefficients of the phase function."""
    return lambda order: float(g) ** order


def theory(
    layers: Sequence[Layer],
    theta_i: float,
    collector: str | Subdivision,
    *,
    base: float = 0.0,
    streams: int = 64,
) -> tuple[Floats, Floats, float]:
    """Diffuse flux fractions of plane-parallel layers with matched boundaries.

    By discrete ordinates (Stamnes et al. 1988, the program PythonicDISORT).

    Parameters
    ----------
    layers : sequence of Layer
        From above.
    theta_i : float
        In degrees, at the azimuth 0.
    collector : str or Subdivision
        Into rings and sectors.
    base : float
        Reflectance of a Lambertian base.
    streams : int
        Ordinates of both hemispheres.

    Returns
    -------
    fluxes : ndarray, shape (2, n_theta, n_phi)
    totals : ndarray, shape (2,)
        Reflected and transmitted, of all but the direct light.
    direct : float
        That passes without any event.

    Raises
    ------
    ImportError
        Without PythonicDISORT.
    """
    from PythonicDISORT import pydisort
    from PythonicDISORT.subroutines import interpolate

    taus, albedos, legendres = zip(*layers)
    mu0 = np.cos(np.radians(theta_i))
    table = np.array([[c(n) for n in range(2 * streams)] for c in legendres])
    table[:, 0] = 1
    depth = np.cumsum(taus)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # albedos near 1
        _, up, down, _, radiance = pydisort(
            depth,
            np.minimum(albedos, NEARLY_1),
            streams,
            table,
            mu0,
            1.0,
            np.pi,
            NLeg=streams,
            f_arr=table[:, streams],
            NT_cor=True,
            BDRF_Fourier_modes=[base] if base else [],
        )
        radiance = interpolate(radiance, NT_cor="eval")
    totals = np.array([up(0.0), 0.0 if base else down(depth[-1])[0]]) / mu0
    patches: Any = subdivision(collector)
    fluxes = []
    x, weights = np.polynomial.legendre.leggauss(NODES)
    mu, mu_w = _between(np.cos(patches.theta_edges)[::-1], x, weights)
    phi, phi_w = _between(patches.phi_edges, x, weights)
    for tau, sign in ((0.0, 1), (depth[-1], -1)):
        values = np.asarray(radiance(sign * mu.ravel(), tau, phi.ravel()))
        values = values.reshape(*mu.shape, *phi.shape) / mu0
        fluxes.append(np.einsum("aibj,ai,bj->ab", values, mu * mu_w, phi_w)[::-1])
    direct = 0.0 if base else float(np.exp(-depth[-1] / mu0))
    return np.array(fluxes), totals, direct


def _between(edges: Floats, x: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Nodes and weights of a rule on [-1, 1], between neighbouring edges."""
    half = np.diff(edges)[:, None] / 2
    return edges[:-1, None] + half * (1 + x), half * weights

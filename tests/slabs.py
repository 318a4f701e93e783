"""Specimens of plane-parallel media, and what exact theory says of them."""

import warnings
from itertools import pairwise

import mitsuba as mi
import numpy as np
from PythonicDISORT import pydisort
from PythonicDISORT.subroutines import interpolate

import gonio_mi as gonio

NULL = {"type": "null"}
# The program solves for albedos below 1 only; it loses 1e-7 at each scattering.
NEARLY_1 = 1 - 1e-7


def medium(sigma_t=1.0, albedo=0.9, phase=0.0, **more):
    """Medium object; `phase` is a dictionary or the g of Henyey and Greenstein."""
    if not isinstance(phase, dict):
        phase = {"type": "hg", "g": float(phase)} if phase else {"type": "isotropic"}
    coefficients = {"sigma_t": _float(sigma_t), "albedo": _float(albedo)}
    return mi.load_dict({"type": "homogeneous", **coefficients, "phase": phase, **more})


def rectangle(z, above=None, below=None, bsdf=NULL, size=1.0):
    """Horizontal square, with its media; `bsdf` belongs to its upper face."""
    to_world = mi.ScalarTransform4f().translate([0, 0, z]).scale(size)
    media = {"exterior": above, "interior": below}
    media = {side: one for side, one in media.items() if one is not None}
    return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf, **media}


def stack(*media, thickness=1.0, bsdf=NULL, base=None, size=1.0):
    """Scene of layers of `media` from above, all with `bsdf` above and below.

    `base` is a BSDF that lies below instead.
    """
    around = [None, *media, None]
    shapes = {
        f"interface_{i}": rectangle(-i * thickness, above, below, bsdf, size)
        for i, (above, below) in enumerate(pairwise(around))
    }
    if base is not None:
        bottom = rectangle(-len(media) * thickness, bsdf=base, size=size)
        shapes[f"interface_{len(media)}"] = bottom
    return {"type": "scene", **shapes}


def henyey_greenstein(g):
    """Legendre coefficients of the phase function."""
    return lambda order: float(g) ** order


def theory(layers, theta_i, collector, *, base=0.0, streams=64, nodes=6):
    """Diffuse flux fractions of plane-parallel layers with matched boundaries.

    By discrete ordinates (Stamnes et al. 1988, the program PythonicDISORT).

    Parameters
    ----------
    layers : list of (tau, albedo, legendre)
        From above; `legendre` gives the coefficient of each order.
    theta_i : float
        In degrees, at the azimuth 0.
    collector : str
    base : float
        Reflectance of a Lambertian base.

    Returns
    -------
    patches : ndarray, shape (2, n_theta, n_phi)
    totals : ndarray, shape (2,)
        Reflected and transmitted, of all but the direct light.
    direct : float
        That passes without any event.
    """
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
    patches = gonio.subdivision(collector)
    fluxes = []
    x, weights = np.polynomial.legendre.leggauss(nodes)
    mu, mu_w = _between(np.cos(patches.theta_edges)[::-1], x, weights)
    phi, phi_w = _between(patches.phi_edges, x, weights)
    for tau, sign in ((0.0, 1), (depth[-1], -1)):
        values = np.asarray(radiance(sign * mu.ravel(), tau, phi.ravel()))
        values = values.reshape(*mu.shape, *phi.shape) / mu0
        fluxes.append(np.einsum("aibj,ai,bj->ab", values, mu * mu_w, phi_w)[::-1])
    direct = 0.0 if base else float(np.exp(-depth[-1] / mu0))
    return np.array(fluxes), totals, direct


def _between(edges, x, weights):
    """Nodes and weights of a rule on [-1, 1], between neighbouring edges."""
    half = np.diff(edges)[:, None] / 2
    return edges[:-1, None] + half * (1 + x), half * weights


def chandrasekhar(mu, albedo, nodes=200):
    """Chandrasekhar's H function of isotropic scattering, by iteration.

    His *Radiative Transfer* (1950), chapter V, in the form 1/H that converges.
    """
    x, weights = np.polynomial.legendre.leggauss(nodes)
    x, weights = (x + 1) / 2, weights / 2
    h = np.ones(nodes)

    def at(m):
        ratios = weights * x * h / (np.asarray(m)[..., None] + x)
        return 1 / (np.sqrt(1 - albedo) + albedo / 2 * ratios.sum(axis=-1))

    for _ in range(200):
        h = at(x)
    return at(mu)


def _float(value):
    """What Mitsuba takes, which wants no integer."""
    return float(value) if isinstance(value, int) else value

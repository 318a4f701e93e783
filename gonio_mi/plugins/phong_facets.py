"""Microfacets with an anisotropic Phong distribution, in NumPy: means over the facets.

The distribution of Ashikhmin, Premoze and Shirley (2000), a density of facet normals h
per unit *facet* area: p(h) = c (h.n)^E, E = e_u cos^2(phi_h) + e_v sin^2(phi_h), with
c = sqrt((e_u + 1)(e_v + 1)) / (2 pi).
"""

from functools import lru_cache

import numpy as np

from ..array_types import Floats

# Rows and columns of the table, and of the exact values that a spline refines into it.
N_NODES, N_EXACT = 257, 65


def mean_cosine(e_u: float, e_v: float) -> float:
    """Mean of h.n: the mean surface's area per unit facet area, exact."""
    return np.sqrt((e_u + 1) * (e_v + 1) / ((e_u + 2) * (e_v + 2)))


def averted_area(k: Floats, e_u: float, e_v: float, n_nodes: int = 32) -> Floats:
    """Projected area towards `k` of the facets that face away from it.

    The integral of ``-(h.k) p(h)`` over ``h.k < 0``. Over the polar angle of h it is an
    incomplete beta function; over the azimuth it is summed by Gauss's rule, in the
    variable in which facets are uniform, with nodes gathered at the ends.

    Parameters
    ----------
    k : array_like, shape (..., 3)
        Vectors with z >= 0; not normalised, the area is proportional to their length.
    e_u, e_v : float
    n_nodes : int
        32 give a relative error in g(k) below 1e-6.

    Returns
    -------
    ndarray, shape (...)
    """
    from scipy import special  # slow to import

    x, y, z = np.moveaxis(np.asarray(k, dtype=float)[..., None], -2, 0)
    node, weight = np.polynomial.legendre.leggauss(n_nodes)
    weight = weight * 1.5 * (1 - node**2) / 4
    node = (3 * node - node**3) / 2
    root_u, root_v = np.sqrt(e_u + 1), np.sqrt(e_v + 1)
    psi = np.arctan2(y * root_u, x * root_v) + np.pi + node * np.pi / 2
    cos, sin = root_v * np.cos(psi), root_u * np.sin(psi)
    norm = np.hypot(cos, sin)
    cos, sin = cos / norm, sin / norm
    exponent = e_u * cos**2 + e_v * sin**2
    away = np.maximum(-(x * cos + y * sin), 0)
    # squared sine of the polar angle from which on the facets face away
    with np.errstate(invalid="ignore"):
        edge = np.nan_to_num(z**2 / (away**2 + z**2), nan=1.0)
    half = (exponent + 3) / 2
    area = z * (1 - edge) ** (exponent / 2 + 1) / (exponent + 2)
    area += away * special.beta(half, 0.5) * (1 - special.betainc(0.5, half, edge)) / 2
    return area @ weight


@lru_cache(maxsize=16)
def averted_area_table(e_u: float, e_v: float) -> Floats:
    r"""Table of :func:`averted_area` for linear interpolation between its nodes.

    Row j and column i hold the area for the vector with
    :math:`|k_x| / \sqrt{e_u + 1} = (1 - a)(1 - q)`,
    :math:`|k_y| / \sqrt{e_v + 1} = (1 - a) q` and :math:`k_z = a`, where
    a = i / 256 and q = j / 256.

    The area is a convex function of k, and each step of a bilinear interpolation goes
    along a line in the space of k, so that the interpolated area is not too small. It
    makes g(k) too large by at most 2e-5 of its value, and too small by at most 5e-7
    for the errors of the nodes, for exponents from 0 to 1e6.

    Returns
    -------
    ndarray of float32, shape (257, 257)
    """
    from scipy.interpolate import RectBivariateSpline  # slow, and used here only

    a = np.linspace(0, 1, N_EXACT)
    q = a[:, None]
    stretched = (1 - a) * (1 - q) * np.sqrt(e_u + 1), (1 - a) * q * np.sqrt(e_v + 1), a
    exact = averted_area(np.stack(np.broadcast_arrays(*stretched), axis=-1), e_u, e_v)
    nodes = np.linspace(0, 1, N_NODES)
    table = RectBivariateSpline(a, a, exact)(nodes, nodes).astype(np.float32)
    # the area is 0 for k = n, and the spline may be below that by 1e-9
    table = np.maximum(table, 0)
    table.flags.writeable = False
    return table

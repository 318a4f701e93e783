"""Independent references: quadrature of `eval`, Fresnel's formulas, slabs."""

import drjit as dr
import mitsuba as mi
import numpy as np

from gonio_mi.collector.directions import direction


def fresnel(cos_i, eta):
    """Reflectance of a smooth dielectric for unpolarised light, in float64.

    `eta` is the index of the far side over that of the near side.
    """
    sin2_t = (1 - cos_i**2) / eta**2
    if sin2_t >= 1:
        return 1.0
    cos_t = np.sqrt(1 - sin2_t)
    r_s = (cos_i - eta * cos_t) / (cos_i + eta * cos_t)
    r_p = (eta * cos_i - cos_t) / (eta * cos_i + cos_t)
    return (r_s**2 + r_p**2) / 2


def slab(cos_i, eta):
    """Reflectance of a clear slab with all internal reflections, incoherently."""
    r = fresnel(cos_i, eta)
    return 2 * r / (1 + r)


def vectors(v):
    """Mitsuba's vectors of an array of shape ``(..., 3)``.

    Gathered: what NumPy has allocated may not be aligned, which is another kernel.
    """
    flat = mi.Float(np.float32(v).ravel())
    n = dr.width(flat) // 3
    found = dr.gather(mi.Vector3f, flat, dr.arange(mi.UInt32, n))
    dr.eval(found)
    return found


def eval_flux(bsdf, theta_i, phi_i, wo, *, side="front", nm=None):
    """``eval``, which includes the cosine, in importance mode; degrees and world frame.

    The frame is that of a rectangle in z = 0: local and world directions agree.
    Returns float64 of shape ``(n, channels)``.
    """
    wi = direction(np.radians(theta_i), np.radians(phi_i))
    if side == "back":
        wi = wi * [1, 1, -1]
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.t = 1.0
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), si.n)
    si.dp_du, si.dp_dv = mi.Vector3f(2, 0, 0), mi.Vector3f(0, 2, 0)
    si.uv = mi.Point2f(0.5)
    if nm is not None:
        si.wavelengths = mi.Spectrum(nm)
    si.wi = mi.Vector3f(wi.tolist())
    dr.make_opaque(si.wi)  # one kernel for all directions
    ctx = mi.BSDFContext(mi.TransportMode.Importance)
    values = np.array(bsdf.eval(ctx, si, vectors(wo)), dtype=float)
    return np.broadcast_to(
        values.reshape(-1, values.shape[-1]).T, (len(wo), len(values))
    )


def patch_fluxes(f, subdivision, *, tolerance, lower=False, finest=256):
    """Integral of `f` over every patch, by Gauss-Legendre rules refined to convergence.

    Parameters
    ----------
    f : callable
        Takes directions ``(n, 3)``, returns ``(n, channels)``.
    tolerance : float or ndarray, shape (n_theta, n_phi)
        A patch is refined, by doubling the points per side, until its last change is
        below this.
    lower : bool
        Integrate over the lower hemisphere.

    Returns
    -------
    values, errors : ndarray, shape (n_theta, n_phi, channels)
        `errors` is the last change, which overstates that of a converging rule.
    """
    n_theta, n_phi = subdivision.shape
    low_t, high_t = (edge.repeat(n_phi) for edge in _pairs(subdivision.theta_edges))
    low_p, high_p = (np.tile(edge, n_theta) for edge in _pairs(subdivision.phi_edges))
    tolerance = np.broadcast_to(tolerance, (n_theta, n_phi)).ravel()

    def rule(which, order):
        x, w = np.polynomial.legendre.leggauss(order)
        # in theta, points crowd at the borders: a lobe of a grazing beam can be thinner
        # than any even spacing, and be missed by two rules in a row
        s, ds = (
            (1 - np.cos(np.pi * (x + 1) / 2)),
            np.pi / 2 * np.sin(np.pi * (x + 1) / 2),
        )
        theta = low_t[which, None] + (high_t - low_t)[which, None] * s / 2
        phi = low_p[which, None] + (high_p - low_p)[which, None] * (x + 1) / 2
        theta, phi = np.broadcast_arrays(theta[:, :, None], phi[:, None, :])
        wo = direction(np.pi - theta if lower else theta, phi)
        area = ((high_t - low_t) * (high_p - low_p))[which] / 4
        values = f(wo.reshape(-1, 3)).reshape(len(which), order, order, -1)
        sines = np.sin(theta)[..., None]
        return np.einsum("nijc,i,j,n->nc", values * sines, w * ds, w, area)

    order = 8
    values = rule(np.arange(n_theta * n_phi), order)
    errors = np.full_like(values, np.inf)
    while order < finest:
        order *= 2
        todo = np.flatnonzero((errors > tolerance[:, None]).any(axis=1))
        # at most some million directions at a time
        for part in np.array_split(todo, len(todo) * order**2 // 2_000_000 + 1):
            if len(part):
                finer = rule(part, order)
                errors[part] = np.abs(finer - values[part])
                values[part] = finer
    return values.reshape(n_theta, n_phi, -1), errors.reshape(n_theta, n_phi, -1)


def _pairs(edges):
    return edges[:-1], edges[1:]


def micro_normal_density(distribution, theta, alpha_u, alpha_v, n=256):
    """Density of micro-normals in 1/sr at polar angles in radians, mean over azimuth.

    Its integral over the hemisphere is 1 with the cosine. Over `n` azimuths the mean is
    exact to rounding unless one alpha is many times the other.
    """
    phi = 2 * np.pi * np.arange(n) / n
    stretch = (np.cos(phi) / alpha_u) ** 2 + (np.sin(phi) / alpha_v) ** 2
    square = np.tan(theta)[..., None] ** 2 * stretch
    factor = np.exp(-square) if distribution == "beckmann" else (1 + square) ** -2
    return factor.mean(axis=-1) / (np.pi * alpha_u * alpha_v * np.cos(theta) ** 4)

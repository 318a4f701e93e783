"""Gradients of a lobe within patches, from the patch means."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


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

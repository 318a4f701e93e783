"""Directions and angles: the one azimuth and polar convention of the instrument."""

import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Floats


def direction(theta: ArrayLike, phi: ArrayLike) -> Floats:
    """Unit vectors for polar angles and azimuths.

    Parameters
    ----------
    theta : array_like
        Polar angle from +z, in radians, in [0, pi].
    phi : array_like
        Azimuth from +x, counter-clockwise seen from +z, in radians.

    Returns
    -------
    ndarray, shape (..., 3)
        ``(sin theta cos phi, sin theta sin phi, cos theta)``.
    """
    theta, phi = np.asarray(theta, dtype=float), np.asarray(phi, dtype=float)
    found = np.empty((*np.broadcast_shapes(theta.shape, phi.shape), 3))
    sin_theta = np.sin(theta)
    found[..., 0] = sin_theta * np.cos(phi)
    found[..., 1] = sin_theta * np.sin(phi)
    found[..., 2] = np.cos(theta)
    return found


def angles(v: ArrayLike) -> tuple[Floats, Floats]:
    """Polar angle in [0, pi] and azimuth in [0, 2 pi), in radians.

    Parameters
    ----------
    v : array_like, shape (..., 3)
        Directions; they need not be normalised.

    Returns
    -------
    theta, phi : ndarray, shape (...)
        At the pole, where every azimuth meets, ``phi`` is 0.
    """
    x, y, z = np.moveaxis(np.asarray(v, dtype=float), -1, 0)
    phi = np.arctan2(y, x)
    phi = np.where(phi < 0, phi + 2 * np.pi, phi)
    phi = np.where((phi >= 2 * np.pi) | ((x == 0) & (y == 0)), 0.0, phi)
    return np.arctan2(np.hypot(x, y), z), phi


def azimuths_deg(phi: ArrayLike) -> Floats:
    """Azimuths in degrees, turned into [0, 360): what is 360 by rounding is 0."""
    turned = np.mod(np.asarray(phi, dtype=float), 360)
    return np.where(turned >= 360 - 1e-9, 0.0, turned)

"""Stokes vectors and Mueller matrices: the one convention of frames and signs.

A Stokes vector (I, Q, U, V) is that of a beam along `k` in the frame of s and
p = k x s, so that (s, p, k) is right-handed: Q = I_s - I_p, U is positive for light
that oscillates half-way from s to p, and V is positive for a field that turns clockwise
in the eye of whoever looks towards the source. The frame of the instrument has
s = k x z; along the z axis it is that of the azimuth 0, so that s is along y. Mitsuba's
matrices are given in frames of its own, of :func:`implicit_axis`, which change
continuously everywhere except at the horizon.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from ..array_types import Floats, Numbers

# Effect of a reversal of the beam on its Stokes vector where s = k x z.
EXCHANGE = np.diag([1.0, 1.0, -1.0, 1.0])

# Normal of the specimen.
UPRIGHT = np.array([0.0, 0.0, 1.0])


def implicit_axis(k: Numbers) -> Floats:
    """First axis of Mitsuba's frame of beams along `k`, both of shape (..., 3).

    ``mi.mueller.stokes_basis`` (Duff et al. 2017, JCGT 6, 1).
    """
    x, y, z = np.moveaxis(np.asarray(k, dtype=float), -1, 0)
    sign = np.copysign(1.0, z)
    a = -1 / (sign + z)
    return np.stack([1 + sign * x**2 * a, sign * x * y * a, -sign * x], axis=-1)


def plane_axis(k: Numbers, normal: Numbers = UPRIGHT) -> Floats:
    """Axis s = k x normal, a unit vector of shape (..., 3).

    Along the normal it is that of the azimuth 0.
    """
    k, normal = np.asarray(k, dtype=float), np.asarray(normal, dtype=float)
    s = np.cross(k, normal)
    length = np.linalg.norm(s, axis=-1, keepdims=True)
    # perpendicular to the normal and to the x axis
    pole = np.cross(normal, [1.0, 0.0, 0.0])
    pole /= np.linalg.norm(pole)
    return np.where(length > 0, s / np.where(length > 0, length, 1.0), pole)


def turn(k: Numbers, old: Numbers, new: Numbers, share: float = 1.0) -> Floats:
    """Matrices that express Stokes vectors of beams along `k` in another frame.

    Parameters
    ----------
    k, old, new : array_like, shape (..., 3)
        Direction of the beam, and first axis of both frames.
    share : float
        Of the angle between both, by which the frame is turned.

    Returns
    -------
    ndarray, shape (..., 4, 4)
    """
    sine = np.sum(np.asarray(k, dtype=float) * np.cross(old, new), axis=-1)
    cosine = np.sum(np.asarray(old, dtype=float) * new, axis=-1)
    angle = 2 * share * np.arctan2(sine, cosine)
    found = np.zeros((*angle.shape, 4, 4))
    found[..., 0, 0] = found[..., 3, 3] = 1
    found[..., 1, 1] = found[..., 2, 2] = np.cos(angle)
    found[..., 1, 2], found[..., 2, 1] = np.sin(angle), -np.sin(angle)
    return found


def reframed(matrices: Numbers, turn_in: Numbers, turn_out: Numbers) -> Floats:
    """Mueller matrices, shape (..., 4, 4), in frames that are turned on both sides."""
    return turn_out @ matrices @ np.swapaxes(turn_in, -1, -2)


def coherency_eigenvalues(matrices: Numbers) -> Floats:
    """Eigenvalues of Cloude's coherency matrix over its trace, ascending, (..., 4).

    A Mueller matrix is a sum of Jones matrices if and only if none of them is negative
    (Cloude 1986, Optik 75, 26); the first element must be positive.
    """
    matrices = np.asarray(matrices, dtype=float)
    flat = matrices.reshape(*matrices.shape[:-2], 16)
    coherency = (flat @ _products()).reshape(matrices.shape) / 4
    return np.linalg.eigvalsh(coherency) / matrices[..., :1, 0]


@cache
def _products() -> Numbers:
    """Kronecker products of Pauli matrices, a row for each element, (16, 16)."""
    paulis = np.array(
        [
            [[1, 0], [0, 1]],
            [[1, 0], [0, -1]],
            [[0, 1], [1, 0]],
            [[0, -1j], [1j, 0]],
        ]
    )
    return np.array([np.kron(a, b.conj()).ravel() for a in paulis for b in paulis])

"""Mueller matrices of smooth interfaces in NumPy, from Jones matrices of s and p.

Fields oscillate as exp(-i omega t), so that the imaginary part of an index is positive;
p = k x s on both sides, Q = I_s - I_p, and V is positive for a field that turns
clockwise in the eye of whoever looks towards the source.
"""

import numpy as np

# (I, Q, U, V) of the products E_a E_b* of components, in the order ss, sp, ps, pp.
STOKES = np.array([[1, 0, 0, 1], [1, 0, 0, -1], [0, 1, 1, 0], [0, -1j, 1j, 0]])


def mueller(s, p):
    """Mueller matrices of diagonal Jones matrices, shape (..., 4, 4)."""
    s, p = np.broadcast_arrays(np.asarray(s, complex), np.asarray(p, complex))
    products = np.stack([s * s.conj(), s * p.conj(), p * s.conj(), p * p.conj()], -1)
    diagonal = products[..., None, :] * np.eye(4)
    return (STOKES @ diagonal @ np.linalg.inv(STOKES)).real


def reflection(cosine, index):
    """Of a smooth interface with a relative index, complex for a conductor."""
    cosine, index = np.asarray(cosine, dtype=float), complex(index)
    refracted = np.sqrt(1 - (1 - cosine**2) / index**2 + 0j)
    s = (cosine - index * refracted) / (cosine + index * refracted)
    p = (index * cosine - refracted) / (index * cosine + refracted)
    return mueller(s, p)


def transmission(cosine, index):
    """Of a smooth interface between dielectrics, as flux."""
    cosine = np.asarray(cosine, dtype=float)
    refracted = np.sqrt(1 - (1 - cosine**2) / index**2)
    s = 2 * cosine / (cosine + index * refracted)
    p = 2 * cosine / (index * cosine + refracted)
    return (index * refracted / cosine)[..., None, None] * mueller(s, p)

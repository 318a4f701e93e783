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


def of_jones(jones):
    """Mueller matrices of any Jones matrices of (s, p), shape (..., 4, 4)."""
    jones = np.asarray(jones, dtype=complex)
    products = np.einsum("...ij,...kl->...ikjl", jones, jones.conj())
    products = products.reshape(*jones.shape[:-2], 4, 4)
    return (STOKES @ products @ np.linalg.inv(STOKES)).real


def axes(k):
    """Axes s = k x z and p = k x s of a beam, as the columns of a matrix (3, 2)."""
    s = np.cross(k, [0.0, 0.0, 1.0])
    s = s / np.linalg.norm(s) if np.linalg.norm(s) > 1e-6 else np.array([0.0, 1.0, 0.0])
    return np.column_stack([s, np.cross(k, s)])


def reflected(k, normal, index):
    """Direction and 3 x 3 matrix of the field of a beam that a smooth wall reflects.

    Fields are followed as vectors in space (Chipman 1995, Opt. Eng. 34, 1636).
    """
    k, normal = np.asarray(k, dtype=float), np.asarray(normal, dtype=float)
    normal = normal / np.linalg.norm(normal)
    cosine = -(k @ normal)
    out = k + 2 * cosine * normal
    s = np.cross(k, normal) / np.linalg.norm(np.cross(k, normal))
    refracted = np.sqrt(1 - (1 - cosine**2) / complex(index) ** 2)
    r_s = (cosine - index * refracted) / (cosine + index * refracted)
    r_p = (index * cosine - refracted) / (index * cosine + refracted)
    p_in, p_out = np.cross(k, s), np.cross(out, s)
    return out, r_s * np.outer(s, s) + r_p * np.outer(p_out, p_in)


def polariser(k, absorbed):
    """3 x 3 matrix of an ideal polariser that absorbs along an axis (Korger 2013)."""
    transmitted = np.cross(k, absorbed) / np.linalg.norm(np.cross(k, absorbed))
    return np.outer(transmitted, transmitted)


def of_path(k_in, k_out, *fields):
    """Mueller matrix, in frames of s = k x z, of 3 x 3 matrices one after the other."""
    total = np.eye(3)
    for field in fields:
        total = field @ total
    return of_jones(axes(k_out).T @ total @ axes(k_in))


def rough_conductor(wi, wo, alpha, index):
    """BRDF of facets of a conductor in all elements, for one `wi` and many `wo`.

    Slopes after Trowbridge and Reitz, shadowing after Smith on either side; each facet
    is a mirror whose plane of incidence is that of both directions.
    """
    wi, wo = np.asarray(wi, dtype=float), np.asarray(wo, dtype=float)
    h = wi + wo
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    z = h[..., 2]
    density = alpha**2 / (np.pi * (z**2 * (alpha**2 - 1) + 1) ** 2)

    def shadowing(w):
        tangent2 = (1 - w[..., 2] ** 2) / w[..., 2] ** 2
        return 2 / (1 + np.sqrt(1 + alpha**2 * tangent2))

    size = density * shadowing(wi) * shadowing(wo) / (4 * wi[2] * wo[..., 2])
    matrices = reflection(np.sum(wo * h, axis=-1), index)
    turned = []
    for k, sign in ((np.broadcast_to(-wi, wo.shape), 1), (wo, -1)):
        s, own = np.cross(k, [0.0, 0.0, 1.0]), np.cross(k, h)
        sine = np.sum(k * np.cross(s, own), axis=-1)
        angle = 2 * sign * np.arctan2(sine, np.sum(s * own, axis=-1))
        turn = np.zeros((*angle.shape, 4, 4))
        turn[..., 0, 0] = turn[..., 3, 3] = 1
        turn[..., 1, 1] = turn[..., 2, 2] = np.cos(angle)
        turn[..., 1, 2], turn[..., 2, 1] = np.sin(angle), -np.sin(angle)
        turned.append(turn)
    into, back = turned
    return size[..., None, None] * (back @ matrices @ into)

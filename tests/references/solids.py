"""Free-standing solids in parallel light, traced by NumPy in double precision.

Rays are aimed at a disk across the beam, as wide as a ball about the solid: those that
pass beside it are no incident light. Surfaces are mirrors or Lambertian, on both sides.
Nothing here is the package's.
"""

import numpy as np

OFFSET = 1e-9
MAX_EVENTS = 60


def ellipsoid(*half):
    """Nearest distance to an ellipsoid about the origin, and the outer normal."""
    half = np.array(half)

    def hits(o, d):
        p, v = o / half, d / half
        a, b, c = (v * v).sum(1), (p * v).sum(1), (p * p).sum(1) - 1
        root = np.sqrt(np.maximum(b * b - a * c, 0))
        t = np.where(-b - root > OFFSET, -b - root, -b + root) / a
        met = (b * b > a * c) & (t > OFFSET)
        t = np.where(met, t, np.inf)
        n = (o + np.where(met, t, 0)[:, None] * d) / half**2
        return t, n / np.linalg.norm(n, axis=1, keepdims=True)

    return hits


def tube(radius, half):
    """The same for a cylinder along y without ends."""

    def hits(o, d):
        p, v = o[:, ::2] / radius, d[:, ::2] / radius
        a, b, c = (v * v).sum(1), (p * v).sum(1), (p * p).sum(1) - 1
        root = np.sqrt(np.maximum(b * b - a * c, 0))
        best = np.full(len(o), np.inf)
        for t in ((-b + root) / a, (-b - root) / a):
            y = o[:, 1] + np.where(np.isfinite(t), t, 0) * d[:, 1]
            met = (b * b > a * c) & (t > OFFSET) & (np.abs(y) <= half)
            best = np.where(met, np.minimum(t, best), best)
        n = (o + np.where(np.isfinite(best), best, 0)[:, None] * d) / radius
        return best, n * [1, 0, 1]

    return hits


def triangles(vertices, faces):
    """The same for a mesh (Moeller and Trumbore 1997)."""
    a, b, c = np.moveaxis(np.asarray(vertices, float)[np.asarray(faces)], 1, 0)
    e, f = b - a, c - a
    normal = np.cross(e, f)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)

    def hits(o, d):
        best, which = np.full(len(o), np.inf), np.zeros(len(o), int)
        for number in range(len(a)):
            p = np.cross(d, f[number])
            s = o - a[number]
            q = np.cross(s, e[number])
            with np.errstate(divide="ignore", invalid="ignore"):
                scale = 1 / (p @ e[number])
                u, v = (s * p).sum(1) * scale, (q * d).sum(1) * scale
                t = q @ f[number] * scale
                nearer = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > OFFSET) & (t < best)
            best, which = np.where(nearer, t, best), np.where(nearer, number, which)
        return best, normal[which]

    return hits


def torus(n_around, n_across, radius, thickness):
    """Vertices and faces of a torus about the z axis."""
    i, j = np.meshgrid(np.arange(n_around), np.arange(n_across), indexing="ij")
    u, v = 2 * np.pi * i / n_around, 2 * np.pi * j / n_across
    r = radius + thickness * np.cos(v)
    points = np.stack([r * np.cos(u), r * np.sin(u), thickness * np.sin(v)], axis=-1)

    def number(di, dj):
        return ((i + di) % n_around * n_across + (j + dj) % n_across).ravel()

    a, b, c, d = number(0, 0), number(1, 0), number(1, 1), number(0, 1)
    faces = np.r_[np.c_[a, b, c], np.c_[a, c, d]]
    return points.reshape(-1, 3), faces


def box(*half):
    """Vertices and faces of a box about the origin, normals outwards."""
    corners = np.array(np.meshgrid(*[[-1, 1]] * 3, indexing="ij")).reshape(3, -1).T
    faces = []
    for axis in range(3):
        for sign in (-1, 1):
            one = np.flatnonzero(corners[:, axis] == sign)
            a, b, c, d = one[[0, 1, 3, 2]]
            across = np.cross(corners[b] - corners[a], corners[c] - corners[a])
            if across[axis] * sign < 0:
                b, d = d, b
            faces += [(a, b, c), (a, c, d)]
    return corners * np.array(half), np.array(faces)


def outgoing(hits, wi, radius, n, mirror, seed=0):
    """Directions of light from `wi` that met the solid, after all its events."""
    rng = np.random.default_rng(seed)
    wi = np.array(wi)
    across = np.linalg.svd(wi[None])[2][1:]
    r, phi = radius * np.sqrt(rng.uniform(size=n)), rng.uniform(0, 2 * np.pi, n)
    o = np.stack([r * np.cos(phi), r * np.sin(phi)], axis=1) @ across + 2 * radius * wi
    d = np.tile(-wi, (n, 1))
    met, flying = np.zeros(n, bool), np.arange(n)
    for _ in range(MAX_EVENTS):
        t, normal = hits(o[flying], d[flying])
        hit = np.isfinite(t)
        flying, t, normal = flying[hit], t[hit], normal[hit]
        met[flying] = True
        v = d[flying]
        normal *= -np.sign((normal * v).sum(1))[:, None]
        if mirror:
            out = v - 2 * (normal * v).sum(1)[:, None] * normal
        else:
            out = rng.standard_normal(v.shape)
            out = normal + out / np.linalg.norm(out, axis=1, keepdims=True)
        d[flying] = out / np.linalg.norm(out, axis=1, keepdims=True)
        o[flying] += t[:, None] * v + OFFSET * normal
    return d[met]


def from_disk(place, normal, radius, ball, n, seed=0):
    """Rays from a Lambertian disk, or a point, to a ball about the origin.

    Returns
    -------
    o, d : ndarray, shape (n, 3)
    weight : ndarray, shape (n,)
        The light that each of them carries.
    """
    rng = np.random.default_rng(seed)
    o = np.tile(np.array(place, float), (n, 1))
    if radius:
        normal = np.array(normal) / np.linalg.norm(normal)
        across = np.linalg.svd(normal[None])[2][1:]
        r, phi = radius * np.sqrt(rng.uniform(size=n)), rng.uniform(0, 2 * np.pi, n)
        o += np.stack([r * np.cos(phi), r * np.sin(phi)], axis=1) @ across
    distance = np.linalg.norm(o, axis=1, keepdims=True)
    # uniform in the cone about the ball
    cap = 1 - np.sqrt(1 - (ball / distance) ** 2)
    c = 1 - rng.uniform(size=(n, 1)) * cap
    phi = rng.uniform(0, 2 * np.pi, (n, 1))
    axis = -o / distance
    s = np.cross(axis, [0.3, 0.2, 0.9])
    s /= np.linalg.norm(s, axis=1, keepdims=True)
    around = np.cos(phi) * s + np.sin(phi) * np.cross(axis, s)
    d = c * axis + np.sqrt(1 - c * c) * around
    weight = cap[:, 0] * (np.maximum(d @ normal, 0) if radius else 1)
    return o, d, weight

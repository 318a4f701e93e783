"""Endless bars and slats, traced by NumPy in double precision: threads, blinds, grids.

All is endless along x or y and repeats with the same period in both; surfaces are
Lambertian on both sides, of one reflectance. Nothing here is the package's.
"""

from dataclasses import dataclass

import numpy as np

# Cells to either side of a ray's own that are looked at in one step.
CELLS = 3
OFFSET = 1e-9


@dataclass(frozen=True)
class Bar:
    """A cylinder along ``axis`` (0: x, 1: y), at ``u`` on the other axis and ``z``."""

    axis: int
    u: float
    z: float
    radius: float

    @property
    def heights(self):
        return self.z - self.radius, self.z + self.radius

    def hits(self, u, z, du, dz):
        """Distances to the circle in its cross section, and normals; inf for none."""
        u, z = u - self.u, z - self.z
        a, b, c = du**2 + dz**2, u * du + z * dz, u**2 + z**2 - self.radius**2
        root = np.sqrt(np.maximum(b**2 - a * c, 0))
        # all light is outside, from where the first of both is met
        t = (-b - root) / np.maximum(a, 1e-300)
        t = np.where((b**2 > a * c) & (t > OFFSET), t, np.inf)
        s = np.where(np.isfinite(t), t, 0)
        return t, (u + s * du) / self.radius, (z + s * dz) / self.radius


@dataclass(frozen=True)
class Slat:
    """A strip along ``axis`` through (u, z), ``width`` wide, ``tilt`` degrees off z."""

    axis: int
    u: float
    z: float
    width: float
    tilt: float

    @property
    def along(self):
        return np.array([np.sin(np.radians(self.tilt)), np.cos(np.radians(self.tilt))])

    @property
    def heights(self):
        half = self.width / 2 * self.along[1]
        return self.z - half, self.z + half

    def hits(self, u, z, du, dz):
        """Distances to the strip in its cross section, and normals; inf for none."""
        s, c = self.along
        u, z = u - self.u, z - self.z
        approach = c * du - s * dz
        with np.errstate(divide="ignore", invalid="ignore"):
            t = -(c * u - s * z) / approach
            place = s * (u + t * du) + c * (z + t * dz)
            met = (t > OFFSET) & (np.abs(place) <= self.width / 2)
        side = -np.sign(approach)
        return np.where(met, t, np.inf), c * side, -s * side


@dataclass(frozen=True)
class Fates:
    """Where each ray went, and with how much of its power."""

    direct: np.ndarray
    up: np.ndarray
    down: np.ndarray
    weight: np.ndarray
    d: np.ndarray


def follow(parts, period, rho, theta_i, phi_i, n, seed=0):
    """:class:`Fates` of `n` rays from incident angles in degrees, from above."""
    rng = np.random.default_rng(seed)
    low = min(part.heights[0] for part in parts)
    high = max(part.heights[1] for part in parts)
    theta, phi = np.radians([theta_i, phi_i])
    wi = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi)])
    p = np.c_[rng.uniform(0, period, (n, 2)), np.full(n, high + OFFSET)]
    d = np.tile(-np.append(wi, np.cos(theta)), (n, 1))
    weight, events = np.ones(n), np.zeros(n, int)
    flying = np.arange(n)
    while flying.size:
        o, v = p[flying], d[flying]
        t, normal = _nearest(parts, period, o, v)
        with np.errstate(divide="ignore"):
            reach = np.where(v[:, 2] > 0, high - o[:, 2], low - o[:, 2]) / v[:, 2]
            step = ((CELLS - 1) * period / np.abs(v[:, :2])).min(axis=1)
        hit = t <= step
        out = ~hit & (reach <= step)
        p[flying] = o + np.where(hit, t, step)[:, None] * v
        met = flying[hit]
        d[met] = _lambertian(rng, normal[hit])
        p[met] += OFFSET * normal[hit]
        weight[met] *= rho
        events[met] += 1
        flying = flying[~out & (weight[flying] > 1e-9)]
    weight[weight <= 1e-9] = 0
    return Fates(events == 0, d[:, 2] > 0, (d[:, 2] < 0) & (events > 0), weight, d)


def _nearest(parts, period, o, v):
    """Distance to what is met first, within some cells, and its normal."""
    best, normal = np.full(len(o), np.inf), np.zeros((len(o), 3))
    for part in parts:
        across = 1 - part.axis
        own = np.floor((o[:, across] - part.u) / period) * period
        for k in range(-CELLS, CELLS + 2):
            u = o[:, across] - own - k * period
            t, n_u, n_z = part.hits(u, o[:, 2], v[:, across], v[:, 2])
            nearer = t < best
            best[nearer] = t[nearer]
            normal[nearer] = 0
            normal[nearer, across] = n_u[nearer]
            normal[nearer, 2] = n_z[nearer]
    return best, normal


def _lambertian(rng, normal):
    """Directions about normals, with the density of the cosine."""
    ball = rng.standard_normal(normal.shape)
    d = normal + ball / np.linalg.norm(ball, axis=1, keepdims=True)
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def shapes(parts, rho):
    """Mitsuba scene of one cell of period 1: the same as is traced here."""
    from mitsuba import ScalarTransform4f as Transform

    bsdf = {
        "type": "twosided",
        "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": rho}},
    }
    scene = {"type": "scene"}
    for number, part in enumerate(parts):
        along = np.eye(3)[part.axis] / 2
        middle = np.array([0, 0, part.z])
        middle[1 - part.axis] = part.u
        if isinstance(part, Bar):
            shape = {"type": "cylinder", "radius": part.radius}
            shape |= {"p0": middle - along, "p1": middle + along}
        else:
            across = np.zeros(3)
            across[[1 - part.axis, 2]] = part.along * part.width / 2
            matrix = np.eye(4)
            matrix[:3] = np.c_[along, across, np.cross(along, across), middle]
            shape = {"type": "rectangle", "to_world": Transform(matrix)}
        scene[f"part{number}"] = shape | {"bsdf": bsdf}
    return scene


def direct_share(parts, theta_i, phi_i):
    """Part of the light that passes one set of parts for each axis: closed form.

    What a part shades, seen along the light, of one period of 1.
    """
    theta, phi = np.radians([theta_i, phi_i])
    slope = np.tan(theta) * np.array([np.sin(phi), np.cos(phi)])  # by the part's axis
    share = 1.0
    for part in parts:
        if isinstance(part, Bar):
            shade = 2 * part.radius * np.hypot(1, slope[part.axis])
        else:
            s, c = part.along
            shade = part.width * abs(s - c * slope[part.axis])
        share *= max(0.0, 1 - shade)
    return share

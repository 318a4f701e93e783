"""Traced micro-geometry, ray by ray, and exact ray counting in two dimensions."""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from gonio_mi.collector.directions import direction
from gonio_mi.mitsuba_compat import mesh_of, triangles_of
from gonio_mi.results.tally import Fate
from gonio_mi.settings.values import checked_period
from gonio_mi.specimen.rays import NEARBY
from gonio_mi.specimen.specimen import Specimen
from gonio_mi.transport.beam import Beam
from gonio_mi.transport.surface_loop import PathSettings, trace


def both_sided(bsdf):
    return {"type": "twosided", "bsdf": bsdf}


MIRROR = both_sided({"type": "conductor"})
GREY = both_sided({"type": "diffuse", "reflectance": 0.8})


class OnGPU:
    """Mitsuba as a module finds it, but for the name of the variant."""

    def variant(self):
        return "cuda_ad_mono"

    def __getattr__(self, name):
        return getattr(mi, name)


@dataclass
class Rays:
    """What became of each ray, as NumPy arrays."""

    fate: np.ndarray
    d: np.ndarray
    depth: np.ndarray
    weight: np.ndarray
    over_the_edge: np.ndarray

    @property
    def reflected(self):
        return self.fate_is(Fate.REFLECTED) & (self.d[:, 2] > 0)

    @property
    def transmitted(self):
        return self.fate_is(Fate.REFLECTED) & (self.d[:, 2] <= 0)

    def fate_is(self, fate):
        return self.fate == fate


def traced(
    shapes, theta_i, phi_i=0.0, *, n, period="box", seed=0, footprint="full", side=1
):
    """Rays sent at the shape or shapes, from incident angles in degrees."""
    specimen = specimen_of(shapes, period)
    wi = direction(np.radians(theta_i), np.radians(phi_i)) * [1, 1, side]
    emitter = mi.load_dict({"type": "directional", "direction": (-wi).tolist()})
    return followed(
        specimen, Beam(specimen, emitter, footprint, "radiometric"), n, seed
    )


@dataclass
class Aimed:
    """A beam along given rays: points of the specimen's top, and one direction."""

    p: np.ndarray
    wi: np.ndarray
    side, uniform, footprint = 1, True, "full"

    def sample(self, sampler, wavelengths):  # noqa: ARG002
        p, wi = mi.Point3f(self.p.T), mi.Vector3f(self.wi.tolist())
        dr.make_opaque(wi)  # one kernel for all directions
        return p, wi, dr.abs(wi.z), mi.Float(dr.inf), mi.Spectrum(1.0)


def aimed_at_edges(specimen, wi, n):
    """Beam of `n` rays from the direction `wi`, each at a point of a mesh's edges."""
    mesh = mi.traverse(specimen.scene.shapes()[0])
    vertices = np.array(mesh["vertex_positions"], float).reshape(-1, 3)
    faces = np.array(mesh["faces"]).reshape(-1, 3)
    rng = np.random.default_rng(0)
    face, corner = rng.integers(len(faces), size=n), rng.integers(3, size=n)
    a, b = (vertices[faces[face, (corner + i) % 3]] for i in (0, 1))
    points = a + (b - a) * rng.uniform(size=(n, 1))
    height = (specimen.high[2] - points[:, 2]) / wi[2]
    return Aimed((points + height[:, None] * wi).astype(np.float32), wi)


def as_it_is(specimen, p):  # noqa: ARG001
    """A point, not taken into the cell: `rays.into_cell` broken."""
    return mi.Point3f(p), mi.Vector3f(0)


def resumed_in_line(specimen, si, d, behind):
    """Where a ray would look again from, if not from beside: `resume` broken."""
    back = dr.minimum(si.t / 2, specimen.reach * NEARBY)
    return si.p - dr.select(behind, back, 0.0) * d


def specimen_of(shapes, period):
    """Specimen of a shape, of a dictionary of several, or of a scene's."""
    if shapes.get("type", "scene") != "scene":
        shapes = {"shape": shapes}
    scene = mi.load_dict({"type": "scene"} | shapes, optimize=False)
    return Specimen(scene, checked_period("period", period))


def followed(specimen, beam, n, seed=0):
    """What becomes of `n` rays of a beam."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, n)
    exits = trace(
        specimen, beam, sampler, mi.Color0f(), PathSettings(False, 1000, 2**32 - 1)
    )
    # in one kernel: the rays are followed once
    dr.eval(exits.fate, exits.d, exits.depth, exits.throughput, exits.over_the_edge)
    return Rays(
        np.array(exits.fate),
        np.array(exits.d).T.astype(float),
        np.array(exits.depth),
        np.array(exits.throughput)[0].astype(float),
        np.array(exits.over_the_edge),
    )


def heightfield(z=None, *, bsdf=MIRROR, transform=None, **settings):
    """Dictionary of a height field, 2 wide if nothing else is said."""
    shape = {"type": "heightfield", "size": 2.0, "bsdf": bsdf, **settings}
    if z is not None:
        shape["heights"] = mi.TensorXf(np.asarray(z, np.float32))
    if transform is not None:
        shape["to_world"] = transform
    return shape


def grooves(half_angle, n_grooves, scale=1.0, bsdf=MIRROR):
    """V-grooves along y, of width `scale`, with walls `half_angle` degrees off z."""
    depth = 0.5 / np.tan(np.radians(half_angle))
    return heightfield(
        depth * np.tile([0.0, -1.0], (4, n_grooves)),
        size=float(n_grooves),
        bsdf=bsdf,
        transform=mi.ScalarTransform4f().scale(scale),
    )


def spheres_on_a_plane():
    """Spheres of which a plane hides the lower halves, in cells of 2 x 2."""
    down = mi.ScalarTransform4f().translate([0, 0, -1])
    return {
        "type": "scene",
        "sphere": {"type": "sphere", "center": [0, 0, -1], "bsdf": GREY},
        "plane": {"type": "rectangle", "to_world": down, "bsdf": GREY},
    }


def lamp(radius=2.0, distance=5.0):
    """Disk above the specimen that faces it."""
    above = mi.ScalarTransform4f().translate([0, 0, distance]).rotate([1, 0, 0], 180)
    emitter = {"type": "area", "radiance": 1.0}
    return {"type": "disk", "to_world": above.scale(radius), "emitter": emitter}


def mesh(points, faces, bsdf=None, **others):
    """Mesh of points and triangles, which may have normals."""
    points, faces = np.float32(points).reshape(-1, 3), np.array(faces, np.uint32)
    made = mesh_of(mi.Properties("ply"), "mesh", points, faces, **others)
    if bsdf is not None:
        made.set_bsdf(bsdf)
    return made


# -------------------------------------------------------------- rays in two dimensions


def in_groove(x, half_angle, theta):
    """Order and exit angle from z, in radians, of a ray into a mirror V-groove.

    In double precision, one ray at a time. The groove has its crests at (-1/2, 0) and
    (1/2, 0); the ray crosses z = 0 at `x` and comes from the angle `theta` towards +x.
    """
    depth = 0.5 / np.tan(half_angle)
    p = np.array([x, 0.0])
    d = -np.array([np.sin(theta), np.cos(theta)])
    sine, cosine = np.sin(half_angle), np.cos(half_angle)
    # normals of the right wall and of the left, both through the valley
    normals = [np.array([-cosine, sine]), np.array([cosine, sine])]
    valley = np.array([0.0, -depth])
    order, last = 0, None
    while True:
        best, wall = np.inf, None
        for i, n in enumerate(normals):
            if i == last or d @ n >= 0:
                continue
            t = ((valley - p) @ n) / (d @ n)
            if t < best:
                best, wall = t, i
        if wall is None or (p + best * d)[1] > 0:
            return order, float(np.arctan2(d[0], d[1]))
        p, last = p + best * d, wall
        d = d - 2 * (d @ normals[wall]) * normals[wall]
        order += 1


def groove_shares(half_angle, theta, n=2000):
    """Shares of the rays by order and exit angle: exact, borders by bisection.

    Angles in degrees; exit angles in radians, rounded to ten digits.
    """
    half_angle, theta = np.radians(half_angle), np.radians(theta)

    def outcome(x):
        order, angle = in_groove(x, half_angle, theta)
        return order, round(angle, 10)

    shares = {}
    edges = np.linspace(-0.5, 0.5, n + 1)
    low = edges[0]
    centres = (edges[:-1] + edges[1:]) / 2
    kinds = [outcome(x) for x in centres]
    for i in range(1, n + 1):
        if i < n and kinds[i] == kinds[i - 1]:
            continue
        high = 0.5
        if i < n:
            a, b = centres[i - 1], centres[i]
            while b - a > 1e-15:
                middle = (a + b) / 2
                if middle in (a, b):
                    break
                a, b = (middle, b) if outcome(middle) == kinds[i - 1] else (a, middle)
            high = b
        kind = kinds[i - 1]
        shares[kind] = shares.get(kind, 0.0) + high - low
        low = high
    return shares


def diffuse_groove_dhr(half_angle, theta, rho, n_nodes=16):
    """Reflectance of a Lambertian V-groove: radiosity of two endless strips, no rays.

    The integral equation of :func:`_diffuse_groove` is solved at its nodes. All light
    that is not absorbed leaves. Angles in degrees.
    """
    ds, seen, lit = _diffuse_groove(half_angle, theta, n_nodes)
    n = len(ds) // 2
    coupling = np.eye(2 * n)
    coupling[:n, n:] = coupling[n:, :n] = -rho * seen
    radiosity = rho * np.linalg.solve(coupling, lit)
    absorbed = (1 - rho) / rho * radiosity @ ds
    return float(1 - absorbed / np.cos(np.radians(theta)))


def diffuse_groove_order(half_angle, theta, rho, order, n_nodes=16):
    """Part of that reflectance that leaves after `order` surface events.

    The Neumann series of the same integral equation: what a wall gets `order` times,
    less what the other wall sees of it.
    """
    ds, seen, lit = _diffuse_groove(half_angle, theta, n_nodes)
    walls = lit.reshape(2, -1)
    for _ in range(order - 1):
        walls = walls[::-1] @ seen.T
    escaping = walls * (1 - seen.sum(axis=1))
    return float(rho**order * escaping.ravel() @ ds / np.cos(np.radians(theta)))


def _diffuse_groove(half_angle, theta, n_nodes):
    """Weights of the nodes on both walls, form factors, and what the beam brings.

    A strip at the distance s from the valley sees one at s' on the other wall, which is
    turned by the opening angle w, under the form factor sin(w)^2 s s' / (2 r^3) per s',
    with r^2 = s^2 + s'^2 - 2 s s' cos(w). Gauss's nodes in panels that shrink towards
    the valley, with a border where the crest's shadow ends.
    """
    half_angle, theta = np.radians(half_angle), np.radians(theta)
    length, opening = 0.5 / np.sin(half_angle), 2 * half_angle
    # from above or, beyond the wall's slope, only what the other crest lets through
    dark = max(0.0, np.sin(theta - half_angle) / np.sin(theta + half_angle)) * length
    edges = np.append(0, length * 0.25 ** np.arange(11, -1, -1))
    edges = np.sort(np.append(edges, dark)) if dark else edges
    x, weight = np.polynomial.legendre.leggauss(n_nodes)
    low, high = edges[:-1, None], edges[1:, None]
    s = ((low + high) / 2 + (high - low) / 2 * x).ravel()
    ds = ((high - low) / 2 * weight).ravel()
    r2 = s[:, None] ** 2 + s**2 - 2 * np.outer(s, s) * np.cos(opening)
    seen = np.sin(opening) ** 2 * np.outer(s, s) / (2 * r2**1.5) * ds
    facing = np.where(s > dark, np.sin(half_angle + theta), 0.0)
    averted = np.full(s.size, max(np.sin(half_angle - theta), 0.0))
    return np.tile(ds, 2), seen, np.append(facing, averted)


def with_faces(shape, change):
    """The same mesh with other triangles, an array of shape (n, 3)."""
    before = mi.load_dict(shape)
    points, faces = triangles_of(mi.traverse(before))
    return mesh(points, change(np.array(faces)), before.bsdf())

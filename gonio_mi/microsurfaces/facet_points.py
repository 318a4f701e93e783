"""Random points of a surface, in proportion to its area, as rays find them."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats, Integers
from ..errors import SpecimenError
from ..transport.ray_offsets import intersect
from ..transport.specimen import Specimen

__all__ = ["Facets", "found_facets"]

# How far above its surface a point is looked for, relative to its coordinates.
APPROACH = 2.0**-16


@dataclass(frozen=True, eq=False)
class Facets:
    """Random points of the surfaces, each of the area that it stands for.

    Attributes
    ----------
    si : mi.SurfaceInteraction3f
        The points, as rays find them.
    n : ndarray, shape (n, 3)
        Their normals.
    area : ndarray, shape (n,)
    block : ndarray of int, shape (n,)
        Of the surface, row by row, in which a point is.
    """

    si: mi.SurfaceInteraction3f
    n: Floats
    area: Floats
    block: Integers


def found_facets(specimen: Specimen, points: int, blocks: int, seed: int) -> Facets:
    """Points of all surfaces, in proportion to their areas, ``blocks**2`` blocks.

    Raises
    ------
    SpecimenError
        If there are instances, or rays do not find one point of a hundred.
    """
    if specimen.groups:
        raise SpecimenError("micro_normals needs a specimen without instances")
    generator = np.random.default_rng(seed)
    areas = np.array([float(dr.sum(s.surface_area())[0]) for s in specimen.surfaces])
    numbers = np.maximum(1, np.round(points * areas / areas.sum()).astype(int))
    parts = [
        (_mesh_points if _has_triangles(shape) else _shape_points)(shape, n, generator)
        for shape, n in zip(specimen.surfaces, numbers.tolist())
    ]
    p, normal = (np.concatenate(columns) for columns in zip(*parts))
    si = _found(specimen, p, normal)
    there = si.is_valid().numpy()
    if np.count_nonzero(there) < 0.99 * len(there):
        raise SpecimenError(
            "micro_normals needs surfaces that rays find where they are, but "
            f"{np.count_nonzero(~there)} of {len(there)} points were not found"
        )
    area = np.repeat(areas / numbers, numbers) * there
    low, extent = specimen.low[:2], (specimen.high - specimen.low)[:2]
    cell = np.clip((p[:, :2] - low) / extent * blocks, 0, blocks - 1).astype(int)
    n = np.array(si.n, dtype=float).T
    return Facets(si, n, area, cell[:, 0] * blocks + cell[:, 1])


def _has_triangles(shape: mi.Shape) -> bool:
    """Whether a shape shows its triangles; a rectangle is a mesh and does not."""
    return shape.is_mesh() and "vertex_positions" in mi.traverse(shape)


def _mesh_points(
    mesh: mi.Mesh, n: int, generator: np.random.Generator
) -> tuple[Floats, Floats]:
    """Uniform points of a mesh and their normals, in double precision.

    What Mitsuba draws of a mesh of many triangles lies beside them: one number in
    single precision chooses the triangle and the place in it.
    """
    parameters = mi.traverse(mesh)
    vertices = np.array(parameters["vertex_positions"]).reshape(-1, 3)
    faces = np.array(parameters["faces"]).reshape(-1, 3)
    a, b, c = (vertices[faces[:, i]].astype(float) for i in range(3))
    normal = np.cross(b - a, c - a)
    size = np.cumsum(np.linalg.norm(normal, axis=1))
    chosen = np.searchsorted(size, generator.random(n) * size[-1], side="right")
    chosen = np.minimum(chosen, len(faces) - 1)
    u, v = generator.random((2, n))
    root = np.sqrt(u)
    shares = np.stack([1 - root, root * (1 - v), root * v])[..., None]
    a, b, c, normal = (one[chosen] for one in (a, b, c, normal))
    unit = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return shares[0] * a + shares[1] * b + shares[2] * c, unit


def _shape_points(
    shape: mi.Shape, n: int, generator: np.random.Generator
) -> tuple[Floats, Floats]:
    """Uniform points of a shape and their normals."""
    found = shape.sample_position(0.0, mi.Point2f(generator.random((2, n))))
    # of a flat one there is one normal for all
    p, normal = (
        np.broadcast_to(np.array(v, dtype=float).T, (n, 3)) for v in (found.p, found.n)
    )
    return p, normal


def _found(specimen: Specimen, p: Floats, n: Floats) -> mi.SurfaceInteraction3f:
    """Points as rays find them that fall on them from just above.

    Only so are they known to the bit by what tells a surface from itself.
    """
    above = np.abs(p).max(axis=1, keepdims=True) + specimen.detail
    origin = mi.Point3f((p + n * above * APPROACH).astype(np.float32).T)
    ray = mi.Ray3f(origin, -mi.Vector3f(n.T))
    si = intersect(specimen.scene, ray, mi.RayFlags.All, mi.Bool(True))
    dr.eval(si)
    return si

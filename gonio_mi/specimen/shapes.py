"""Shapes of a scene: their boxes, cell walls, groups, and acceleration structure.

A box is the cell of a period, and what light passes over the edge: the box counts.
Mitsuba 3.9.1 bounds an `sdfgrid` by its grid and a `bsplinecurve` by its control
points, and a mesh by all its vertices, used or not; these are bounded here by their
surfaces. All other boxes are Mitsuba's: tight for spheres, disks, cylinders,
rectangles, ellipsoids and linear curves, loose for a turned `instance`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..kernels import called_after_errors
from ..mitsuba_compat import triangles_of
from .digest import geometry_hash
from .scene_objects import traversed

# Option of a scene, without which rays slip between the triangles of a mesh.
WATERTIGHT = {"embree_use_robust_intersections": True}

# Odd and without a pattern: 2**64 over the golden ratio.
MIXED = 0x9E3779B97F4A7C15

# The shapes that were built last, a hash of their geometry, and their scene. An object
# that is measured again is not built again: 2e6 triangles in 0.13 s of CPU time instead
# of 0.55 s. Mitsuba's objects take no weak reference, so there is one scene at most.
_last: list[Any] = []

# The specimen that :mod:`.kept` keeps of the last measurement, if any.
kept: list[Any] = []


def groups_of(scene: mi.Scene) -> list[mi.Shape]:
    """List of the shape groups of `scene`, without which no instance can be built."""
    if not any(map(_is_instance, scene.shapes())):
        return []
    parts = [part for part in traversed(scene).hierarchy if isinstance(part, mi.Shape)]
    return [part for part in parts if part.class_name().startswith("ShapeGroup")]


def surfaces_of(
    shapes: Sequence[mi.Shape], groups: Sequence[mi.Shape]
) -> list[mi.Shape]:
    """List of the `shapes` that are no instances, and of those in the `groups`."""
    surfaces = [shape for shape in shapes if not _is_instance(shape)]
    for group in groups:
        parts = traversed(group).hierarchy
        surfaces += [p for p in parts if isinstance(p, mi.Shape) and p is not group]
    return surfaces


def _is_instance(shape: mi.Shape) -> bool:
    return shape.class_name() == "Instance"


def scene_of(shapes: Sequence[mi.Shape], groups: Sequence[mi.Shape] = ()) -> mi.Scene:
    """Scene of `shapes`, and of the shape `groups` of their instances, to be traced.

    That of the call before, if these are the same objects and no parameter of their
    geometry has changed since.
    """
    shapes = [*groups, *shapes]
    geometry = geometry_hash(shapes)
    if _last and [*map(id, _last[0])] == [*map(id, shapes)] and _last[1] == geometry:
        return _last[2]
    forget()
    parts = {"type": "scene"} | WATERTIGHT | dict(zip(_names(shapes), shapes))
    scene = mi.load_dict(parts, optimize=False)
    _last[:] = list(shapes), geometry, scene
    return scene


@called_after_errors
def forget() -> None:
    """Free what was built last, before what cannot be the same is loaded."""
    _last.clear()
    kept.clear()


def remember(scene: mi.Scene) -> None:
    """Let :func:`scene_of` find a scene that was loaded with `WATERTIGHT`, or on a GPU.

    Its emitters may be no shapes; else the specimen is built without them. On a GPU
    Mitsuba 3.9.1 crashes where instances of a group are in a second scene.
    """
    shapes = [*groups_of(scene), *scene.shapes()]
    _last[:] = shapes, geometry_hash(shapes), scene


def _names(shapes: Sequence[mi.Shape]) -> list[str]:
    """Names for a scene, which become the shapes' own: those that they have, if any."""
    names = [shape.id() for shape in shapes]
    usable = all(re.fullmatch(r"\w+", name) for name in names) and "type" not in names
    if usable and len(set(names)) == len(names):
        return names
    return [f"shape_{i}" for i in range(len(shapes))]


Corners = tuple[Floats, Floats]

# Coefficients of powers of t by the four control points of a uniform cubic B-spline.
SPLINE = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6

# Points of a segment at which its extent is looked for, how often around the best of
# them again, each time 16 times as near: to 1e-10 of the extent, and segments at once.
POINTS, ROUNDS, SEGMENTS = 33, 5, 4096

# Points around what is flat before it is transformed, or around the ends of a cylinder:
# its hull. Of circles those of a polygon about them, 1e-6 of the radius larger.
_ANGLES = np.linspace(0, 2 * np.pi, 2049)
_CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES), 0 * _ANGLES], axis=1)
_CIRCLE /= np.cos(np.pi / 2048)
OUTLINES = {
    "Rectangle": np.array([(x, y, 0.0) for x in (-1, 1) for y in (-1, 1)]),
    "Disk": _CIRCLE,
    "Cylinder": np.concatenate([_CIRCLE, _CIRCLE + [0, 0, 1]]),
}

# Triangles whose vertices are looked up at once, in the cache.
FACES = 2**16


def bounds(shapes: Sequence[mi.Shape]) -> Corners:
    """Lower and upper corner of the box of all `shapes`, each of shape ``(3,)``.

    Exact for the shapes that are named above, to the rounding of single precision; a
    grid that is turned, which Mitsuba cannot trace, is within its box.
    """
    low, high = np.transpose([_box(shape) for shape in shapes], (1, 0, 2))
    return low.min(axis=0), high.max(axis=0)


def farthest(shapes: Sequence[mi.Shape]) -> float:
    """Distance from the origin that no point of `shapes` exceeds.

    Exact for meshes, spheres, rectangles, disks and cylinders; of others the distance
    of a corner of their box.
    """
    return max(map(_farthest, shapes))


def _farthest(shape: mi.Shape) -> float:
    """The same for one shape."""
    low, high = _box(shape)
    kind, parameters = shape.class_name(), traversed(shape)
    points = np.array([np.abs([low, high]).max(axis=0)])
    if kind == "Sphere":
        return float(np.linalg.norm(low + high) / 2 + (high - low).max() / 2)
    if kind in OUTLINES:
        to_world = np.array(parameters["to_world"].matrix, dtype=float).reshape(4, 4)
        points = OUTLINES[kind] @ to_world[:3, :3].T + to_world[:3, 3]
    elif isinstance(shape, mi.Mesh):
        positions, faces = triangles_of(parameters) or (points, [[0]])
        points = positions[np.unique(faces).astype(np.intp)]
    return float(np.linalg.norm(points.astype(float), axis=1).max())


def _box(shape: mi.Shape) -> Floats:
    """Corners of the box of one shape, shape ``(2, 3)``."""
    box = shape.bbox()
    loose = np.array([box.min, box.max], dtype=float).reshape(2, 3)
    find = _used if isinstance(shape, mi.Mesh) else SURFACES.get(shape.class_name())
    surface = find(shape) if find else None
    if surface is None:
        return loose
    return np.array(
        [np.maximum(loose[0], surface[0]), np.minimum(loose[1], surface[1])]
    )


def _used(mesh: mi.Mesh) -> Corners | None:
    """Of the vertices that triangles use; None if there are no triangles."""
    found = triangles_of(traversed(mesh))
    if found is None or not found[1].size:
        return None
    points, faces = found
    used = np.zeros(len(points), bool)
    for some in np.array_split(faces, len(faces) // FACES + 1):
        used[some.astype(np.intp)] = True
    if not used.all():
        points = points[used]
    # along the first axis NumPy takes 20 times as long
    low, high = np.transpose([(x.min(), x.max()) for x in points.T])
    return low, high


def _grid(shape: mi.Shape) -> Corners | None:
    """Of the points where edges of the grid cross zero; None if there is none.

    A slice of a cell, across one axis, is bilinear: it is zero somewhere if its corners
    have both signs, and they lie on four edges along that axis. So a coordinate of the
    surface is extreme where an edge crosses zero.
    """
    parameters = traversed(shape)
    values = np.array(parameters["grid"], dtype=float)[..., 0]
    size = np.array(values.shape) - 1
    crossings = []
    for axis in range(3):
        ends = np.moveaxis(values, axis, 0)
        a, b = ends[:-1], ends[1:]
        crosses = np.minimum(a, b) * np.maximum(a, b) <= 0
        drop = (a - b)[crosses]
        place = np.argwhere(crosses).astype(float)
        place[:, 0] += a[crosses] / np.where(drop == 0, 1, drop)
        crossings.append(np.insert(place[:, 1:], axis, place[:, 0], axis=1) / size)
    points = np.concatenate(crossings)
    if not len(points):
        return None
    # the first axis of the grid is z
    x, y, z = np.transpose([points.min(axis=0), points.max(axis=0)])[::-1]
    corners = np.array(np.meshgrid(x, y, z)).reshape(3, -1)
    to_world = np.array(parameters["to_world"].matrix, dtype=float).reshape(4, 4)
    corners = to_world[:3, :3] @ corners + to_world[:3, 3:]
    return corners.min(axis=1), corners.max(axis=1)


def _curve(shape: mi.Shape) -> Corners:
    """Of all circles around a cubic B-spline, across its tangent."""
    parameters = traversed(shape)
    points = np.array(parameters["control_points"], dtype=float).reshape(-1, 4)
    first = np.array(parameters["segment_indices"], dtype=int)
    segments = points[first[:, None] + np.arange(4)]
    high = [_furthest(segments, axis, 1) for axis in range(3)]
    low = [-_furthest(segments, axis, -1) for axis in range(3)]
    return np.array(low), np.array(high)


def _furthest(segments: Floats, axis: int, sign: int) -> float:
    """Largest coordinate of curves of shape ``(n, 4, 4)``, along an axis."""
    # no point of a segment is beyond the balls about its control points
    within = (sign * segments[..., axis] + segments[..., 3]).max(axis=1)
    best = _reach(segments, np.full((len(segments), 1), 0.5), axis, sign).max()
    for part in np.array_split(segments[within > best], len(segments) // SEGMENTS + 1):
        middle, half = np.full((len(part), 1), 0.5), 0.5
        for _ in range(ROUNDS):
            offsets = np.linspace(-half, half, POINTS)
            t = np.clip(middle + offsets, 0, 1)
            reach = _reach(part, t, axis, sign)
            best = max(best, reach.max(initial=best))
            middle = np.take_along_axis(t, reach.argmax(axis=1)[:, None], axis=1)
            half *= 2 / (POINTS - 1)
    return best


def _reach(segments: Floats, t: Floats, axis: int, sign: int) -> Floats:
    """How far the circles at `t`, of shape ``(n, m)``, reach along an axis."""
    t = t[..., None]
    powers = SPLINE @ segments
    c0, c1, c2, c3 = (powers[:, None, i] for i in range(4))
    p = c0 + t * (c1 + t * (c2 + t * c3))
    along = (c1 + t * (2 * c2 + t * 3 * c3))[..., :3]
    # where control points coincide there is no tangent: a ball
    length = np.linalg.norm(along, axis=-1)
    cosine = along[..., axis] / np.where(length == 0, 1, length)
    return sign * p[..., axis] + p[..., 3] * np.sqrt(np.maximum(1 - cosine**2, 0))


SURFACES: dict[str, Callable[[mi.Shape], Corners | None]] = {
    "SDFGrid": _grid,
    "BSplineCurve": _curve,
}


# How near to the side of the cell a wall is in it, in units of the cell.
WALL_DISTANCE = 1e-5


def walls_in_sides(
    shapes: Sequence[mi.Shape],
    low: Floats,
    high: Floats,
    which: Callable[[mi.Shape], bool],
) -> list[str]:
    """Names of the shapes, of those `which`, with faces in the sides of the cell.

    Parameters
    ----------
    shapes : sequence of mi.Shape
    low, high : ndarray, shape (3,)
        Corners of the cell.
    which : callable
        Such as :func:`refracts` and :func:`encloses_medium`.
    """
    walls = [one for one in filter(which, shapes) if _has_walls(one, low, high)]
    return [f"{shape.class_name()} {shape.id()!r}" for shape in walls]


def in_one_plane(shapes: Sequence[mi.Shape], near: float) -> bool:
    """Whether two shapes overlap in one plane across an axis, and light passes one."""
    low, high = np.transpose([_box(shape) for shape in shapes], (1, 0, 2))
    for n in np.flatnonzero([*map(transmits, shapes)]):
        overlap = np.minimum(high, high[n]) - np.maximum(low, low[n])
        thick = np.maximum(high - low, high[n] - low[n])
        both = ((overlap > near) | (thick == 0) & (overlap == 0)).all(axis=1)
        both[n] = False
        if (both & (thick == 0).any(axis=1)).any():
            return True
    return False


def transmits(shape: mi.Shape) -> bool:
    """Whether the BSDF of a shape declares that light may pass."""
    return mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Transmission)


def refracts(shape: mi.Shape) -> bool:
    """Whether light that passes is bent: no mask, and no thin sheet."""
    flags = shape.bsdf().flags()
    bent = mi.BSDFFlags.DeltaTransmission, mi.BSDFFlags.GlossyTransmission
    refracted = any(mi.has_flag(flags, flag) for flag in bent)
    return refracted and not mi.has_flag(flags, mi.BSDFFlags.Null)


def encloses_medium(shape: mi.Shape) -> bool:
    """Whether light may pass it into a medium, or out of one."""
    return shape.is_medium_transition() and transmits(shape)


def _has_walls(shape: mi.Shape, low: Floats, high: Floats) -> bool:
    """Whether a face of the shape is in a side of the cell."""
    near = WALL_DISTANCE * (high - low)[:2]
    for triangle in _faces(shape):
        for axis in (0, 1):
            along = triangle[..., axis]
            for side in (low[axis], high[axis]):
                if (np.abs(along - side) <= near[axis]).all(axis=-1).any():
                    return True
    return False


def _faces(shape: mi.Shape) -> list[Floats]:
    """Triangles of a mesh ``(n, 3, 3)``, or the box of what is flat."""
    if shape.class_name() in ("Rectangle", "Disk"):
        box = shape.bbox()
        return [np.array([[box.min, box.max]], dtype=float).reshape(1, 2, 3)]
    parameters: Any = traversed(shape)
    found = triangles_of(parameters)
    return [] if found is None else [found[0][found[1]].astype(float)]


def is_height_map(shape: mi.Shape, low: Sequence[mi.Float], high: Any) -> bool:
    """Whether triangles are heights over all of a cell, continued across its sides.

    None of them overhangs, all face up or all down, and each edge is that of two.

    Parameters
    ----------
    shape : mi.Shape
    low, high : sequence of mi.Float
        Corners of the cell, of which x and y count.
    """
    if not isinstance(shape, mi.Mesh):
        return False
    faces = shape.face_indices(dr.arange(mi.UInt32, shape.face_count()))
    corners = [shape.vertex_position(one) for one in faces]
    (a, b, c), edges = corners, mi.UInt64(0)
    along, across = mi.Vector3d(b - a), mi.Vector3d(c - a)
    below = (along.x * across.y - along.y * across.x) / 2
    for start, end in zip(corners, [*corners[1:], corners[0]]):
        middle = start + end  # of twice the length
        for axis in (0, 1):
            at_side = middle[axis] == 2 * high[axis]
            middle[axis] = dr.select(at_side, 2 * low[axis], middle[axis])
        edges += _mixed(middle, end - start) - _mixed(middle, start - end)
    # 0 where edges cancel; where they do not, by a chance of 2**-64
    left, sums, least, most = dr.sum(edges), dr.sum(below), dr.min(below), dr.max(below)
    dr.eval(left, sums, least, most)
    if left[0] != 0 or least[0] * most[0] < 0:
        return False
    # a whole number of such maps, of which several may touch
    cell = (high[0] - low[0]) * (high[1] - low[1])
    return round(abs(sums[0]) / cell[0]) == 1


def coincide(mesh: mi.Mesh) -> bool:
    """Whether two triangles of a mesh have the same corners."""
    faces = mesh.face_indices(dr.arange(mi.UInt32, mesh.face_count()))
    key = sum(_mixed(mesh.vertex_position(one)) for one in faces).numpy()
    return len(np.unique(key)) < len(key)


def _mixed(*vectors: mi.Vector3f) -> mi.UInt64:
    """Number that is another one, as if by chance, for other vectors."""
    word = mi.UInt64(0)
    for vector in vectors:
        for x in vector:
            word = (word ^ mi.UInt64(dr.reinterpret_array(mi.UInt32, x))) * MIXED
            word ^= word >> 29
    return word * MIXED

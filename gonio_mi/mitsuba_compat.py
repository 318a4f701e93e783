"""Names that Mitsuba 3.10 changes, of flags of rays and meshes; arrays in its memory.

As its sources have them in August 2026; 3.9 knows the others. Nothing here uses the
parameters of `principled` that go (``*_sampling_rate``).
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .array_types import Numbers, Singles


def _named(names: Any, new: str, old: str) -> int:
    return int(getattr(names, new if hasattr(names, new) else old))


# What a ray finds out of a surface: place and normal; the shading frame too; texture
# coordinates and tangents too; and their partials.
MINIMAL = int(mi.RayFlags.Minimal)
FRAME = _named(mi.RayFlags, "Shading", "ShadingFrame")
SURFACE = _named(mi.RayFlags, "Shading", "All")
PARTIALS = SURFACE | _named(mi.RayFlags, "NormalPartials", "dNSdUV")


def has_normals(mesh: mi.Mesh) -> bool:
    """Whether a mesh has normals of its vertices."""
    new = getattr(mesh, "has_normals", None)
    return bool(mesh.has_vertex_normals() if new is None else new())


def recompute_box(mesh: mi.Mesh) -> None:
    """Let a mesh find its box; 3.10 has no such method, and always knows it."""
    if hasattr(mesh, "recompute_bbox"):
        mesh.recompute_bbox()


def triangles_of(parameters: Any) -> tuple[Numbers, Numbers] | None:
    """Points ``(n, 3)`` and triangles ``(m, 3)`` of a shape; None of what has none.

    In Mitsuba's precision, and perhaps its memory.

    Parameters
    ----------
    parameters : mi.SceneParameters or dict
        Of the shape.
    """
    name = "positions" if "positions" in parameters else "vertex_positions"
    if name not in parameters:
        return None
    points = np.asarray(parameters[name]).reshape(-1, 3)
    faces = np.asarray(parameters["faces"]).reshape(-1, 3)
    # vertices may share a position
    if "position_index" in parameters and len(parameters["position_index"]):
        faces = np.asarray(parameters["position_index"])[faces]
    return points, faces


def mesh_of(
    props: mi.Properties, name: str, points: Singles, faces: Any, **others: Singles
) -> mi.Mesh:
    """Mesh of points and triangles in world coordinates.

    Parameters
    ----------
    props : mi.Properties
        Of the shape; its ``to_world`` has been applied.
    name : str
        Text for the record. From 3.10 on a mesh has its id or file instead.
    points : ndarray, shape (n, 3)
    faces : ndarray, shape (m, 3)
        Indices of points.
    normals, texcoords : ndarray, shapes (n, 3) and (n, 2), optional
    """
    if hasattr(mi.Mesh, "from_fields"):
        props["to_world"] = mi.ScalarTransform4f()
        mesh = mi.Mesh(props)
        fields = {"positions": points} | others
        tensors = {key: mi.TensorXf32(x) for key, x in fields.items()}
        mesh.from_fields(faces=mi.TensorXu32(faces), **tensors)
        return mesh
    has = {f"has_vertex_{key}": True for key in others}
    mesh = mi.Mesh(name, len(points), len(faces), props=props, **has)
    parameters = mi.traverse(mesh)
    parameters["faces"] = mi.UInt32(faces.ravel())
    for key, values in ({"positions": points} | others).items():
        parameters[f"vertex_{key}"] = floats(values.ravel())
    parameters.update()
    dr.eval()
    return mesh


def floats(*parts: Numbers) -> mi.Float:
    """Mitsuba's numbers from arrays, copied one after another to memory of Dr.Jit.

    NumPy's memory may begin anywhere, and reading from there needs another kernel.
    """
    if not mi.variant().startswith("llvm"):  # NumPy would write into a copy
        return mi.Float(np.concatenate(parts, dtype=np.float32))
    found = dr.empty(mi.Float, sum(map(len, parts)))
    np.concatenate(parts, out=found.numpy())
    return found

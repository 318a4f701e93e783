"""Shapes with their acceleration structure, which is built once for each geometry."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import mitsuba as mi

from .digest import digest
from .traversal import traversed

__all__ = ["WATERTIGHT", "groups_of", "remember", "scene_of", "surfaces_of"]

# Option of a scene, without which rays slip between the triangles of a mesh.
WATERTIGHT = {"embree_use_robust_intersections": True}

# The shapes that were built last, a digest of their geometry, and their scene: what is
# measured again is found here, and nothing else is kept alive.
_last: list[Any] = []


def groups_of(scene: mi.Scene) -> list[mi.Shape]:
    """List of the shape groups of `scene`, without which no instance can be built."""
    if not any(map(_is_instance, scene.shapes())):
        return []
    return [
        part
        for part in traversed(scene).hierarchy
        if isinstance(part, mi.Shape) and part.class_name().startswith("ShapeGroup")
    ]


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
    geometry = digest(shapes, geometry=True)
    if _last and _same(_last[0], shapes) and _last[1] == geometry:
        return _last[2]
    # the old one is freed before the new one is built
    _last.clear()
    scene = mi.load_dict(
        {"type": "scene"} | WATERTIGHT | dict(zip(_names(shapes), shapes)),
        optimize=False,
    )
    _last[:] = list(shapes), geometry, scene
    return scene


def remember(scene: mi.Scene) -> None:
    """Let :func:`scene_of` find a scene that was loaded with `WATERTIGHT`.

    Its emitters may be no shapes; else the specimen is built without them.
    """
    shapes = [*groups_of(scene), *scene.shapes()]
    _last[:] = shapes, digest(shapes, geometry=True), scene


def _names(shapes: Sequence[mi.Shape]) -> list[str]:
    """Names for a scene, which become the shapes' own: those that they have, if any."""
    names = [shape.id() for shape in shapes]
    usable = all(re.fullmatch(r"\w+", name) for name in names) and "type" not in names
    if usable and len(set(names)) == len(names):
        return names
    return [f"shape_{i}" for i in range(len(shapes))]


def _same(shapes: Sequence[mi.Shape], others: Sequence[mi.Shape]) -> bool:
    """Whether both hold the same objects, in the same order."""
    return len(shapes) == len(others) and all(a is b for a, b in zip(shapes, others))

"""Shapes with their acceleration structure, which is built once for each geometry."""

import re

import mitsuba as mi

from .digest import digest

__all__ = ["scene_of"]

# The shapes that were built last, a digest of their geometry, and their scene: what is
# measured again is found here, and nothing else is kept alive.
_last: list = []


def scene_of(shapes):
    """Scene of `shapes`, ready to be traced.

    That of the call before, if these are the same objects and no parameter of their
    geometry has changed since.
    """
    geometry = digest(shapes, geometry=True)
    if _last and _same(_last[0], shapes) and _last[1] == geometry:
        return _last[2]
    # the old one is freed before the new one is built
    _last.clear()
    scene = mi.load_dict(
        # watertight: without it rays slip between the triangles of a mesh
        {"type": "scene", "embree_use_robust_intersections": True}
        | dict(zip(_names(shapes), shapes)),
        optimize=False,
    )
    _last[:] = list(shapes), geometry, scene
    return scene


def _names(shapes):
    """Names for a scene, which become the shapes' own: those that they have, if any."""
    names = [shape.id() for shape in shapes]
    usable = all(re.fullmatch(r"\w+", name) for name in names) and "type" not in names
    if usable and len(set(names)) == len(names):
        return names
    return [f"shape_{i}" for i in range(len(shapes))]


def _same(shapes, others):
    """Whether both hold the same objects, in the same order."""
    return len(shapes) == len(others) and all(a is b for a, b in zip(shapes, others))

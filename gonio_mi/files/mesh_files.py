"""Which files are meshes of other programs."""

import os
from pathlib import Path

__all__ = ["MESHES", "is_mesh"]

# Mitsuba's plugins by the ending of the file.
MESHES = {".obj": "obj", ".ply": "ply", ".stl": "stl"}


def is_mesh(path: object) -> bool:
    """Whether a path ends as a mesh does: in .obj, .ply or .stl."""
    named = isinstance(path, (str, os.PathLike))
    return named and Path(str(path)).suffix.lower() in MESHES

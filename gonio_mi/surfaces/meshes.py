"""Meshes of other programs: which files are, and triangles of STL, binary or text."""

import os
import re
from os import PathLike
from pathlib import Path

import numpy as np

from ..array_types import Floats
from ..errors import FileFormatError
from ..files.checks import require
from ..files.numbers import decimal

# Rotations that turn an axis of the file to +z, and what is up, its z or else y, to +y.
NORMALS = {
    "z": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "-z": [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
    "y": [[-1, 0, 0], [0, 0, 1], [0, 1, 0]],
    "-y": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "x": [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
    "-x": [[0, -1, 0], [0, 0, 1], [-1, 0, 0]],
}

# Mitsuba's plugins by the ending of the file.
MESHES = {".obj": "obj", ".ply": "ply", ".stl": "stl"}

# A binary file: a header, the number of triangles, and for each a normal, three
# vertices and two bytes more, all little-endian.
HEADER, COUNT = 80, 4
FIELDS = [("normal", "<f4", 3), ("vertices", "<f4", (3, 3)), ("more", "<u2")]
TRIANGLE = np.dtype(FIELDS)

VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)")


def is_mesh(path: object) -> bool:
    """Whether a path ends as a mesh does: in .obj, .ply or .stl."""
    named = isinstance(path, (str, os.PathLike))
    return named and Path(str(path)).suffix.lower() in MESHES


def read_stl(path: str | PathLike[str]) -> Floats:
    """Vertices of the triangles of a file, shape ``(n, 3, 3)``.

    Raises
    ------
    OSError
        If the file cannot be opened.
    FileFormatError
        If it is damaged or something else.
    """
    data = Path(path).read_bytes()
    try:
        start, n = HEADER + COUNT, 0
        if len(data) >= start:
            n = int(np.frombuffer(data, "<u4", 1, HEADER)[0])
        # as long as a binary file says; those may begin like text
        if len(data) == start + n * TRIANGLE.itemsize:
            vertices = np.frombuffer(data, TRIANGLE, offset=start)["vertices"]
        else:
            vertices = _text(data)
        require(len(vertices) > 0, "it holds no triangle")
        require(bool(np.isfinite(vertices).all()), "a vertex is not finite")
    except (FileFormatError, ValueError) as error:
        raise FileFormatError(f"cannot load {path}: {error}") from None
    return vertices.astype(float)


def _text(data: bytes) -> Floats:
    require(
        data.lstrip()[:5] == b"solid" and b"\0" not in data,
        "it is not an STL file: neither text that begins with solid, nor as long as "
        "its number of triangles says",
    )
    words = [word for vertex in VERTEX.findall(data) for word in vertex]
    numbers = [decimal(word.decode("ascii", "replace")) for word in words]
    facets = len(re.findall(rb"\bendfacet\b", data))
    require(len(numbers) == 9 * facets, "its facets must have three vertices each")
    return np.reshape(numbers, (-1, 3, 3))

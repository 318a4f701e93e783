"""Edges of a triangle mesh with the corners of their triangles, across a period too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import Floats, Integers, Numbers
from ..errors import SpecimenError


@dataclass(frozen=True)
class MeshEdges:
    """Edges of a mesh, each once.

    Attributes
    ----------
    start, end : ndarray of int, shape (n_edges,)
        Vertices of each edge.
    near, far : ndarray of int, shape (n_edges,)
        Third vertices of its two triangles; the same one twice on a border.
    shift : ndarray, shape (n_edges, 3)
        From the vertex `far` to where it is beside the edge: 0 but across the sides of
        a periodic cell.
    """

    start: Integers
    end: Integers
    near: Integers
    far: Integers
    shift: Floats


def welded(points: Floats, period: Floats | None) -> Integers:
    """Index of the first vertex at the same place, for each vertex.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
    period : ndarray, shape (2,), optional
        Extents of the periodic cell about the middle of the points; vertices in
        opposite sides of it are at the same place.
    """
    places = points.copy()
    if period is not None:
        low, high = (f(points[:, :2], axis=0) for f in (np.min, np.max))
        low, high = ((low + high) + sign * period for sign in (-1, 1))
        at_side = np.abs(2 * points[:, :2] - high) < 1e-5 * period
        places[:, :2] = np.where(at_side, low / 2, places[:, :2])
        at_side = np.abs(2 * points[:, :2] - low) < 1e-5 * period
        places[:, :2] = np.where(at_side, low / 2, places[:, :2])
    _, first, place = np.unique(places, axis=0, return_index=True, return_inverse=True)
    return first[place.ravel()]


def mesh_edges(points: Floats, faces: Numbers, same: Integers) -> MeshEdges:
    """:class:`MeshEdges` of triangles.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
    faces : ndarray of int, shape (m, 3)
    same : ndarray of int, shape (n,)
        Of :func:`welded`.

    Raises
    ------
    SpecimenError
        If an edge has more than two triangles.
    """
    corners = [np.roll(faces.astype(np.int64), -k, axis=1).ravel() for k in range(3)]
    start, end, third = corners
    along = np.rint((points[end] - points[start]) / np.ptp(points) * 2**18)
    # the same way for both triangles; a cell of one square has edges between equals
    order = same[end] - same[start] + np.sign(along @ [1e-3, 1e-5, 1e-7]) / 2
    turned = order < 0
    start, end = np.where(turned, end, start), np.where(turned, start, end)
    along = np.where(turned[:, None], -along, along)
    key = np.column_stack([same[start], same[end], along])
    _, number, counts = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    if counts.max() > 2:
        raise SpecimenError(
            "a mesh must have at most two triangles at each edge, got "
            f"{counts.max()} at one"
        )
    order = np.argsort(number.ravel(), kind="stable")
    last = np.cumsum(counts) - 1
    one, other = order[last - (counts - 1)], order[last]
    shift = points[start[one]] - points[start[other]]
    return MeshEdges(start[one], end[one], third[one], third[other], shift)

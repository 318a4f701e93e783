"""The outline of a free-standing solid, as its light sees it: faces of its box.

Light that meets a solid enters its bounding box through one of the lit faces, once: the
top, or one of the four sides. Uniform light from one direction falls on each of them in
proportion to its area as seen from there, and all of them together are the silhouette
of the box.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats, Numbers
from ..kernels import in_memory
from ..specimen.specimen import Specimen

# Axis and sign of the sides' normals; the lit face of the top is before them.
SIDES = ((0, 1), (0, -1), (1, 1), (1, -1))


class Outline:
    """The five faces of a solid's box on which light from one of its sides falls.

    Parameters
    ----------
    specimen : Specimen
    side : int
        Of the emitter: 1 above, -1 below.

    Attributes
    ----------
    normals : ndarray, shape (5, 3)
        Of the lit top, and of the sides.
    areas : ndarray, shape (5,)
        Of the same faces, in parts of all of them.
    """

    def __init__(self, specimen: Specimen, side: int) -> None:
        low, high = specimen.low, specimen.high
        self.middle, self.half = (low + high) / 2, (high - low) / 2
        self.normals = np.zeros((5, 3))
        for normal, (axis, sign) in zip(self.normals, ((2, side), *SIDES)):
            normal[axis] = sign
        across = self.half[[1, 2, 0]] * self.half[[2, 0, 1]]
        areas = np.abs(self.normals) @ across
        self.areas: Floats = areas / areas.sum()
        self.low, self.high = specimen.box.low, specimen.box.high
        self.side = side
        self._areas = in_memory(self.areas)
        self._middle, self._half = map(in_memory, (self.middle, self.half))

    def widths(self, wi: mi.Vector3f) -> list[mi.Float]:
        """Areas of the faces as seen from `wi`; 0 for those that face away."""
        faces = zip(self._areas, ((2, self.side), *SIDES))
        return [area * dr.maximum(sign * wi[axis], 0) for area, (axis, sign) in faces]

    def most(self, cosine: float, sine: float) -> float:
        """At least the sum of `widths`, for no larger cosine or sine to the normal."""
        top, x, _, y, _ = self.areas
        return float(top * cosine + np.hypot(x, y) * sine)

    def drawn(
        self, sample: mi.Point2f, widths: Sequence[mi.Float], total: mi.Float
    ) -> tuple[mi.Point3f, mi.Vector3f, mi.UInt32, mi.Bool]:
        """Points of the faces, which are chosen in proportion to `widths`.

        Parameters
        ----------
        sample : mi.Point2f
        widths : sequence of mi.Float
            Of the faces, which are laid side by side on a line.
        total : mi.Float
            Length of the line, at least the sum of them.

        Returns
        -------
        p, n : mi.Point3f, mi.Vector3f
            A point and the normal of its face.
        number : mi.UInt32
            Of the face.
        beside : mi.Bool
            On the line, but on none of its faces.
        """
        place, number = sample.x * (total / widths[0]), mi.UInt32(0)
        left = sample.x * total
        for face in range(1, len(widths)):
            left = left - widths[face - 1]
            here = (left >= 0) & (widths[face] > 0)
            place = dr.select(here, left / widths[face], place)
            number = dr.select(here, mi.UInt32(face), number)
        beside = place > 1
        return *self.on_face(mi.Point2f(place, sample.y), number), number, beside

    def on_face(
        self, place: mi.Point2f, number: mi.UInt32
    ) -> tuple[mi.Point3f, mi.Vector3f]:
        """Points of faces by their place in the unit square, and the normals."""
        a, b = 2 * dr.minimum(place.x, 1) - 1, 2 * place.y - 1
        x, y, z = self._middle
        half = self._half
        top = self.high[2] if self.side > 0 else self.low[2]
        p = mi.Point3f(x + half[0] * a, y + half[1] * b, top)
        n = mi.Vector3f(0, 0, self.side)
        sides = (
            mi.Point3f(0, y + half[1] * b, z + half[2] * a),
            mi.Point3f(x + half[0] * b, 0, z + half[2] * a),
        )
        for face, (axis, sign) in enumerate(SIDES, 1):
            here, point, normal = number == face, sides[axis], mi.Vector3f(0)
            point[axis] = self.high[axis] if sign > 0 else self.low[axis]
            normal[axis] = sign
            p, n = dr.select(here, point, p), dr.select(here, normal, n)
        return p, n

    def faces_any_of(self, low: Numbers, high: Numbers) -> Flags:
        """Which faces have points of a box, given by its corners, before them."""
        far = np.maximum(self.normals * low, self.normals * high).sum(axis=1)
        before: Flags = far > self.normals @ self.middle + abs(self.normals) @ self.half
        return before

    def nearest(self, place: Numbers) -> list[tuple[mi.Point3f, mi.Vector3f]]:
        """Point of each face that is nearest to a place, and the face's normal."""
        points = np.clip(place, self.middle - self.half, self.middle + self.half)
        points = np.where(self.normals, self.middle + self.normals * self.half, points)
        return [
            (mi.Point3f(in_memory(p)), mi.Vector3f(in_memory(n)))
            for p, n in zip(points, self.normals)
        ]

    def beside(self, wi: mi.Vector3f, reach: mi.Float) -> mi.Point3f:
        """Points from which light that comes from `wi` meets nothing: it goes away."""
        near = dr.select(wi.x > 0, self.low[0] - 2 * reach, self.high[0] + 2 * reach)
        return mi.Point3f(near, self._middle[1], self._middle[2])

"""Importance sampling for radiance mode: a coarse table of the values of two faces."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...array_types import Floats, Integers, Singles
from ...mitsuba_compat import floats
from .interpolated_bsdf import InterpolatedBSDF
from .lobes import aligned, cumulative
from .lookups import TINY, SearchTree, Turn, height, read, singles

# Cells of a table, at most, and lanes that fill them at once.
MAX_CELLS, MAX_LANES = 2**24, 2**17

# Points of a cell, and the steps between them: a lattice in three dimensions (Roberts
# 2018, *The unreasonable effectiveness of quasirandom sequences*).
N_POINTS, STEPS = 4, (0.8191725, 0.6710436, 0.5497005)

# Fraction of uniformly drawn directions, which bounds the weights (defensive sampling,
# Hesterberg 1995, doi:10.1080/00401706.1995.10484303).
DEFENSIVE = 0.02


def radiance_guide(faces: Sequence[InterpolatedBSDF | None]) -> RadianceGuide | None:
    """Guide of the front and the back; None of anisotropic ones or many patches."""
    held = [face for face in faces if face is not None]
    if any(face.anisotropic for face in held):
        return None
    n_hemispheres = max(face.n_hemispheres for face in held)
    n_rings = max(face.lobes.measured.n_theta for face in held)
    n_sectors = max(face.lobes.measured.n_phi for face in held)
    n_sides = max(n_hemispheres, len(held))
    shape = n_sides, n_rings, n_hemispheres, n_rings, n_sectors
    return RadianceGuide(faces, shape) if math.prod(shape) <= MAX_CELLS else None


class RadianceGuide:
    r"""Density of directions that is constant in cells, for each step of incidence.

    A picture weights each direction by value over density, so that the density only
    affects the variance. That is smallest if the density of a cell is proportional to
    the root mean square of its values.

    Cells are even steps of :func:`.height` and of the angle about the normal, as the
    perimeter of a square measures it. In a cell, points are even in that angle and in
    :math:`\sin^2\theta`. No arc function is needed.

    Parameters
    ----------
    faces : sequence of (InterpolatedBSDF or None)
        Front and back, isotropic.
    shape : (n_sides, n_steps, n_hemispheres, n_rings, n_sectors)
        Sides and polar angles of the camera; hemispheres, that of the camera first, and
        cells of the other direction.
    """

    def __init__(
        self, faces: Sequence[InterpolatedBSDF | None], shape: tuple[int, ...]
    ) -> None:
        self.n_sides, self.n_steps, self.n_hemispheres, *cells = self.shape = shape
        self.n_rings, self.n_sectors = cells
        self.edges = _sin2(np.arange(self.n_rings + 1) / self.n_rings)
        areas = np.diff(self.edges)[:, None] / np.full(self.n_sectors, self.n_sectors)
        density = self._seen(faces)
        lit = np.asarray(density.any(axis=(1, 3, 4)))[..., None, None]
        of_rings = np.empty(density.shape[:-1])
        sectors = np.empty((*of_rings.shape, self.n_sectors - 1), np.float32)
        for row in np.ndindex(density.shape[:2]):  # all at once need the memory
            shares = _shares(density[row] * areas, lit[row[0]] * areas)
            density[row] = shares / areas
            of_rings[row] = shares.sum(axis=-1)
            sectors[row] = cumulative(shares)[..., 1:-1]
        self.density = singles(density)
        self.same_side = singles(of_rings[:, :, 0].sum(axis=-1))
        rings = cumulative(of_rings)[..., 1:-1]
        self.rings, self.sectors = (
            SearchTree(part.reshape(-1, part.shape[-1])) for part in (rings, sectors)
        )

    def pdf(
        self,
        wi: mi.Vector3f,
        wo: mi.Vector3f,
        enabled: tuple[bool, bool],
        active: mi.Bool | bool,
    ) -> mi.Float:
        """Density in 1/sr of :meth:`sample`."""
        row, frame = self._row(wi)
        through = wo.z * wi.z < 0
        wanted = active & self._is_lit(wi) & (wo.z != 0)
        wanted &= dr.select(through, enabled[1] and self.n_hemispheres > 1, enabled[0])
        point = frame.back().of([wo.x, wo.y, dr.abs(wo.z)])
        x, y, z = point
        perimeter = dr.maximum(dr.abs(x) + dr.abs(y), TINY)
        cos = x / perimeter
        turns = 0.25 * dr.select(y < 0, 3 + cos, 1 - cos)
        ring = self._lobe(row, through) * self.n_rings
        ring += _step(height(point), self.n_rings)
        index = ring * self.n_sectors + _step(turns, self.n_sectors)
        density = read(self.density, index, wanted)
        if self.n_hemispheres > 1 and not all(enabled):
            same = read(self.same_side, row)
            density /= dr.maximum(same if enabled[0] else 1 - same, TINY)
        return density * z * (x * x + y * y) / (2 * perimeter * perimeter)

    def sample(
        self,
        wi: mi.Vector3f,
        enabled: tuple[bool, bool],
        sample1: mi.Float,
        sample2: mi.Point2f,
    ) -> mi.Vector3f:
        """Direction in a hemisphere picked by `sample1`, drawn by `sample2`."""
        row, frame = self._row(wi)
        through = mi.Bool(enabled[1] and not enabled[0])
        if self.n_hemispheres > 1 and all(enabled):
            through = sample1 >= read(self.same_side, row)
        lobe = self._lobe(row, through)
        ring, past = self.rings.quantile(lobe, sample2.x)
        own = lobe * self.n_rings + ring
        sector, around = self.sectors.quantile(own, sample2.y)
        low, high = (_sin2((mi.Float(ring) + n) / self.n_rings) for n in (0, 1))
        sin2 = low + past * (high - low)
        sine, z = dr.sqrt(sin2), dr.safe_sqrt(1 - sin2)
        x, y, _ = _around((mi.Float(sector) + around) / self.n_sectors)
        x, y, z = frame.of([sine * x, sine * y, z])
        return mi.Vector3f(x, y, dr.select(through ^ (wi.z < 0), -z, z))

    def _row(self, wi: mi.Vector3f) -> tuple[mi.UInt32, Turn]:
        """Row of lobes for the camera's direction, and its azimuth."""
        sine = dr.sqrt(wi.x * wi.x + wi.y * wi.y)
        known = sine > 0
        scale = dr.rcp(dr.select(known, sine, 1))
        cos, sin = dr.select(known, scale * wi.x, 1), scale * wi.y
        row = _step(height([wi.x, wi.y, dr.abs(wi.z)]), self.n_steps)
        if self.n_sides > 1:
            row += dr.select(wi.z < 0, mi.UInt32(self.n_steps), 0)
        return row, Turn(cos, sin)

    def _is_lit(self, wi: mi.Vector3f) -> mi.Bool:
        """Whether the camera's side has a table."""
        return wi.z != 0 if self.n_sides > 1 else wi.z > 0

    def _lobe(self, row: mi.UInt32, through: mi.Bool) -> mi.UInt32:
        """Lobe of a row, in one hemisphere."""
        if self.n_hemispheres == 1:
            return row
        return row * 2 + dr.select(through, mi.UInt32(1), 0)

    # ---------------------------------------------------------------- what is seen

    def _seen(self, faces: Sequence[InterpolatedBSDF | None]) -> Singles:
        """Root mean square of the BSDF in each cell, by the measure of its points."""
        found = aligned(self.shape)
        cells = self.n_rings * self.n_sectors * N_POINTS
        at_once = max(1, MAX_LANES // cells)
        for first in range(0, self.n_steps, at_once):
            steps = np.arange(self.n_steps)[first : first + at_once]
            camera, light, measure = self._points(steps)
            for side, hemisphere in np.ndindex(self.n_sides, self.n_hemispheres):
                # on the face that the light comes to
                face = faces[side ^ hemisphere]
                if face is None or hemisphere >= face.n_hemispheres:
                    continue
                z = -camera.z if hemisphere else camera.z
                values, *_ = face.values(light, mi.Vector3f(camera.x, camera.y, z))
                mean = (sum(values) * (measure / len(values))).numpy()
                squares = np.square(mean, dtype=float).reshape(-1, N_POINTS)
                of_cells = np.sqrt(squares.mean(axis=-1))
                found[side, steps, hemisphere] = of_cells.reshape(-1, *self.shape[3:])
        return found

    def _points(self, steps: Integers) -> tuple[mi.Vector3f, mi.Vector3f, mi.Float]:
        """Directions to the camera and to the light, and the latter's measure.

        Of all points of all cells, step by step.
        """
        shape = len(steps), self.n_rings, self.n_sectors, N_POINTS
        lattice = (np.arange(N_POINTS)[:, None] + 0.5) * STEPS % 1
        step, ring, sector, n = np.indices(shape, sparse=True)
        heights = (steps[step] + lattice[n, 0]) / self.n_steps
        sin2 = self.edges[ring] + lattice[n, 1] * np.diff(self.edges)[ring]
        turns = (sector + lattice[n, 2]) / self.n_sectors
        heights, sin2, turns = (
            floats(np.broadcast_to(one, shape).ravel())
            for one in (heights, sin2, turns)
        )
        x, y, measure = _around(turns)
        sine = dr.sqrt(sin2)
        camera = dr.normalize(mi.Vector3f(heights, 0, 1 - heights))
        return camera, mi.Vector3f(sine * x, sine * y, dr.safe_sqrt(1 - sin2)), measure


def _shares(weights: Floats, even: Floats) -> Floats:
    """Probabilities of cells, `DEFENSIVE` of them uniform; 0 without any weight."""
    total = weights.sum()
    if not total > 0:
        return np.zeros_like(weights)
    shares: Floats = (1 - DEFENSIVE) * weights / total + DEFENSIVE * even / even.sum()
    return shares


def _sin2(height: Any) -> Any:
    """Square of the sine of a direction of this :func:`.height`."""
    return height * height / (height * height + (1 - height) * (1 - height))


def _step(coordinate: mi.Float, n: int) -> mi.UInt32:
    """Which of `n` even steps from 0 to 1 holds a coordinate."""
    return dr.minimum(mi.UInt32(coordinate * n), n - 1)


def _around(turns: mi.Float) -> tuple[mi.Float, mi.Float, mi.Float]:
    """Cosine and sine of an angle, from 0 to 1 along the perimeter of a square.

    And its change in radians, of one of a half.
    """
    ahead = turns < 0.5
    x = dr.select(ahead, 1 - 4 * turns, 4 * turns - 3)
    y = dr.select(ahead, 1 - dr.abs(x), dr.abs(x) - 1)
    scale = dr.rsqrt(x * x + y * y)
    return x * scale, y * scale, scale * scale

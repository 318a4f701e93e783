"""Where points of a lobe move to, between angles and between azimuths, in Dr.Jit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .disk import DiskPoint, above, on_disk, turned
from .half_vectors import goes, sent
from .incident_grid import IncidentGrid
from .incident_places import Place
from .lobes import LobeTable
from .table_reading import doubles, last, read

__all__ = ["Azimuths", "Legs"]


@dataclass(frozen=True)
class _Pieces:
    """Pieces of one coordinate, which points of a leg move with.

    At both ends of the leg: where they begin, and how wide they are per light.
    """

    begins: Sequence[mi.Float64]
    slopes: Sequence[mi.Float64]
    n: int  # of each row

    def find(
        self, row: mi.UInt32, coordinate: mi.Float64, start: mi.Float64
    ) -> _OnPiece:
        """The piece of a row on which a point is at `start` of the leg."""
        first = row * self.n
        piece = last(
            self.n, lambda i: self._at(self.begins, first + i, start) <= coordinate
        )
        index = first + piece
        slope = self._at(self.slopes, index, start)
        share = (coordinate - self._at(self.begins, index, start)) / slope
        return _OnPiece(index, share, slope)

    def moved(self, on: _OnPiece, to: mi.Float64) -> tuple[mi.Float64, mi.Float64]:
        """Coordinate of the point at `to` of the leg, and the stretch of its piece."""
        slope = self._at(self.slopes, on.index, to)
        return self._at(self.begins, on.index, to) + on.share * slope, slope / on.slope

    @staticmethod
    def _at(
        ends: Sequence[mi.Float64], index: mi.UInt32, t: mi.Float64 | int
    ) -> mi.Float64:
        if isinstance(t, int):
            return read(ends[t], index)
        low, high = (read(end, index) for end in ends)
        return (1 - t) * low + t * high


@dataclass(frozen=True)
class _OnPiece:
    """Number of a piece, the light up to a point of it, and its width per light."""

    index: mi.UInt32
    share: mi.Float64
    slope: mi.Float64


class Legs:
    """Ways of points between polar angles, strip by strip and cell by cell.

    Parameters
    ----------
    table : LobeTable
    """

    def __init__(self, table: LobeTable) -> None:
        self.n_hemispheres, n = table.strips.shape[3:]
        self.strips, self.cells = (
            _Pieces([doubles(end) for end in a], [doubles(end) for end in b], n)
            for a, b in (
                (table.strips, table.strip_slopes),
                (table.cells, table.cell_slopes),
            )
        )

    def moved(
        self,
        place: Place,
        hemisphere: mi.UInt32,
        point: DiskPoint,
        start: mi.Float64,
        ends: Sequence[mi.Float64 | int],
    ) -> list[tuple[DiskPoint, mi.Float64]]:
        """Where a point at `start` of the leg is at each of `ends`.

        Each with the stretch of areas.
        """
        row = place.leg * self.n_hemispheres + hemisphere
        strip = self.strips.find(row, point.x, start)
        cell = self.cells.find(strip.index, point.v, start)
        found = []
        for to in ends:
            x, stretch_x = self.strips.moved(strip, to)
            v, stretch_v = self.cells.moved(cell, to)
            x, v = dr.clip(x, -1, 1), dr.clip(v, -1, 1)
            # of y / v, at the new point and at the old one
            across = dr.safe_sqrt(
                (1 - x * x) / dr.maximum(1 - dr.square(point.x), 2.0**-60)
            )
            found.append((DiskPoint(x, v), stretch_x * stretch_v * across))
        return found


class Azimuths:
    """Ways of points between azimuths, by micro-normals that stay.

    Parameters
    ----------
    grid : IncidentGrid
        That says which light moves so: reflected, transmitted or both.
    n_hemispheres : {1, 2}
    """

    def __init__(self, grid: IncidentGrid, n_hemispheres: int) -> None:
        # by hemisphere, with the refractive index of transmission
        self.ways = [
            (number, grid.eta if number else None)
            for number in range(n_hemispheres)
            if grid.moves(number)
        ]

    def came_from(
        self, place: Place, hemisphere: mi.UInt32, point: DiskPoint
    ) -> tuple[DiskPoint, mi.Float64, mi.Bool]:
        """Where light that is sent to a point is in a measured azimuth's lobe.

        With the stretch of areas, and whether any is sent there.
        """
        wo, (own, here) = above(point), place.lights()
        source, stretch, comes = wo, mi.Float64(0), mi.Bool(False)
        for number, eta in self.ways:
            came, scale, valid = sent(wo, here, own, eta, dr)
            this = (hemisphere == number) & valid & goes(came[2], wo[2])
            stretch = dr.select(this, came[2] * scale / wo[2], stretch)
            source = [dr.select(this, a, b) for a, b in zip(came, source)]
            comes |= this
        return on_disk(turned(source, place.past)), stretch, comes

    def goes_to(
        self, place: Place, hemisphere: mi.UInt32, point: DiskPoint
    ) -> tuple[DiskPoint, mi.Bool]:
        """Where light of a measured azimuth is sent to, and whether."""
        wo, (own, here) = turned(above(point), -place.past), place.lights()
        x, v, leaves = point.x, point.v, mi.Bool(False)
        for number, eta in self.ways:
            to, _, valid = sent(wo, own, here, eta, dr)
            this = (hemisphere == number) & valid & goes(wo[2], to[2])
            moved = on_disk(to)
            x, v = dr.select(this, moved.x, x), dr.select(this, moved.v, v)
            leaves |= this
        return DiskPoint(x, v), leaves

"""Where points of a lobe move to between incident directions, in Dr.Jit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .disk import DiskPoint, above, on_disk, turned
from .half_vectors import goes, sent
from .incident_places import Place
from .lobes import LobeTable
from .table_reading import doubles, last, read

__all__ = ["Legs", "MicroNormals", "Way"]


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
        legs = table.legs
        self.n_hemispheres, n = legs.strips.shape[3:]
        self.strips, self.cells = (
            _Pieces([doubles(end) for end in a], [doubles(end) for end in b], n)
            for a, b in (
                (legs.strips, legs.strip_slopes),
                (legs.cells, legs.cell_slopes),
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


@dataclass(frozen=True)
class Way:
    """Where the light of a hemisphere keeps its micro-normals.

    Attributes
    ----------
    hemisphere : {0, 1}
    eta : float or None
        Refractive index of transmission.
    legs : tuple of bool
        On which of the legs of each azimuth.
    """

    hemisphere: int
    eta: float | None
    legs: tuple[bool, ...]


class MicroNormals:
    """Ways of points by micro-normals that stay, whose light comes from elsewhere.

    Parameters
    ----------
    ways : sequence of Way
    with_azimuth : sequence of int
        Hemispheres where the record's azimuth counts; else lobes turn with incidence.
    """

    def __init__(self, ways: Sequence[Way], with_azimuth: Sequence[int]) -> None:
        self.ways, self.with_azimuth = ways, with_azimuth
        # an index that is no constant of the kernel: another one compiles nothing
        self.etas = [
            (way.hemisphere, way.eta and dr.opaque(mi.Float64, way.eta)) for way in ways
        ]
        self.legs = [mi.Bool(list(way.legs)) for way in ways]

    def move(self, place: Place, hemisphere: mi.UInt32) -> mi.Bool:
        """Whether the light of a hemisphere moves so."""
        moves = mi.Bool(False)
        for way, legs in zip(self.ways, self.legs):
            this = hemisphere == way.hemisphere
            if not all(way.legs):
                leg = place.leg - place.azimuth * len(way.legs)
                this &= dr.gather(mi.Bool, legs, leg)
            moves |= this
        return moves

    def came_from(
        self, place: Place, z: mi.Float64, hemisphere: mi.UInt32, point: DiskPoint
    ) -> tuple[DiskPoint, mi.Float64, mi.Bool]:
        """Where light that is sent to a point is in a record's lobe.

        `z` is the cosine of that record's angle of incidence. With the stretch of
        areas, and whether any is sent there.
        """
        wo, (x, v) = above(point), (point.x, point.v)
        stretch, comes = mi.Float64(0), mi.Bool(False)
        for number, eta in self.etas:
            past = self._past(place, number)
            came, scale, valid = sent(wo, place.light(), place.light(past, z), eta, dr)
            this = (hemisphere == number) & valid & goes(came[2], wo[2])
            stretch = dr.select(this, came[2] * scale / wo[2], stretch)
            source = on_disk(turned(came, past))
            x, v = dr.select(this, source.x, x), dr.select(this, source.v, v)
            comes |= this
        return DiskPoint(x, v), stretch, comes

    def goes_to(
        self, place: Place, z: mi.Float64, hemisphere: mi.UInt32, point: DiskPoint
    ) -> tuple[DiskPoint, mi.Bool]:
        """Where light of a record's lobe is sent to, and whether."""
        x, v, leaves = point.x, point.v, mi.Bool(False)
        for number, eta in self.etas:
            past = self._past(place, number)
            wo = turned(above(point), -past)
            to, _, valid = sent(wo, place.light(past, z), place.light(), eta, dr)
            this = (hemisphere == number) & valid & goes(wo[2], to[2])
            moved = on_disk(to)
            x, v = dr.select(this, moved.x, x), dr.select(this, moved.v, v)
            leaves |= this
        return DiskPoint(x, v), leaves

    def _past(self, place: Place, hemisphere: int) -> mi.Float64:
        """Azimuth of incidence from that of the record, if it counts."""
        return place.past if hemisphere in self.with_azimuth else mi.Float64(0)

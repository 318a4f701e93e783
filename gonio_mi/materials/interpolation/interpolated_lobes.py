"""Lobes of a table, transported to other incident directions, in Dr.Jit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np

from .half_vectors import is_redirected, redirected
from .lobes import Drawing, LobeTable, mean_lobes, transport_pieces
from .lookups import (
    DiskPoint,
    IncidentPatches,
    IncidentPlaces,
    Place,
    above,
    between,
    doubles,
    last,
    on_disk,
    quantile,
    read,
    tilted,
    turned,
)


@dataclass(frozen=True)
class _Pieces:
    """Pieces of one coordinate, which points of a segment move with.

    At both ends of the segment: where they begin, and how wide they are per flux.
    """

    begins: Sequence[mi.Float64]
    slopes: Sequence[mi.Float64]
    n: int  # of each row

    def find(
        self, row: mi.UInt32, coordinate: mi.Float64, start: mi.Float64
    ) -> tuple[mi.UInt32, mi.Float64, mi.Float64]:
        """The piece of a row on which a point is at `start` of the segment.

        Its number, the light up to the point, and its width per light.
        """
        first = row * self.n
        piece = last(
            self.n, lambda i: self._at(self.begins, first + i, start) <= coordinate
        )
        index = first + piece
        slope = self._at(self.slopes, index, start)
        fraction = (coordinate - self._at(self.begins, index, start)) / slope
        return index, fraction, slope

    def moved(
        self, on: tuple[mi.UInt32, mi.Float64, mi.Float64], to: mi.Float64
    ) -> tuple[mi.Float64, mi.Float64]:
        """Coordinate of the point at `to` of the segment, and its piece's stretch."""
        index, fraction, before = on
        slope = self._at(self.slopes, index, to)
        return self._at(self.begins, index, to) + fraction * slope, slope / before

    @staticmethod
    def _at(
        ends: Sequence[mi.Float64], index: mi.UInt32, t: mi.Float64 | int
    ) -> mi.Float64:
        if isinstance(t, int):
            return read(ends[t], index)
        low, high = (read(end, index) for end in ends)
        return (1 - t) * low + t * high


class QuantileTransport:
    """Ways of points between polar angles, strip by strip and cell by cell.

    Parameters
    ----------
    table : LobeTable
    """

    def __init__(self, table: LobeTable) -> None:
        pieces = transport_pieces(table.brdf, table.patches, table.grid.phi_i)
        self.n_hemispheres, n = pieces[0].shape[3:]
        strips, strip_slopes, cells, cell_slopes = (
            [doubles(end) for end in ends] for ends in pieces
        )
        self.strips = _Pieces(strips, strip_slopes, n)
        self.cells = _Pieces(cells, cell_slopes, n)

    def moved(
        self,
        place: Place,
        hemisphere: mi.UInt32,
        point: DiskPoint,
        start: mi.Float64,
        ends: Sequence[mi.Float64 | int],
    ) -> list[tuple[DiskPoint, mi.Float64]]:
        """Where a point at `start` of the segment is at each of `ends`.

        Each with the stretch of areas.
        """
        row = place.segment * self.n_hemispheres + hemisphere
        strip = self.strips.find(row, point.x, start)
        cell = self.cells.find(strip[0], point.v, start)
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
class HalfVectorSegments:
    """Where the light of a hemisphere keeps its micro-normals.

    Attributes
    ----------
    hemisphere : {0, 1}
    eta : float or None
        Refractive index of transmission.
    segments : tuple of bool
        On which of the segments of each azimuth.
    """

    hemisphere: int
    eta: float | None
    segments: tuple[bool, ...]


class HalfVectorTransport:
    """Ways of points by micro-normals that stay, whose light comes from elsewhere.

    Parameters
    ----------
    half_vectors : sequence of HalfVectorSegments
    with_azimuth : sequence of int
        Hemispheres where the record's azimuth counts; else lobes turn with incidence.
    """

    def __init__(
        self, half_vectors: Sequence[HalfVectorSegments], with_azimuth: Sequence[int]
    ) -> None:
        self.half_vectors, self.with_azimuth = half_vectors, with_azimuth
        # an index that is no constant of the kernel: another one compiles nothing
        self.etas = [
            (one.hemisphere, one.eta and dr.opaque(mi.Float64, one.eta))
            for one in half_vectors
        ]
        self.segments = [mi.Bool(list(one.segments)) for one in half_vectors]

    def move(self, place: Place, hemisphere: mi.UInt32) -> mi.Bool:
        """Whether the light of a hemisphere moves so."""
        moves = mi.Bool(False)
        for one, segments in zip(self.half_vectors, self.segments):
            this = hemisphere == one.hemisphere
            if not all(one.segments):
                segment = place.segment - place.azimuth * len(one.segments)
                this &= dr.gather(mi.Bool, segments, segment)
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
            came, scale, valid = redirected(
                wo, place.incident(), place.incident(past, z), eta, dr
            )
            this = (hemisphere == number) & valid & is_redirected(came[2], wo[2])
            stretch = dr.select(this, came[2] * scale / wo[2], stretch)
            source = on_disk(turned(came, past))
            x, v = dr.select(this, source.x, x), dr.select(this, source.v, v)
            comes |= this
        return DiskPoint(x, v), stretch, comes

    def goes_to(
        self, place: Place, z: mi.Float64, hemisphere: mi.UInt32, point: DiskPoint
    ) -> tuple[DiskPoint, mi.Bool]:
        """Target direction of light of a record's lobe, and a validity mask."""
        x, v, leaves = point.x, point.v, mi.Bool(False)
        for number, eta in self.etas:
            past = self._past(place, number)
            wo = turned(above(point), -past)
            to, _, valid = redirected(
                wo, place.incident(past, z), place.incident(), eta, dr
            )
            this = (hemisphere == number) & valid & is_redirected(wo[2], to[2])
            moved = on_disk(to)
            x, v = dr.select(this, moved.x, x), dr.select(this, moved.v, v)
            leaves |= this
        return DiskPoint(x, v), leaves

    def _past(self, place: Place, hemisphere: int) -> mi.Float64:
        """Azimuth of incidence from that of the record, if it counts."""
        return place.past if hemisphere in self.with_azimuth else mi.Float64(0)


class LobeArrays:
    """Lobes as measured, one for each row: azimuth, polar angle and hemisphere.

    Points of the disk are in the frame of incidence, whose azimuth is that of the row.

    Parameters
    ----------
    table : LobeTable
    """

    def __init__(self, table: LobeTable) -> None:
        *_, self.n_theta, self.n_phi, self.n_channels = table.brdf.shape
        channels = range(self.n_channels)
        sin2 = np.sin(table.patches.theta_edges) ** 2
        self.sin2, self.phi = doubles([*sin2[:-1], 1]), doubles(table.patches.phi_edges)
        self.brdf = [doubles(table.brdf[..., channel]) for channel in channels]
        self.gradients = [
            [doubles(along[..., channel]) for channel in channels]
            for along in table.gradients
        ]
        self.means = self.brdf[0]
        self.mean_gradients = [along[0] for along in self.gradients]
        if self.n_channels > 1:
            self.means = doubles(mean_lobes(table.brdf))
            self.mean_gradients = [doubles(mean_lobes(g)) for g in table.gradients]
        self.drawing = Drawing(*map(doubles, table.drawing))

    def values(
        self, row: mi.UInt32, phi_i: mi.Float64, point: DiskPoint, active: mi.Bool
    ) -> list[mi.Float64]:
        """BRDF of each channel at a point, 0 where not active."""
        ring, sector, off = self._patch(phi_i, point)
        index = (row * self.n_theta + ring) * self.n_phi + sector
        values = []
        for channel, brdf in enumerate(self.brdf):
            value = read(brdf, index, active)
            for gradient, coordinate in zip(self.gradients, off):
                value += coordinate * read(gradient[channel], index, active)
            values.append(value)
        return values

    def _patch(
        self, phi_i: mi.Float64, point: DiskPoint
    ) -> tuple[mi.UInt32, mi.UInt32, Sequence[mi.Float64]]:
        """Ring and sector in which a point lies, and where, from -1/2 to 1/2."""
        across2 = 1 - dr.square(point.x)
        y = point.v * dr.safe_sqrt(across2)
        z2 = across2 * (1 - dr.square(point.v))
        # whichever of sine and cosine keeps its precision
        sin2 = dr.select(z2 < 0.5, 1 - z2, dr.square(point.x) + dr.square(y))
        ring = last(self.n_theta, lambda i: read(self.sin2, i) <= sin2)
        phi = dr.atan2(y, point.x) + phi_i
        phi -= 2 * dr.pi * dr.floor(phi * (0.5 / dr.pi))
        sector = last(self.n_phi, lambda i: read(self.phi, i) <= phi)
        off = []
        for edges, number, coordinate in (
            (self.sin2, ring, sin2),
            (self.phi, sector, phi),
        ):
            low, high = read(edges, number), read(edges, number + 1)
            off.append(dr.clip((coordinate - low) / (high - low), 0, 1) - 0.5)
        return ring, sector, off

    def drawn(
        self, row: mi.UInt32, phi_i: mi.Float64, sample2: mi.Point2f
    ) -> DiskPoint:
        """Point of a lobe."""
        rings, sectors, tilts, sector_tilts = self.drawing
        ring, fraction = quantile(
            lambda i: read(rings, row * (self.n_theta + 1) + i),
            self.n_theta,
            mi.Float64(sample2.x),
        )
        own = row * self.n_theta + ring
        tilt = read(tilts, own)
        off = tilted(fraction, tilt) - 0.5
        first = own * (self.n_phi + 1)
        sector, fraction = quantile(
            lambda i: read(sectors, first + i) + off * read(sector_tilts, first + i),
            self.n_phi,
            mi.Float64(sample2.y) * (1 + off * tilt),
        )
        patch = own * self.n_phi + sector
        along, around = (read(array, patch) for array in self.mean_gradients)
        mean = read(self.means, patch) + off * along
        past = tilted(fraction, dr.select(mean > 0, around / mean, 0))
        sin2 = between(self.sin2, ring, off + 0.5)
        phi = between(self.phi, sector, past) - phi_i
        sin, cos = dr.sincos(phi)
        sine = dr.sqrt(sin2)
        x, y = sine * cos, sine * sin
        across = dr.sqrt(1 - sin2 + y * y)
        return DiskPoint(x, dr.select(across > 0, y / across, 0))


class InterpolatedLobes:
    """Lobes of a table, each moved to where it is for other incident light.

    What is sent to a point is asked for by :meth:`values`, and where a point is sent to
    by :meth:`moved`: the same transport, backwards and forwards. Points are in the
    frame of incidence where they are wanted, and in that of the record where they are
    known.

    Parameters
    ----------
    table : LobeTable
    incident : IncidentPlaces or IncidentPatches
        Of the table's grid.
    half_vectors : sequence of HalfVectorSegments, optional
        Where light keeps its micro-normals between polar angles; elsewhere it moves by
        :class:`.interpolated_lobes.QuantileTransport`.
    quantiles : QuantileTransport, optional
        Of the table, where it is known.
    """

    def __init__(
        self,
        table: LobeTable,
        incident: IncidentPlaces | IncidentPatches,
        half_vectors: Sequence[HalfVectorSegments] = (),
        quantiles: QuantileTransport | None = None,
    ) -> None:
        self.n_hemispheres = table.brdf.shape[2]
        self.incident = incident
        grid, number = table.grid, range(self.n_hemispheres)
        moving = [n for n in number if incident.n_azimuths > 1 and grid.moves(n)]
        self.normals = HalfVectorTransport(half_vectors, moving)
        by_normals = [one.hemisphere for one in half_vectors if all(one.segments)]
        by_segments = [n for n in number if n not in by_normals]
        every = (True,) * incident.n_segments
        between = [
            HalfVectorSegments(n, grid.eta if n else None, every)
            for n in by_segments
            if n in moving
        ]
        self.azimuths = HalfVectorTransport(between, moving)
        # slow to find: none where nothing moves by them
        moves = by_segments and not grid.incident
        self.segments = (quantiles or QuantileTransport(table)) if moves else None
        self.measured = LobeArrays(table)
        self.n_channels = self.measured.n_channels

    # ------------------------------------------------------- what is sent to a point

    def values(
        self, place: Place, hemisphere: mi.UInt32, point: DiskPoint, active: mi.Bool
    ) -> list[mi.Float64]:
        """BRDF in 1/sr of each channel, of one azimuth's lobes; 0 where not active."""
        if not self.normals.half_vectors:
            return self._by_segments(place, hemisphere, point, active)
        moves = self.normals.move(place, hemisphere)
        values = self._by_normals(place, hemisphere, point, active & moves)
        if self.segments is not None:
            others = self._by_segments(place, hemisphere, point, active & ~moves)
            values = [a + b for a, b in zip(values, others)]
        return values

    def _by_normals(
        self, place: Place, hemisphere: mi.UInt32, point: DiskPoint, active: mi.Bool
    ) -> list[mi.Float64]:
        """What micro-normals of both ends of the segment send, and what stays."""
        values = [mi.Float64(0)] * self.n_channels
        phi_i = self.incident.measured(place.azimuth)
        for end, z in enumerate(place.ends):
            row = place.rows[end] * self.n_hemispheres + hemisphere
            at = place, z, hemisphere, point
            source, stretch, comes = self.normals.came_from(*at)
            sent = self.measured.values(row, phi_i, source, active & comes)
            _, leaves = self.normals.goes_to(*at)
            stays = self._seldom(
                point, active & ~leaves, partial(self.measured.values, row, phi_i)
            )
            fraction = place.fraction(end)
            values = [
                v + fraction * (stretch * a + b) for v, a, b in zip(values, sent, stays)
            ]
        return values

    def _by_segments(
        self, place: Place, hemisphere: mi.UInt32, point: DiskPoint, active: mi.Bool
    ) -> list[mi.Float64]:
        """What moves along the segments, and between azimuths perhaps by micro-normals.

        What these send to a point, and what they would send beyond the horizon and
        therefore stays.
        """
        if not self.azimuths.half_vectors:
            return self._brdf_at_azimuth(place, hemisphere, point, active)
        at = place, place.z_i, hemisphere, point
        source, stretch, comes = self.azimuths.came_from(*at)
        sent = self._brdf_at_azimuth(place, hemisphere, source, active & comes)
        _, leaves = self.azimuths.goes_to(*at)
        stays = self._seldom(
            point, active & ~leaves, partial(self._brdf_at_azimuth, place, hemisphere)
        )
        return [stretch * a + b for a, b in zip(sent, stays)]

    def _seldom(
        self,
        point: DiskPoint,
        active: mi.Bool,
        values: Callable[[DiskPoint, mi.Bool], list[mi.Float64]],
    ) -> list[mi.Float64]:
        """Values of few lanes: all others skip them, which halves the time."""

        def looked_up(x: mi.Float64, v: mi.Float64) -> list[mi.Float64]:
            return values(DiskPoint(x, v), active)

        def nothing(*_: mi.Float64) -> list[mi.Float64]:
            return [mi.Float64(0)] * self.n_channels

        found: list[mi.Float64] = dr.if_stmt(
            (point.x, point.v), active, looked_up, nothing
        )
        return found

    def _brdf_at_azimuth(
        self, place: Place, hemisphere: mi.UInt32, point: DiskPoint, active: mi.Bool
    ) -> list[mi.Float64]:
        """BRDF at the place's azimuth: of both ends of the segment, moved to there."""
        sources = [(point, mi.Float64(1))] * 2
        if self.segments is not None and self.incident.n_angles > 1:
            sources = self.segments.moved(place, hemisphere, point, place.t, (0, 1))
        values = [mi.Float64(0)] * self.n_channels
        phi_i = self.incident.measured(place.azimuth)
        for end, (source, stretch) in enumerate(sources):
            row = place.rows[end] * self.n_hemispheres + hemisphere
            own = self.measured.values(row, phi_i, source, active)
            fraction = stretch * place.fraction(end)
            values = [a + fraction * b for a, b in zip(values, own)]
        return values

    # ---------------------------------------------------- where a point is sent to

    def drawn(
        self, place: Place, hemisphere: mi.UInt32, end: mi.Float64, sample2: mi.Point2f
    ) -> DiskPoint:
        """Point of the lobe at an end of a segment, where it is for incident light."""
        row = dr.select(end > 0.5, place.rows[1], place.rows[0])
        row = row * self.n_hemispheres + hemisphere
        phi_i = self.incident.measured(place.azimuth)
        point = self.measured.drawn(row, phi_i, sample2)
        return self.moved(place, hemisphere, point, end)

    def moved(
        self, place: Place, hemisphere: mi.UInt32, point: DiskPoint, end: mi.Float64
    ) -> DiskPoint:
        """Where a point of the lobe at an end of a segment is for incident light."""
        moved = point
        if self.segments is not None and self.incident.n_angles > 1:
            ((moved, _),) = self.segments.moved(
                place, hemisphere, point, end, [place.t]
            )
        if self.azimuths.half_vectors:
            moved, _ = self.azimuths.goes_to(place, place.z_i, hemisphere, moved)
        if not self.normals.half_vectors:
            return moved
        z = dr.select(end > 0.5, place.ends[1], place.ends[0])
        sent, _ = self.normals.goes_to(place, z, hemisphere, point)
        this = self.normals.move(place, hemisphere)
        return DiskPoint(
            dr.select(this, sent.x, moved.x), dr.select(this, sent.v, moved.v)
        )

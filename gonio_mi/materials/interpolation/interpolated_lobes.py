"""Lobes of a table, transported to other incident directions, in Dr.Jit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .half_vectors import is_redirected, redirected
from .lobes import Drawing, LobeTable, mean_lobes, transport_pieces
from .lookups import (
    Bins,
    IncidentPatches,
    IncidentPlaces,
    Place,
    Turn,
    Vector,
    between,
    doubles,
    last,
    quantile,
    read,
    selected,
    tilted,
)


@dataclass(frozen=True)
class _Pieces:
    """Pieces of one coordinate, which points of a segment move with.

    Where they begin, and how wide they are per flux: pairs, of both ends of a segment.
    """

    begins: mi.Float
    slopes: mi.Float
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
    def _at(pairs: mi.Float, index: mi.UInt32, t: mi.Float64 | int) -> mi.Float64:
        low, high = map(mi.Float64, dr.gather(mi.Point2f, pairs, index))
        if isinstance(t, int):
            return high if t else low
        return (1 - t) * low + t * high


class QuantileTransport:
    """Ways of points between polar angles of an azimuth, strip by strip, cell by cell.

    Points are those of the unit disk below (or above) a unit vector, by x and
    ``y / sqrt(1 - x^2)``.

    Parameters
    ----------
    table : LobeTable
    """

    def __init__(self, table: LobeTable) -> None:
        pieces = transport_pieces(table.brdf[0], table.patches, table.grid.phi_i[0])
        self.n_hemispheres, n = pieces[0].shape[1:3]
        rows = (mi.Float(pairs.ravel()) for pairs in pieces)
        strips, strip_slopes, cells, cell_slopes = rows
        self.strips = _Pieces(strips, strip_slopes, n)
        self.cells = _Pieces(cells, cell_slopes, n)

    def moved_where(
        self,
        active: mi.Bool,
        place: Place,
        hemisphere: mi.UInt32,
        point: Vector,
        start: mi.Float64,
        ends: Sequence[mi.Float64 | int],
    ) -> list[tuple[Vector, mi.Float64]]:
        """As :meth:`moved`; where no lane of a vector is active, nothing is sought."""
        active = active & (point[0] <= 2) & (place.t >= 0) & (hemisphere < 2)

        def sought(*point: mi.Float64) -> list[tuple[Vector, mi.Float64]]:
            return self.moved(place, hemisphere, list(point), start, ends)

        def unmoved(*point: mi.Float64) -> list[tuple[Vector, mi.Float64]]:
            return [(list(point), mi.Float64(1)) for _ in ends]

        found: list[tuple[Vector, mi.Float64]]
        found = dr.if_stmt(tuple(point), active, sought, unmoved)
        return found

    def moved(
        self,
        place: Place,
        hemisphere: mi.UInt32,
        point: Vector,
        start: mi.Float64,
        ends: Sequence[mi.Float64 | int],
    ) -> list[tuple[Vector, mi.Float64]]:
        """Where a point at `start` of the segment is at each of `ends`.

        Each with the stretch of areas.
        """
        x, y, z = point
        across2 = y * y + z * z
        v = dr.select(across2 > 0, y * dr.rsqrt(across2), 0)
        row = place.segment * self.n_hemispheres + hemisphere
        strip = self.strips.find(row, dr.clip(x, -1, 1), start)
        cell = self.cells.find(strip[0], dr.clip(v, -1, 1), start)
        found = []
        for to in ends:
            x, stretch_x = self.strips.moved(strip, to)
            v, stretch_v = self.cells.moved(cell, to)
            x, v = dr.clip(x, -1, 1), dr.clip(v, -1, 1)
            across = dr.sqrt(1 - x * x)
            moved = [x, v * across, across * dr.sqrt(1 - v * v)]
            # of y / v, at the new point and at the old one
            wider = across * dr.rsqrt(dr.maximum(across2, 2.0**-60))
            found.append((moved, stretch_x * stretch_v * wider))
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
        Between polar angles.
    with_azimuth : mapping of int to (float or None)
        Hemispheres where the record's azimuth counts, with their refractive index of
        transmission; else lobes turn with incidence.
    """

    def __init__(
        self,
        half_vectors: Sequence[HalfVectorSegments],
        with_azimuth: Mapping[int, float | None],
    ) -> None:
        self.half_vectors, self.with_azimuth = half_vectors, with_azimuth
        of_angle = {one.hemisphere: one for one in half_vectors}
        self.hemispheres = []
        for number in sorted(of_angle.keys() | with_azimuth.keys()):
            own = of_angle.get(number)
            eta = own.eta if own else with_azimuth[number]
            # an index that is no constant of the kernel: another one compiles nothing
            index = eta and dr.opaque(mi.Float64, eta)
            self.hemispheres.append((number, index, own))
        self.segments = {
            one.hemisphere: mi.Bool(list(one.segments)) for one in half_vectors
        }

    def move(self, place: Place, hemisphere: mi.UInt32) -> mi.Bool:
        """Whether the light of a hemisphere moves so."""
        moves = mi.Bool(False)
        for this, *_ in self._motions(place, 0, hemisphere):
            moves |= this
        return moves

    def came_from(
        self, place: Place, end: int, hemisphere: mi.UInt32, point: Vector
    ) -> tuple[Vector, mi.Float64, mi.Bool]:
        """Where light that is sent to a point is in a record's lobe.

        `end` is that of the segment where the record is. With the stretch of areas,
        and whether any is sent there.
        """
        source, stretch, comes = point, mi.Float64(1), mi.Bool(True)
        for this, before, after, past, eta in self._motions(place, end, hemisphere):
            light = past.back().of(after)
            came, scale, valid = redirected(point, before, light, eta, dr)
            valid &= is_redirected(came[2], point[2])
            comes &= valid | ~this
            this &= valid
            stretch = dr.select(this, came[2] * scale / point[2], stretch)
            source = selected(this, past.of(came), source)
        return source, stretch, comes

    def goes_to(
        self, place: Place, end: int | mi.Bool, hemisphere: mi.UInt32, point: Vector
    ) -> tuple[Vector, mi.Bool]:
        """Target direction of light of a record's lobe, and a validity mask."""
        target, leaves = point, mi.Bool(True)
        for this, before, after, past, eta in self._motions(place, end, hemisphere):
            wo = past.back().of(point)
            to, _, valid = redirected(wo, past.back().of(after), before, eta, dr)
            valid &= is_redirected(wo[2], to[2])
            target = selected(this & valid, to, target)
            leaves &= valid | ~this
        return target, leaves

    def _motions(
        self, place: Place, end: int | mi.Bool, hemisphere: mi.UInt32
    ) -> Iterator[tuple[mi.Bool, Vector, Vector, Turn, mi.Float64 | None]]:
        """Where light of a hemisphere moves: from and to which incident light.

        The latter in the record's frame, which is turned from that of incidence.
        """
        none = Turn(mi.Float64(1), mi.Float64(0))
        low, high = place.ends
        z = place.ends[end] if isinstance(end, int) else dr.select(end, high, low)
        for number, eta, own in self.hemispheres:
            this, to = hemisphere == number, z
            if own is None:
                to = place.z_i
            elif not all(own.segments):
                moves = dr.gather(mi.Bool, self.segments[number], place.segment)
                to = dr.select(moves, z, place.z_i)
                if number not in self.with_azimuth:
                    this &= moves
            past = place.past if number in self.with_azimuth else none
            yield this, place.incident(), place.incident(to), past, eta


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
        theta, phi = table.patches.theta_edges, table.patches.phi_edges
        sin2 = np.array([*np.sin(theta[:-1]) ** 2, 1])
        self.rings, self.sectors = (
            Bins(sin2, theta * (2 / np.pi)),
            Bins(phi, phi / phi[-1]),
        )
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
        self, row: mi.UInt32, phi_i: mi.Float64, point: Vector, active: mi.Bool
    ) -> list[mi.Float64]:
        """BRDF of each channel at a point, 0 where not active."""
        x, y, z = point
        # whichever of sine and cosine keeps its precision
        sin2, z2 = x * x + y * y, z * z
        sin2 = dr.select(z2 < 0.5, 1 - z2, sin2)
        theta = dr.asin(dr.minimum(dr.sqrt(mi.Float(sin2)), 1))
        ring, off_ring = self.rings.find(sin2, theta * (2 * dr.inv_pi))
        turns = (dr.atan2(y, x) + phi_i) * (0.5 / dr.pi)
        turns -= dr.floor(turns)
        sector, off_sector = self.sectors.find(turns * (2 * dr.pi), mi.Float(turns))
        index = (row * self.n_theta + ring) * self.n_phi + sector
        values = []
        for channel, brdf in enumerate(self.brdf):
            value = read(brdf, index, active)
            for gradient, coordinate in zip(self.gradients, (off_ring, off_sector)):
                value += coordinate * read(gradient[channel], index, active)
            values.append(value)
        return values

    def drawn(self, row: mi.UInt32, phi_i: mi.Float64, sample2: mi.Point2f) -> Vector:
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
        sin2 = between(self.rings.edges, ring, off + 0.5)
        sin, cos = dr.sincos(between(self.sectors.edges, sector, past) - phi_i)
        sine = dr.sqrt(sin2)
        return [sine * cos, sine * sin, dr.safe_sqrt(1 - sin2)]


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
        Where light keeps its micro-normals between polar angles; elsewhere that of
        isotropic materials moves by :class:`.QuantileTransport`, and else stays.
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
        grid = table.grid
        moving = {
            number: grid.eta if number else None
            for number in range(self.n_hemispheres)
            if incident.n_azimuths > 1 and grid.moves(number)
        }
        self.normals = HalfVectorTransport(half_vectors, moving)
        by_normals = [one for one in half_vectors if all(one.segments)]
        self.quantiles = None
        if (
            grid.isotropic
            and incident.n_angles > 1
            and len(by_normals) < self.n_hemispheres
        ):
            self.quantiles = quantiles or QuantileTransport(table)
        self.measured = LobeArrays(table)
        self.n_channels = self.measured.n_channels

    def values(
        self, place: Place, hemisphere: mi.UInt32, point: Vector, active: mi.Bool
    ) -> list[mi.Float64]:
        """BRDF in 1/sr of each channel, of one azimuth's lobes; 0 where not active.

        What micro-normals of both ends of the segment send, and what stays; or what
        moves by quantiles.
        """
        values = [mi.Float64(0)] * self.n_channels
        others, by_quantiles = [], mi.Bool(False)
        if self.quantiles is not None:
            by_quantiles = active & ~self.normals.move(place, hemisphere)
            at = place, hemisphere, point, place.t
            others = self.quantiles.moved_where(by_quantiles, *at, (0, 1))
        phi_i = self.incident.measured(place.azimuth)
        for end, row in enumerate(place.rows):
            row = row * self.n_hemispheres + hemisphere
            way = place, end, hemisphere, point
            source, stretch, comes = self.normals.came_from(*way)
            if others:
                source = selected(by_quantiles, others[end][0], source)
                stretch = dr.select(by_quantiles, others[end][1], stretch)
            own = self.measured.values(row, phi_i, source, active & comes)
            own = [stretch * one for one in own]
            if self.normals.hemispheres:
                _, leaves = self.normals.goes_to(*way)
                stays = self._seldom(row, phi_i, point, active & ~leaves)
                own = [a + b for a, b in zip(own, stays)]
            fraction = place.fraction(end)
            values = [a + fraction * b for a, b in zip(values, own)]
        return values

    def _seldom(
        self, row: mi.UInt32, phi_i: mi.Float64, point: Vector, active: mi.Bool
    ) -> list[mi.Float64]:
        """Values of few lanes: all others skip them, which halves the time."""

        def looked_up(x: mi.Float64, y: mi.Float64, z: mi.Float64) -> list[mi.Float64]:
            return self.measured.values(row, phi_i, [x, y, z], active)

        def nothing(*_: mi.Float64) -> list[mi.Float64]:
            return [mi.Float64(0)] * self.n_channels

        found: list[mi.Float64] = dr.if_stmt(tuple(point), active, looked_up, nothing)
        return found

    def drawn(
        self, place: Place, hemisphere: mi.UInt32, end: mi.Bool, sample2: mi.Point2f
    ) -> Vector:
        """Point of the lobe at an end of a segment, where it is for incident light."""
        row = dr.select(end, place.rows[1], place.rows[0])
        row = row * self.n_hemispheres + hemisphere
        phi_i = self.incident.measured(place.azimuth)
        point = self.measured.drawn(row, phi_i, sample2)
        return self.moved(place, hemisphere, point, end)

    def moved(
        self, place: Place, hemisphere: mi.UInt32, point: Vector, end: int | mi.Bool
    ) -> Vector:
        """Where a point of the lobe at an end of a segment is for incident light."""
        sent, _ = self.normals.goes_to(place, end, hemisphere, point)
        if self.quantiles is None:
            return sent
        start = dr.select(mi.Bool(end), mi.Float64(1), 0)
        others = ~self.normals.move(place, hemisphere) & (start >= 0)
        at = place, hemisphere, point, start
        ((moved, _),) = self.quantiles.moved_where(others, *at, [place.t])
        return selected(others, moved, sent)

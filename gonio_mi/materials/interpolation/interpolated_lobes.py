"""Lobes of a table, transported to other incident directions, in Dr.Jit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ...array_types import Singles
from .half_vectors import is_redirected, redirected
from .lobes import LobeTable, transport_pieces
from .lookups import (
    TINY,
    Bins,
    IncidentPatches,
    IncidentPlaces,
    Place,
    SearchTree,
    Turn,
    Vector,
    height,
    heights,
    packet,
    selected,
    singles,
    tilted,
)


class _Pieces:
    """Pieces of one coordinate, which points of a segment move with.

    Parameters
    ----------
    pieces : ndarray, shape (..., n, 4)
        Where they begin on both ends of a segment, and how wide they are per flux.
    """

    def __init__(self, pieces: Singles) -> None:
        self.n = pieces.shape[-2]
        rows = pieces.reshape(-1, self.n, 4)
        self.packets = singles(pieces)
        self.tree = SearchTree(*np.moveaxis(rows[:, 1:, :2], -1, 0))

    def find(self, row: mi.UInt32, coordinate: mi.Float, start: mi.Float) -> _OnPiece:
        """The piece of a row on which a point is at `start` of the segment."""
        index = row * self.n + self.tree.find(row, coordinate, start)
        piece = packet(self.packets, index)
        begin, slope = _mixed(piece, start)
        return _OnPiece(index, piece, begin, slope, (coordinate - begin) / slope)


@dataclass(frozen=True)
class _OnPiece:
    """A point on a piece of a row, at one place of the segment."""

    index: mi.UInt32  # of the piece, in all rows
    piece: mi.Vector4f
    begin: mi.Float
    slope: mi.Float
    light: mi.Float  # from the beginning of the piece to the point

    def moved(self, to: mi.Float | int) -> tuple[mi.Float, mi.Float]:
        """By how much the point moves to `to` of the segment, and its stretch."""
        begin, slope = _mixed(self.piece, to)
        by = begin - self.begin + self.light * (slope - self.slope)
        return by, slope / self.slope


def _mixed(piece: mi.Vector4f, t: mi.Float | int) -> tuple[mi.Float, mi.Float]:
    """Where a piece begins at `t` of the segment, and its width per flux."""
    if isinstance(t, int):
        return piece[t], piece[2 + t]
    return piece.x + t * (piece.y - piece.x), piece.z + t * (piece.w - piece.z)


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
        self.n_hemispheres = table.brdf.shape[2]
        self.strips, self.cells = map(_Pieces, pieces)

    def moved_where(
        self,
        active: mi.Bool,
        place: Place,
        hemisphere: mi.UInt32,
        point: Vector,
        start: mi.Float,
        ends: Sequence[mi.Float | int],
    ) -> list[tuple[Vector, mi.Float]]:
        """As :meth:`moved`; where no lane of a vector is active, nothing is sought."""
        active = active & (point[0] <= 2) & (place.t >= 0) & (hemisphere < 2)

        def sought(*point: mi.Float) -> list[tuple[Vector, mi.Float]]:
            return self.moved(place, hemisphere, list(point), start, ends)

        def unmoved(*point: mi.Float) -> list[tuple[Vector, mi.Float]]:
            return [(list(point), mi.Float(1)) for _ in ends]

        found: list[tuple[Vector, mi.Float]]
        found = dr.if_stmt(tuple(point), active, sought, unmoved)
        return found

    def moved(
        self,
        place: Place,
        hemisphere: mi.UInt32,
        point: Vector,
        start: mi.Float,
        ends: Sequence[mi.Float | int],
    ) -> list[tuple[Vector, mi.Float]]:
        """Where a point at `start` of the segment is at each of `ends`.

        Each with the stretch of areas.
        """
        x, y, z = point
        across2 = y * y + z * z
        per_across = dr.rsqrt(dr.maximum(across2, TINY))
        v, depth2 = y * per_across, dr.square(z * per_across)
        row = place.segment * self.n_hemispheres + hemisphere
        strip = self.strips.find(row, dr.clip(x, -1, 1), start)
        cell = self.cells.find(strip.index, dr.clip(v, -1, 1), start)
        found = []
        for to in ends:
            # by differences: what does not move stays, to the last digit
            by_x, stretch_x = strip.moved(to)
            by_v, stretch_v = cell.moved(to)
            across = dr.safe_sqrt(across2 - by_x * (2 * x + by_x))
            depth = dr.safe_sqrt(depth2 - by_v * (2 * v + by_v))
            moved = [x + by_x, (v + by_v) * across, across * depth]
            # of y / v, at the new point and at the old one
            found.append((moved, stretch_x * stretch_v * across * per_across))
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
            index = eta and dr.opaque(mi.Float, eta)
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
    ) -> tuple[Vector, mi.Float, mi.Bool]:
        """Where light that is sent to a point is in a record's lobe.

        `end` is that of the segment where the record is. With the stretch of areas,
        and whether any is sent there.
        """
        source, stretch, comes = point, mi.Float(1), mi.Bool(True)
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
    ) -> Iterator[tuple[mi.Bool, Vector, Vector, Turn, mi.Float | None]]:
        """Where light of a hemisphere moves: from and to which incident light.

        The latter in the record's frame, which is turned from that of incidence.
        """
        none = Turn(mi.Float(1), mi.Float(0))
        low, high = place.ends
        ends = place.ends[end] if isinstance(end, int) else selected(end, high, low)
        for number, eta, own in self.hemispheres:
            this, to = hemisphere == number, ends
            if own is None:
                to = place.incident
            elif not all(own.segments):
                moves = dr.gather(mi.Bool, self.segments[number], place.segment)
                to = selected(moves, ends, place.incident)
                if number not in self.with_azimuth:
                    this &= moves
            past = place.past if number in self.with_azimuth else none
            yield this, place.incident, to, past, eta


@dataclass(frozen=True)
class _InPatch:
    """A point in a patch: its number, and where in it, from -1/2 to 1/2."""

    number: mi.UInt32
    off_ring: mi.Float
    off_sector: mi.Float


class LobeArrays:
    """Lobes as measured, one for each row: azimuth, polar angle and hemisphere.

    Points of the disk are in the frame of incidence, whose azimuth is that of the row,
    in turns.

    Parameters
    ----------
    table : LobeTable
    """

    def __init__(self, table: LobeTable) -> None:
        *_, self.n_theta, self.n_phi, self.n_channels = table.brdf.shape
        theta, turns = table.patches.theta_edges, table.patches.phi_edges / (2 * np.pi)
        theta = np.array([*theta[:-1], np.pi / 2])
        self.rings, self.sectors = Bins(heights(theta)), Bins(turns)
        sin2, cos2 = np.sin(theta) ** 2, np.cos(theta) ** 2
        width = np.where(theta[1:] < 1, np.diff(sin2), -np.diff(cos2))
        numbers = [sin2[:-1], cos2[1:], width, 1 / width]
        self.ring_edges = singles(np.stack(numbers, axis=-1))
        self.sector_edges = singles(np.stack([turns[:-1], np.diff(turns)], axis=-1))
        self.cells, self.n_packets = singles(table.cells), table.cells.shape[-1] // 4
        # fractions of the flux below edges of rings, and of sectors in each ring
        self.ring_flux, self.sector_flux = (
            SearchTree(cumulative.reshape(-1, cumulative.shape[-1])[:, 1:-1])
            for cumulative in table.cumulative()
        )

    def values(
        self, row: mi.UInt32, turns: mi.Float, point: Vector, active: mi.Bool
    ) -> list[mi.Float]:
        """BRDF of each channel at a point, 0 where not active."""
        return self.values_in(row, self.patch(turns, point), active)

    def patch(self, turns: mi.Float, point: Vector) -> _InPatch:
        """The patch that holds a point, whichever row is asked."""
        x, y, z = point
        ring = self.rings.find(height(point))
        sin2, cos2, _, per_width = packet(self.ring_edges, ring)
        # whichever of sine and cosine keeps its precision
        past, left = x * x + y * y - sin2, z * z - cos2
        in_ring = dr.select(z * z < 0.5, 1 - left * per_width, past * per_width)
        turns = dr.atan2(y, x) * dr.inv_two_pi + turns
        turns -= dr.floor(turns)
        sector, in_sector = self._sector(turns)
        offsets = (dr.clip(part, 0, 1) - 0.5 for part in (in_ring, in_sector))
        return _InPatch(ring * self.n_phi + sector, *offsets)

    def values_in(
        self, row: mi.UInt32, where: _InPatch, active: mi.Bool
    ) -> list[mi.Float]:
        """BRDF of each channel in a patch, 0 where not active."""
        index = row * (self.n_theta * self.n_phi) + where.number
        numbers = self._numbers(index, active)
        if self.n_channels > 1:
            numbers = numbers[3:]
        return [
            numbers[n]
            + where.off_ring * numbers[n + 1]
            + where.off_sector * numbers[n + 2]
            for n in range(0, 3 * self.n_channels, 3)
        ]

    def _sector(self, turns: mi.Float) -> tuple[mi.UInt32, mi.Float]:
        """Sector of an azimuth, and how far in it."""
        sector = self.sectors.find(turns)
        if self.sectors.is_even:
            return sector, turns * self.n_phi - mi.Float(sector)
        begin, width = dr.gather(mi.Point2f, self.sector_edges, sector)
        return sector, (turns - begin) / width

    def _numbers(self, index: mi.UInt32, active: mi.Bool) -> list[mi.Float]:
        """All that is known of a patch, 0 where not active."""
        first, each = index * self.n_packets, range(self.n_packets)
        return [a for n in each for a in packet(self.cells, first + n, active)]

    def drawn(self, row: mi.UInt32, turns: mi.Float, sample2: mi.Point2f) -> Vector:
        """Point of a lobe."""
        ring, fraction = self.ring_flux.quantile(row, sample2.x)
        own = row * self.n_theta + ring
        sector, past = self.sector_flux.quantile(own, sample2.y)
        index = own * self.n_phi + sector
        mean, along, around, _ = packet(self.cells, index * self.n_packets)
        fraction = tilted(fraction, dr.select(mean > 0, along / mean, 0))
        mean += (fraction - 0.5) * along
        past = tilted(past, dr.select(mean > 0, around / mean, 0))
        sin2, cos2, width, _ = packet(self.ring_edges, ring)
        sine, z = (
            dr.sqrt(sin2 + fraction * width),
            dr.sqrt(cos2 + (1 - fraction) * width),
        )
        begin, width = dr.gather(mi.Point2f, self.sector_edges, sector)
        sin, cos = dr.sincos((begin + past * width - turns) * (2 * dr.pi))
        return [sine * cos, sine * sin, z]


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
    ) -> list[mi.Float]:
        """BRDF in 1/sr of each channel, of one azimuth's lobes; 0 where not active.

        What micro-normals of both ends of the segment send, and what stays; or what
        moves by quantiles.
        """
        values = [mi.Float(0)] * self.n_channels
        others, by_quantiles = [], mi.Bool(False)
        if self.quantiles is not None:
            by_quantiles = active & ~self.normals.move(place, hemisphere)
            at = place, hemisphere, point, place.t
            others = self.quantiles.moved_where(by_quantiles, *at, (0, 1))
        stays = []
        for end, row in enumerate(place.rows):
            row = row * self.n_hemispheres + hemisphere
            way = place, end, hemisphere, point
            source, stretch, comes = self.normals.came_from(*way)
            if others:
                source = selected(by_quantiles, others[end][0], source)
                stretch = dr.select(by_quantiles, others[end][1], stretch)
            own = self.measured.values(row, place.turns, source, active & comes)
            stretch *= place.fraction(end)
            values = [a + stretch * b for a, b in zip(values, own)]
            _, leaves = self.normals.goes_to(*way)
            stays.append((row, active & ~leaves))
        if self.normals.hemispheres:
            added = self._seldom(place, stays, point)
            values = [a + b for a, b in zip(values, added)]
        return values

    def _seldom(
        self, place: Place, stays: Sequence[tuple[mi.UInt32, mi.Bool]], point: Vector
    ) -> list[mi.Float]:
        """Values of what stays, of few lanes: all others skip them.

        Parameters
        ----------
        place : Place
        stays : sequence of (row, active)
            Of both ends of the segment.
        point : Vector
        """

        def looked_up(*point: mi.Float) -> list[mi.Float]:
            values = [mi.Float(0)] * self.n_channels
            where = self.measured.patch(place.turns, list(point))
            for end, (row, active) in enumerate(stays):
                own = self.measured.values_in(row, where, active)
                values = [a + place.fraction(end) * b for a, b in zip(values, own)]
            return values

        def nothing(*_: mi.Float) -> list[mi.Float]:
            return [mi.Float(0)] * self.n_channels

        (_, low), (_, high) = stays
        found: list[mi.Float] = dr.if_stmt(tuple(point), low | high, looked_up, nothing)
        return found

    def drawn(
        self, place: Place, hemisphere: mi.UInt32, end: mi.Bool, sample2: mi.Point2f
    ) -> Vector:
        """Point of the lobe at an end of a segment, where it is for incident light."""
        row = dr.select(end, place.rows[1], place.rows[0])
        row = row * self.n_hemispheres + hemisphere
        point = self.measured.drawn(row, place.turns, sample2)
        return self.moved(place, hemisphere, point, end)

    def moved(
        self, place: Place, hemisphere: mi.UInt32, point: Vector, end: int | mi.Bool
    ) -> Vector:
        """Where a point of the lobe at an end of a segment is for incident light."""
        sent, _ = self.normals.goes_to(place, end, hemisphere, point)
        if self.quantiles is None:
            return sent
        start = dr.select(mi.Bool(end), mi.Float(1), 0)
        others = ~self.normals.move(place, hemisphere) & (start >= 0)
        at = place, hemisphere, point, start
        ((moved, _),) = self.quantiles.moved_where(others, *at, [place.t])
        return selected(others, moved, sent)

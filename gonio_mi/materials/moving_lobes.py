"""Lobes that move from where they were measured to another incident direction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import drjit as dr
import mitsuba as mi

from .disk import DiskPoint
from .incident_places import IncidentPlaces, Place
from .lit_lobes import LitLobes
from .lobes import LobeTable
from .moving_points import Legs, MicroNormals, Way

__all__ = ["MovingLobes"]


class MovingLobes:
    """Lobes of a table, each moved to where it is for other incident light.

    What is sent to a point is asked for by :meth:`values`, and where a point is sent to
    by :meth:`moved`: the same ways, backwards and forwards. Points are in the frame of
    incidence where they are wanted, and in that of the record where they are known.

    Parameters
    ----------
    table : LobeTable
    incident : IncidentPlaces
        Of the table's grid.
    ways : sequence of Way, optional
        Where light keeps its micro-normals between polar angles; elsewhere it moves by
        :class:`.moving_points.Legs`.
    """

    def __init__(
        self, table: LobeTable, incident: IncidentPlaces, ways: Sequence[Way] = ()
    ) -> None:
        self.n_hemispheres = table.brdf.shape[2]
        self.incident = incident
        grid, number = table.grid, range(self.n_hemispheres)
        moving = [n for n in number if incident.n_azimuths > 1 and grid.moves(n)]
        self.normals = MicroNormals(ways, moving)
        by_normals = [way.hemisphere for way in ways if all(way.legs)]
        by_legs = [n for n in number if n not in by_normals]
        every = (True,) * incident.n_legs
        between = [
            Way(n, grid.eta if n else None, every) for n in by_legs if n in moving
        ]
        self.azimuths = MicroNormals(between, moving)
        # slow to find: none where nothing moves by them
        self.legs = Legs(table) if by_legs else None
        self.measured = LitLobes(table)
        self.n_channels = self.measured.n_channels

    # ------------------------------------------------------- what is sent to a point

    def values(
        self, place: Place, hemisphere: mi.UInt32, point: DiskPoint, active: mi.Bool
    ) -> list[mi.Float64]:
        """BRDF in 1/sr of each channel, of one azimuth's lobes; 0 where not active."""
        if not self.normals.ways:
            return self._by_legs(place, hemisphere, point, active)
        moves = self.normals.move(place, hemisphere)
        values = self._by_normals(place, hemisphere, point, active & moves)
        if self.legs is not None:
            others = self._by_legs(place, hemisphere, point, active & ~moves)
            values = [a + b for a, b in zip(values, others)]
        return values

    def _by_normals(
        self, place: Place, hemisphere: mi.UInt32, point: DiskPoint, active: mi.Bool
    ) -> list[mi.Float64]:
        """What micro-normals of both ends of the leg send, and what of them stays."""
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
            share = place.share(end)
            values = [
                v + share * (stretch * a + b) for v, a, b in zip(values, sent, stays)
            ]
        return values

    def _by_legs(
        self, place: Place, hemisphere: mi.UInt32, point: DiskPoint, active: mi.Bool
    ) -> list[mi.Float64]:
        """What moves along the legs, and between azimuths perhaps by micro-normals.

        What these send to a point, and what they would send beyond the horizon and
        therefore stays.
        """
        if not self.azimuths.ways:
            return self._of_azimuth(place, hemisphere, point, active)
        at = place, place.z_i, hemisphere, point
        source, stretch, comes = self.azimuths.came_from(*at)
        sent = self._of_azimuth(place, hemisphere, source, active & comes)
        _, leaves = self.azimuths.goes_to(*at)
        stays = self._seldom(
            point, active & ~leaves, partial(self._of_azimuth, place, hemisphere)
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

    def _of_azimuth(
        self, place: Place, hemisphere: mi.UInt32, point: DiskPoint, active: mi.Bool
    ) -> list[mi.Float64]:
        """BRDF at the azimuth of the place: of both ends of the leg, moved to there."""
        sources = [(point, mi.Float64(1))] * 2
        if self.legs is not None and self.incident.n_angles > 1:
            sources = self.legs.moved(place, hemisphere, point, place.t, (0, 1))
        values = [mi.Float64(0)] * self.n_channels
        phi_i = self.incident.measured(place.azimuth)
        for end, (source, stretch) in enumerate(sources):
            row = place.rows[end] * self.n_hemispheres + hemisphere
            own = self.measured.values(row, phi_i, source, active)
            share = stretch * place.share(end)
            values = [a + share * b for a, b in zip(values, own)]
        return values

    # ---------------------------------------------------- where a point is sent to

    def drawn(
        self,
        place: Place,
        hemisphere: mi.UInt32,
        end: mi.Float64,
        sample2: mi.Point2f,
    ) -> DiskPoint:
        """Point of the lobe at an end of a leg, where it is for incident light."""
        row = dr.select(end > 0.5, place.rows[1], place.rows[0])
        row = row * self.n_hemispheres + hemisphere
        phi_i = self.incident.measured(place.azimuth)
        point = self.measured.drawn(row, phi_i, sample2)
        return self.moved(place, hemisphere, point, end)

    def moved(
        self, place: Place, hemisphere: mi.UInt32, point: DiskPoint, end: mi.Float64
    ) -> DiskPoint:
        """Where a point of the lobe at an end of a leg is for incident light."""
        moved = point
        if self.legs is not None and self.incident.n_angles > 1:
            ((moved, _),) = self.legs.moved(place, hemisphere, point, end, [place.t])
        if self.azimuths.ways:
            moved, _ = self.azimuths.goes_to(place, place.z_i, hemisphere, moved)
        if not self.normals.ways:
            return moved
        z = dr.select(end > 0.5, place.ends[1], place.ends[0])
        sent, _ = self.normals.goes_to(place, z, hemisphere, point)
        this = self.normals.move(place, hemisphere)
        return DiskPoint(
            dr.select(this, sent.x, moved.x), dr.select(this, sent.v, moved.v)
        )

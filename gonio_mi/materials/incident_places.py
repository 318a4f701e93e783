"""Which measured incident directions surround another one, in Dr.Jit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .disk import turned
from .incident_grid import IncidentGrid
from .table_reading import doubles, last, read

__all__ = ["IncidentPlaces", "Place"]


@dataclass(frozen=True)
class Place:
    """Where to look in the table: one measured azimuth, and for each lane a leg."""

    weight: mi.Float64  # share of this azimuth
    azimuth: mi.UInt32  # its index
    leg: mi.UInt32  # index among the legs of all azimuths
    rows: tuple[mi.UInt32, ...]  # of azimuth and polar angle at both ends of the leg
    t: mi.Float64  # how far on the leg, from 0 to 1
    past: mi.Float64  # angle from this azimuth to that of incidence
    z_i: mi.Float64  # cosine of the angle of incidence
    ends: tuple[mi.Float64, ...]  # the same at both ends of the leg

    def light(self, past: Any = None, z: Any = None) -> list[Any]:
        """Where light comes from: +x, or from azimuth `past` before it, at cosine z."""
        z = self.z_i if z is None else z
        here = [dr.safe_sqrt(1 - dr.square(z)), mi.Float64(0), z]
        return here if past is None else turned(here, -past)

    def share(self, end: int) -> mi.Float64:
        """What an end of the leg has of this azimuth."""
        return self.t if end else 1 - self.t


class IncidentPlaces:
    """Polar angles and azimuths of a grid, and what is between them.

    Parameters
    ----------
    grid : IncidentGrid
    """

    def __init__(self, grid: IncidentGrid) -> None:
        self.n_azimuths, self.n_angles = len(grid.phi_i), len(grid.theta_i)
        self.n_legs = max(self.n_angles - 1, 1)
        self.sin_i = doubles(np.sin(np.radians(grid.theta_i)))
        self.cos_i = doubles(np.cos(np.radians(grid.theta_i)))
        self.phi_i = doubles(np.radians(grid.phi_i))

    def azimuth(self, wi: mi.Vector3f) -> mi.Float64:
        """Azimuth of `wi`; along the normal, where all meet, the record's first one."""
        normal = (wi.x == 0) & (wi.y == 0)
        first = read(self.phi_i, mi.UInt32(0))
        return dr.select(normal, first, mi.Float64(dr.atan2(wi.y, wi.x)))

    def measured(self, azimuth: mi.UInt32) -> mi.Float64:
        """Azimuth of the records of that number, in radians."""
        return read(self.phi_i, azimuth)

    def around(self, wi: mi.Vector3f, phi: mi.Float64) -> list[Place]:
        """Return the one or two measured azimuths to mix for `wi`, whose own is phi."""
        leg, t = mi.UInt32(0), mi.Float64(0)
        if self.n_angles > 1:
            x, y = mi.Float64(wi.x), mi.Float64(wi.y)
            sine = dr.sqrt(x * x + y * y)
            leg = last(self.n_legs, lambda i: read(self.sin_i, i) <= sine)
            low, high = read(self.sin_i, leg), read(self.sin_i, leg + 1)
            t = dr.clip((sine - low) / (high - low), 0, 1)
        z_i = mi.Float64(wi.z) / dr.sqrt(mi.Float64(dr.squared_norm(wi)))
        place = partial(self._place, leg, t, z_i)
        if self.n_azimuths == 1:
            return [place(mi.Float64(1), mi.UInt32(0), mi.Float64(0))]
        turn = 2 * dr.pi
        phi = phi - turn * dr.floor(phi / turn)  # -= would change the caller's too
        end = mi.UInt32(self.n_azimuths - 1)
        low = last(self.n_azimuths, lambda i: read(self.phi_i, i) <= phi)
        # before the first azimuth is after the last one
        low = dr.select(phi < read(self.phi_i, mi.UInt32(0)), end, low)
        high = dr.select(low == end, 0, low + 1)
        past = phi - read(self.phi_i, low)
        gap = read(self.phi_i, high) - read(self.phi_i, low)
        past = dr.select(past < 0, past + turn, past)
        gap = dr.select(gap <= 0, gap + turn, gap)
        share = past / gap
        return [place(1 - share, low, past), place(share, high, past - gap)]

    def _place(
        self,
        leg: mi.UInt32,
        t: mi.Float64,
        z_i: mi.Float64,
        weight: mi.Float64,
        azimuth: mi.UInt32,
        past: mi.Float64,
    ) -> Place:
        first = azimuth * self.n_angles
        rows = first + leg, first + dr.minimum(leg + 1, self.n_angles - 1)
        ends = tuple(read(self.cos_i, row - first) for row in rows)
        leg = azimuth * self.n_legs + leg
        return Place(weight, azimuth, leg, rows, t, past, z_i, ends)

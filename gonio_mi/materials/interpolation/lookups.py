"""Where lobes are looked up, in Dr.Jit: points, tables, directions around another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from ...collector import Subdivision
from ...transport.collector_sphere import DRJIT
from .incident_grid import IncidentGrid
from .lobes import aligned


@dataclass(frozen=True)
class DiskPoint:
    """Point of the unit disk, turned so that light comes from +x."""

    x: mi.Float64
    v: mi.Float64  # y / sqrt(1 - x^2)


def seen_from(wo: mi.Vector3f, phi_i: mi.Float64) -> DiskPoint:
    """Point of the disk below (or above) which a unit vector ends."""
    x, y, z = (mi.Float64(component) for component in (wo.x, wo.y, wo.z))
    norm = 1 / dr.sqrt(x * x + y * y + z * z)
    return on_disk([norm * one for one in turned([x, y, z], -phi_i)])


def on_disk(wo: Sequence[Any]) -> DiskPoint:
    """The same, from coordinates in the incidence frame."""
    x, y, z = wo
    across = dr.sqrt(y * y + z * z)
    return DiskPoint(dr.clip(x, -1, 1), dr.select(across > 0, y / across, 0))


def above(point: DiskPoint) -> list[Any]:
    """Coordinates of the unit vector above a point of the disk."""
    across = dr.safe_sqrt(1 - dr.square(point.x))
    return [point.x, point.v * across, across * dr.safe_sqrt(1 - dr.square(point.v))]


def turned(v: Sequence[Any], angle: mi.Float64) -> list[Any]:
    """Coordinates of a vector turned about the normal."""
    sin, cos = dr.sincos(angle)
    x, y, z = v
    return [x * cos - y * sin, x * sin + y * cos, z]


def towards(point: DiskPoint, phi_i: mi.Float64, upper: mi.Bool) -> mi.Vector3f:
    """Unit vector above or below a point of the disk."""
    x, y, z = turned(above(point), phi_i)
    return mi.Vector3f(x, y, dr.select(upper, z, -z))


def doubles(values: ArrayLike) -> mi.Float64:
    """Array of all values, in one row; what is :func:`.lobes.aligned` is not copied."""
    row = np.ravel(values)
    if row.dtype != float or row.ctypes.data % 64 or not row.flags.writeable:
        memory = aligned((len(row), 1))[:, 0]
        memory[:] = row
        row = memory
    return mi.Float64(row)


def read(array: mi.Float64, index: mi.UInt32, active: mi.Bool = True) -> mi.Float64:
    """Numbers of an array, 0 where not active."""
    return dr.gather(mi.Float64, array, mi.UInt32(index), active)


def last(n: int, begins: Callable[[mi.UInt32], mi.Bool]) -> mi.UInt32:
    """Last of `n` ascending pieces that `begins`; the first always does."""
    if n == 1:
        return mi.UInt32(0)
    return mi.UInt32(dr.binary_search(1, n, begins)) - 1


def between(edges: mi.Float64, number: mi.UInt32, part: mi.Float64) -> mi.Float64:
    """Coordinate of the part of a bin."""
    low, high = read(edges, number), read(edges, number + 1)
    return low + part * (high - low)


def quantile(
    cumulative: Callable[[mi.UInt32], mi.Float64], n: int, fraction: mi.Float64
) -> tuple[mi.UInt32, mi.Float64]:
    """Bin in which the flux reaches a `fraction`, and how far on in the bin.

    `cumulative` gives what is below each of the ``n + 1`` edges.
    """
    number = last(n, lambda i: cumulative(i) <= fraction)
    low, high = cumulative(number), cumulative(number + 1)
    inside = dr.select(high > low, (fraction - low) / (high - low), 0.5)
    return number, dr.clip(inside, 0, 1)


def tilted(fraction: mi.Float64, tilt: mi.Float64) -> mi.Float64:
    """Coordinate below which `fraction` of a density is that is linear from 0 to 1.

    It changes by `tilt`, within 2, and is 1 in the middle.
    """
    tilt = dr.clip(tilt, -2, 2)
    start = 1 - tilt / 2
    root = start + dr.safe_sqrt(start * start + 2 * tilt * fraction)
    return dr.select(root > 0, dr.clip(2 * fraction / root, 0, 1), fraction)


@dataclass(frozen=True)
class Place:
    """Where to look in the table: one measured azimuth, and for each lane a segment."""

    weight: mi.Float64  # of this azimuth
    azimuth: mi.UInt32  # its index
    segment: mi.UInt32  # index among the segments of all azimuths
    rows: tuple[mi.UInt32, ...]  # of azimuth and polar angle at both ends of it
    t: mi.Float64  # how far on the segment, from 0 to 1
    past: mi.Float64  # angle from this azimuth to that of incidence
    z_i: mi.Float64  # cosine of the angle of incidence
    ends: tuple[mi.Float64, ...]  # the same at both ends of the segment

    def incident(self, past: Any = None, z: Any = None) -> list[Any]:
        """Incident direction: +x, or azimuth `past` before it, at cosine z."""
        z = self.z_i if z is None else z
        here = [dr.safe_sqrt(1 - dr.square(z)), mi.Float64(0), z]
        return here if past is None else turned(here, -past)

    def fraction(self, end: int) -> mi.Float64:
        """What an end of the segment has of this azimuth."""
        return self.t if end else 1 - self.t


class IncidentPatches:
    """Patches of incidence, in each of which light of all directions has its lobes.

    Lobes neither turn nor move: the frame of incidence has the azimuth 0.

    Parameters
    ----------
    patches : Subdivision
    """

    n_azimuths = n_angles = n_segments = 1

    def __init__(self, patches: Subdivision) -> None:
        self.patches = patches

    def azimuth(self, wi: mi.Vector3f) -> mi.Float64:  # noqa: ARG002
        """Azimuth of the frame of lobes."""
        return mi.Float64(0)

    def measured(self, azimuth: mi.UInt32) -> mi.Float64:  # noqa: ARG002
        """Azimuth of the frame of lobes."""
        return mi.Float64(0)

    def around(self, wi: mi.Vector3f, phi: mi.Float64) -> list[Place]:
        """Return the row of the patch that holds `wi`."""
        v = dr.normalize(wi)
        row = mi.UInt32(self.patches.patch_index(DRJIT, v.x, v.y, dr.abs(v.z)))
        row = dr.minimum(row, self.patches.n_patches - 1)  # of NaN too
        z = mi.Float64(v.z)
        one, zero, first = mi.Float64(1), mi.Float64(0), mi.UInt32(0)
        return [Place(one, first, first, (row, row), zero, phi, z, (z, z))]


class IncidentPlaces:
    """Polar angles and azimuths of a grid, and what is between them.

    Parameters
    ----------
    grid : IncidentGrid
    """

    def __init__(self, grid: IncidentGrid) -> None:
        self.n_azimuths, self.n_angles = len(grid.phi_i), len(grid.theta_i)
        self.n_segments = max(self.n_angles - 1, 1)
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
        segment, t = mi.UInt32(0), mi.Float64(0)
        if self.n_angles > 1:
            x, y = mi.Float64(wi.x), mi.Float64(wi.y)
            sine = dr.sqrt(x * x + y * y)
            segment = last(self.n_segments, lambda i: read(self.sin_i, i) <= sine)
            low, high = read(self.sin_i, segment), read(self.sin_i, segment + 1)
            t = dr.clip((sine - low) / (high - low), 0, 1)
        z_i = mi.Float64(wi.z) / dr.sqrt(mi.Float64(dr.squared_norm(wi)))
        ends = segment, dr.minimum(segment + 1, self.n_angles - 1)

        def place(weight: Any, azimuth: mi.UInt32, past: mi.Float64) -> Place:
            first = azimuth * self.n_angles
            rows = first + ends[0], first + ends[1]
            z_ends = tuple(read(self.cos_i, row - first) for row in rows)
            number = azimuth * self.n_segments + segment
            return Place(weight, azimuth, number, rows, t, past, z_i, z_ends)

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
        fraction = past / gap
        return [place(1 - fraction, low, past), place(fraction, high, past - gap)]

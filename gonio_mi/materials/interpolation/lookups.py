"""Where lobes are looked up, in Dr.Jit: points, tables, directions around another."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from ...array_types import Floats
from ...collector import Subdivision
from ...transport.collector_sphere import DRJIT
from .incident_grid import IncidentGrid
from .lobes import aligned

# Steps of a table of bins, at most about, and the part of a step by which what is known
# roughly, in single precision, may be wrong.
MAX_STEPS, MARGIN = 2**12, 1e-2


# Coordinates of a unit vector in the frame of incidence, whose light comes from +x; z
# is the height above, or the depth below, the surface.
Vector = list[Any]


@dataclass(frozen=True)
class Turn:
    """Angle about the normal, by its cosine and sine."""

    cos: Any
    sin: Any

    def of(self, v: Sequence[Any]) -> Vector:
        """Coordinates of a vector after the turn."""
        x, y, z = v
        return [x * self.cos - y * self.sin, x * self.sin + y * self.cos, z]

    def back(self) -> Turn:
        """The opposite turn."""
        return Turn(self.cos, -self.sin)


def turn_by(angle: mi.Float64) -> Turn:
    """Turn by an angle in radians."""
    sin, cos = dr.sincos(angle)
    return Turn(cos, sin)


def seen_from(wo: mi.Vector3f, frame: Turn) -> Vector:
    """Unit vector in the frame of incidence."""
    x, y, z = (mi.Float64(component) for component in (wo.x, wo.y, wo.z))
    norm = dr.rcp(dr.sqrt(x * x + y * y + z * z))
    return frame.back().of([norm * x, norm * y, norm * dr.abs(z)])


def towards(v: Vector, frame: Turn, upper: mi.Bool) -> mi.Vector3f:
    """Unit vector above or below the surface."""
    x, y, z = frame.of(v)
    return mi.Vector3f(x, y, dr.select(upper, z, -z))


def selected(mask: mi.Bool, yes: Sequence[Any], no: Sequence[Any]) -> Vector:
    """One of two vectors in each lane."""
    return [dr.select(mask, a, b) for a, b in zip(yes, no)]


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


class Bins:
    """Bins of a coordinate, found without a search.

    A table of equal steps of another coordinate, which is known roughly, says from
    which bin on to look; `n_next` more steps find it.

    Parameters
    ----------
    edges : ndarray
        Ascending.
    rough : ndarray
        The same, from 0 to 1, in the other coordinate.
    """

    def __init__(self, edges: Floats, rough: Floats) -> None:
        self.edges = doubles(edges)
        self.n = len(edges) - 1
        self.is_even = bool(np.allclose(np.diff(edges) * self.n, edges[-1]))
        self.steps_per_unit = self.n / float(edges[-1])
        narrowest = max(float(np.diff(rough).min()), 1 / MAX_STEPS)
        steps = np.arange(2 * math.ceil(1 / narrowest))
        ends = (
            np.searchsorted(rough, (steps + past) / len(steps), side="right") - 1
            for past in (-MARGIN, 1 + MARGIN)
        )
        low, high = (np.clip(end, 0, self.n - 1) for end in ends)
        self.first, self.n_steps = mi.UInt32(low), len(steps)
        self.n_next = int((high - low).max())

    def find(self, value: mi.Float64, rough: mi.Float) -> tuple[mi.UInt32, mi.Float64]:
        """Bin of a coordinate, and where in it, from -1/2 to 1/2."""
        if self.is_even:
            place = value * self.steps_per_unit
            number = dr.minimum(mi.UInt32(place), self.n - 1)
            return number, dr.clip(place - mi.Float64(number), 0, 1) - 0.5
        step = dr.clip(mi.Int32(rough * self.n_steps), 0, self.n_steps - 1)
        number = dr.gather(mi.UInt32, self.first, mi.UInt32(step))
        for _ in range(self.n_next):
            above = (number + 1 < self.n) & (read(self.edges, number + 1) <= value)
            number = dr.select(above, number + 1, number)
        low, high = read(self.edges, number), read(self.edges, number + 1)
        return number, dr.clip((value - low) / (high - low), 0, 1) - 0.5


@dataclass(frozen=True)
class Place:
    """Where to look in the table: one measured azimuth, and for each lane a segment."""

    weight: mi.Float64  # of this azimuth
    azimuth: mi.UInt32  # its index
    segment: mi.UInt32  # index among the segments
    rows: tuple[mi.UInt32, ...]  # of azimuth and polar angle at both ends of it
    t: mi.Float64  # how far on the segment, from 0 to 1
    past: Turn  # from this azimuth to that of incidence
    z_i: mi.Float64  # cosine of the angle of incidence
    ends: tuple[mi.Float64, ...]  # the same at both ends of the segment

    def incident(self, z: Any = None) -> Vector:
        """Incident direction, or one at cosine z, towards +x."""
        z = self.z_i if z is None else z
        return [dr.safe_sqrt(1 - dr.square(z)), mi.Float64(0), z]

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

    def frame(self, wi: mi.Vector3f) -> Turn:  # noqa: ARG002
        """Return the frame of lobes, whatever the incident direction."""
        return Turn(mi.Float64(1), mi.Float64(0))

    def measured(self, azimuth: mi.UInt32) -> mi.Float64:  # noqa: ARG002
        """Azimuth of the frame of lobes."""
        return mi.Float64(0)

    def around(self, wi: mi.Vector3f, frame: Turn) -> list[Place]:
        """Return the row of the patch that holds `wi`."""
        v = dr.normalize(wi)
        row = mi.UInt32(self.patches.patch_index(DRJIT, v.x, v.y, dr.abs(v.z)))
        row = dr.minimum(row, self.patches.n_patches - 1)  # of NaN too
        z = mi.Float64(v.z)
        one, zero, first = mi.Float64(1), mi.Float64(0), mi.UInt32(0)
        return [Place(one, first, first, (row, row), zero, frame, z, (z, z))]


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

    def frame(self, wi: mi.Vector3f) -> Turn:
        """Azimuth of `wi`; along the normal, where all meet, the record's first one."""
        x, y = mi.Float64(wi.x), mi.Float64(wi.y)
        sine = dr.sqrt(x * x + y * y)
        first = turn_by(read(self.phi_i, mi.UInt32(0)))
        known = sine > 0
        scale = dr.rcp(dr.select(known, sine, 1))
        return Turn(
            dr.select(known, scale * x, first.cos),
            dr.select(known, scale * y, first.sin),
        )

    def measured(self, azimuth: mi.UInt32) -> mi.Float64:
        """Azimuth of the records of that number, in radians."""
        return read(self.phi_i, azimuth)

    def around(self, wi: mi.Vector3f, frame: Turn) -> list[Place]:
        """Return the one or two measured azimuths to mix for `wi`."""
        segment, t = mi.UInt32(0), mi.Float64(0)
        if self.n_angles > 1:
            x, y = mi.Float64(wi.x), mi.Float64(wi.y)
            sine = dr.sqrt(x * x + y * y)
            segment = last(self.n_segments, lambda i: read(self.sin_i, i) <= sine)
            low, high = read(self.sin_i, segment), read(self.sin_i, segment + 1)
            t = dr.clip((sine - low) / (high - low), 0, 1)
        z_i = mi.Float64(wi.z) / dr.sqrt(mi.Float64(dr.squared_norm(wi)))
        ends = segment, dr.minimum(segment + 1, self.n_angles - 1)
        z_ends = tuple(read(self.cos_i, end) for end in ends)

        def place(weight: Any, azimuth: mi.UInt32, past: Turn) -> Place:
            first = azimuth * self.n_angles
            rows = first + ends[0], first + ends[1]
            return Place(weight, azimuth, segment, rows, t, past, z_i, z_ends)

        if self.n_azimuths == 1:
            none = Turn(mi.Float64(1), mi.Float64(0))
            return [place(mi.Float64(1), mi.UInt32(0), none)]
        turn = 2 * dr.pi
        phi = dr.atan2(frame.sin, frame.cos)
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
        return [
            place(1 - fraction, low, turn_by(past)),
            place(fraction, high, turn_by(past - gap)),
        ]

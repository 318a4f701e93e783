"""Where lobes are looked up, in Dr.Jit: points, tables, directions around another."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from ...array_types import Floats, Numbers, Singles
from ...collector import Subdivision
from ...transport.collector_sphere import DRJIT
from .incident_grid import IncidentGrid
from .lobes import aligned

# Steps of a table of bins, at most about.
MAX_STEPS = 2**12

# Numbers of a row that are compared at once, and one that is larger than any of them.
N_AT_ONCE, BEYOND = 8, 2.0

# Nothing is divided by less.
TINY = 2.0**-60

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


def turn_by(angle: mi.Float) -> Turn:
    """Turn by an angle in radians."""
    sin, cos = dr.sincos(angle)
    return Turn(cos, sin)


def seen_from(wo: mi.Vector3f, frame: Turn) -> Vector:
    """Unit vector in the frame of incidence."""
    x, y, z = dr.normalize(wo)
    return frame.back().of([x, y, dr.abs(z)])


def towards(v: Vector, frame: Turn, upper: mi.Bool) -> mi.Vector3f:
    """Unit vector above or below the surface."""
    x, y, z = frame.of(v)
    return mi.Vector3f(x, y, dr.select(upper, z, -z))


def selected(mask: mi.Bool, yes: Sequence[Any], no: Sequence[Any]) -> Vector:
    """One of two vectors in each lane."""
    return [dr.select(mask, a, b) for a, b in zip(yes, no)]


def singles(values: ArrayLike) -> mi.Float:
    """Array of all values, in one row; what is :func:`.lobes.aligned` is not copied."""
    row = np.ravel(values)
    if row.dtype != np.float32 or row.ctypes.data % 64 or not row.flags.writeable:
        memory = aligned(row.shape)
        memory[:] = row
        row = memory
    return mi.Float(row)


def read(array: mi.Float, index: mi.UInt32, active: mi.Bool = True) -> mi.Float:
    """Numbers of an array, 0 where not active."""
    return dr.gather(mi.Float, array, mi.UInt32(index), active)


def packet(array: mi.Float, index: mi.UInt32, active: mi.Bool = True) -> mi.Vector4f:
    """Four numbers that lie side by side, 0 where not active."""
    return dr.gather(mi.Vector4f, array, index, active)


def tilted(fraction: mi.Float, tilt: mi.Float) -> mi.Float:
    """Coordinate below which `fraction` of a density is that is linear from 0 to 1.

    It changes by `tilt`, within 2, and is 1 in the middle.
    """
    tilt = dr.clip(tilt, -2, 2)
    start = 1 - tilt / 2
    root = start + dr.safe_sqrt(start * start + 2 * tilt * fraction)
    return dr.select(root > 0, dr.clip(2 * fraction / root, 0, 1), fraction)


def height(v: Vector) -> mi.Float:
    """Coordinate of a direction between normal (0) and horizon (1).

    Without an arc function as even as the polar angle, within a factor of two, and as
    precise on both ends.
    """
    x, y, z = v
    sine = dr.sqrt(x * x + y * y)
    return sine / (sine + z)


def heights(theta: Floats) -> Floats:
    """The same of polar angles in radians."""
    sin, cos = np.sin(theta), np.cos(theta)
    coordinate: Floats = sin / (sin + cos)
    return coordinate


class Bins:
    """Bins of a coordinate from 0 to 1, found without a search.

    A table of equal steps says in which bin each begins, and where that ends; few steps
    need to look further.

    Parameters
    ----------
    edges : ndarray
        Ascending, from 0 to 1.
    """

    def __init__(self, edges: Floats) -> None:
        self.n = len(edges) - 1
        self.is_even = bool(np.allclose(np.diff(edges) * self.n, 1))
        edges = edges.astype(np.float32)
        narrowest = max(float(np.diff(edges).min()), 1 / MAX_STEPS)
        self.n_steps = math.ceil(1 / narrowest)
        steps = np.arange(self.n_steps + 1) / self.n_steps
        first = np.searchsorted(edges, steps, side="right") - 1
        first = np.clip(first, 0, self.n - 1)
        ends = np.append(edges[1:-1], BEYOND)
        self.ends = singles(ends)
        self.steps = singles(np.stack([first, ends[first]], axis=-1)[:-1])
        self.n_next = int(np.diff(first).max())

    def find(self, coordinate: mi.Float) -> mi.UInt32:
        """Bin of a coordinate."""
        if self.n == 1:
            return mi.UInt32(0)
        if self.is_even:
            return dr.minimum(mi.UInt32(coordinate * self.n), self.n - 1)
        step = dr.minimum(mi.UInt32(coordinate * self.n_steps), self.n_steps - 1)
        first, end = dr.gather(mi.Point2f, self.steps, step)
        number = mi.UInt32(first) + dr.select(coordinate >= end, mi.UInt32(1), 0)
        for _ in range(1, self.n_next):
            above = coordinate >= read(self.ends, number)
            number = dr.select(above, number + 1, number)
        return number


class SearchTree:
    """Rows of ascending numbers, in which places are found by eight numbers at once.

    Of the last number of each eight there is a row of its own, and so on, down to
    eight. Of numbers that are mixed of two each, four are found at once.

    Parameters
    ----------
    *ends : ndarray, shape (rows, n)
        Where the pieces of each row end, below 2; or two of them, between which the
        wanted one is linear.
    """

    def __init__(self, *ends: Numbers) -> None:
        self.n_at_once = N_AT_ONCE // len(ends)
        # the last group has room for a number that none is beyond
        levels = [_in_groups(ends, ends[0].shape[1] // self.n_at_once + 1)]
        while (n := levels[0].shape[1]) > 1:
            last = list(np.moveaxis(levels[0][..., -1], 2, 0))
            levels.insert(0, _in_groups(last, -(-n // self.n_at_once)))
        self.n_groups = [level.shape[1] for level in levels]
        self.arrays = [singles(level) for level in levels]

    def find(self, row: mi.UInt32, value: mi.Float, t: Any = None) -> mi.UInt32:
        """How many pieces of a row end at a value or below."""
        number = mi.UInt32(0)
        for n_groups, array in zip(self.n_groups, self.arrays):
            first = (row * n_groups + number) * 2
            ends = [packet(array, first + half) for half in range(2)]
            if t is not None:
                low, high = ends
                ends = [low + t * (high - low)]
            passed = (dr.select(a <= value, mi.UInt32(1), 0) for b in ends for a in b)
            number = number * self.n_at_once + sum(passed)
        return number

    def quantile(
        self, row: mi.UInt32, fraction: mi.Float
    ) -> tuple[mi.UInt32, mi.Float]:
        """Bin in which the flux reaches a `fraction`, and how far on in the bin.

        Rows are the flux below the edges between bins, of 1.
        """
        fraction = dr.minimum(fraction, dr.one_minus_epsilon(mi.Float))
        number = self.find(row, fraction)
        here = row * (self.n_groups[-1] * N_AT_ONCE) + number
        low = read(self.arrays[-1], here - 1, number > 0)
        high = dr.minimum(read(self.arrays[-1], here), 1)
        inside = dr.select(high > low, (fraction - low) / (high - low), 0.5)
        return number, dr.clip(inside, 0, 1)


def _in_groups(ends: Sequence[Numbers], n_groups: int) -> Singles:
    """Rows in groups of eight numbers, shape ``(rows, groups, ends, 8 / ends)``."""
    n_rows, n = ends[0].shape
    width = N_AT_ONCE // len(ends)
    whole, rest = divmod(n, width)
    groups = aligned((n_rows, n_groups, len(ends), width))
    groups[:, whole:] = BEYOND
    for number, own in enumerate(ends):
        groups[:, :whole, number] = own[:, : n - rest].reshape(n_rows, whole, width)
        if rest:
            groups[:, whole, number, :rest] = own[:, n - rest :]
    return groups


@dataclass(frozen=True)
class Place:
    """Where to look in the table: one measured azimuth, and for each lane a segment."""

    weight: mi.Float  # of this azimuth
    turns: mi.Float  # its angle, from 0 to 1
    segment: mi.UInt32  # index among the segments
    pair: mi.UInt32  # the same, of those of all azimuths
    rows: tuple[mi.UInt32, ...]  # of azimuth and polar angle at both ends of it
    t: mi.Float  # how far on the segment, from 0 to 1
    past: Turn  # from this azimuth to that of incidence
    incident: Vector  # incident direction, towards +x
    ends: tuple[Vector, ...]  # the same at both ends of the segment

    def fraction(self, end: int) -> mi.Float:
        """What an end of the segment has of this azimuth."""
        return self.t if end else 1 - self.t


class IncidentPatches:
    """Patches of incidence, in each of which light of all directions has its lobes.

    Lobes neither turn nor move: the frame of incidence has the azimuth 0.

    Parameters
    ----------
    patches : Subdivision
    """

    n_azimuths = n_angles = 1

    def __init__(self, patches: Subdivision) -> None:
        self.patches = patches
        self.pairs = np.repeat(np.arange(patches.n_patches)[:, None], 2, axis=1)

    def frame(self, wi: mi.Vector3f) -> Turn:  # noqa: ARG002
        """Return the frame of lobes, whatever the incident direction."""
        return Turn(mi.Float(1), mi.Float(0))

    def around(self, wi: mi.Vector3f, frame: Turn) -> list[Place]:
        """Return the row of the patch that holds `wi`."""
        v = dr.normalize(wi)
        row = mi.UInt32(self.patches.patch_index(DRJIT, v.x, v.y, dr.abs(v.z)))
        row = dr.minimum(row, self.patches.n_patches - 1)  # of NaN too
        one, zero = mi.Float(1), mi.Float(0)
        towards = seen_from(wi, frame)
        ends = towards, towards
        return [
            Place(one, zero, mi.UInt32(0), row, (row, row), zero, frame, towards, ends)
        ]


class IncidentPlaces:
    """Polar angles and azimuths of a grid, and what is between them.

    Parameters
    ----------
    grid : IncidentGrid

    Attributes
    ----------
    pairs : ndarray of int, shape (pairs, 2)
        Numbers of the rows at both ends of all segments, azimuth by azimuth.
    """

    def __init__(self, grid: IncidentGrid) -> None:
        self.n_azimuths, self.n_angles = len(grid.phi_i), len(grid.theta_i)
        theta_i, turns = np.radians(grid.theta_i), grid.phi_i / 360
        low = np.arange(max(self.n_angles - 1, 1))
        high = np.minimum(low + 1, self.n_angles - 1)
        self.n_segments = len(low)
        ends = np.stack([low, high], axis=-1)
        first = np.arange(self.n_azimuths)[:, None, None] * self.n_angles
        self.pairs = (first + ends).reshape(-1, 2)
        sin, cos = np.sin(theta_i), np.cos(theta_i)
        numbers = [sin[low], sin[high], cos[low], cos[high]]
        self.segments = singles(np.stack(numbers, axis=-1))
        self.angles = SearchTree(heights(theta_i)[None, 1:-1])
        past = turns - turns[0]
        gaps = np.diff(past, append=1)
        numbers = [np.cos(2 * np.pi * turns), np.sin(2 * np.pi * turns), past, gaps]
        self.azimuths = singles(np.stack(numbers, axis=-1))
        self.gaps = SearchTree(past[None, 1:])
        self.first_turns = singles(turns[:1])

    def frame(self, wi: mi.Vector3f) -> Turn:
        """Azimuth of `wi`; along the normal, where all meet, the record's first one."""
        sine = dr.sqrt(wi.x * wi.x + wi.y * wi.y)
        first = packet(self.azimuths, mi.UInt32(0))
        known = sine > 0
        scale = dr.rcp(dr.select(known, sine, 1))
        return Turn(
            dr.select(known, scale * wi.x, first.x),
            dr.select(known, scale * wi.y, first.y),
        )

    def around(self, wi: mi.Vector3f, frame: Turn) -> list[Place]:
        """Return the one or two measured azimuths to mix for `wi`."""
        x, _, z = seen_from(wi, frame)
        incident = [x, mi.Float(0), z]
        segment, t = mi.UInt32(0), mi.Float(0)
        if self.n_angles > 2:
            segment = self.angles.find(mi.UInt32(0), height(incident))
        low, high, z_low, z_high = packet(self.segments, segment)
        if self.n_angles > 1:
            # whichever of sine and cosine keeps its precision
            past = dr.select(z < x, (z_low - z) * (z_low + z), (x - low) * (x + low))
            width = dr.maximum((x + low) * (high - low), TINY)
            t = dr.clip(past / width, 0, 1)
        ends = [low, mi.Float(0), z_low], [high, mi.Float(0), z_high]

        def place(weight: Any, azimuth: mi.UInt32, turns: Any, past: Turn) -> Place:
            first = azimuth * self.n_angles + segment
            rows = first, first + min(self.n_angles - 1, 1)
            pair = azimuth * self.n_segments + segment
            known = weight, turns, segment, pair, rows, t
            return Place(*known, past, incident, ends)

        first_turns = read(self.first_turns, mi.UInt32(0))
        if self.n_azimuths == 1:
            none = Turn(mi.Float(1), mi.Float(0))
            return [place(mi.Float(1), mi.UInt32(0), first_turns, none)]
        turns = dr.atan2(frame.sin, frame.cos) * (0.5 * dr.inv_pi) - first_turns
        turns -= dr.floor(turns)
        number = dr.minimum(self.gaps.find(mi.UInt32(0), turns), self.n_azimuths - 1)
        next_one = dr.select(number == self.n_azimuths - 1, 0, number + 1)
        own, other = (packet(self.azimuths, n) for n in (number, next_one))
        fraction = dr.clip((turns - own.z) / own.w, 0, 1)
        weights = 1 - fraction, fraction
        return [
            place(weight, n, one.z + first_turns, _turn_between(one, frame))
            for weight, n, one in zip(weights, (number, next_one), (own, other))
        ]


def _turn_between(azimuth: mi.Vector4f, frame: Turn) -> Turn:
    """Turn from a measured azimuth, by its cosine and sine, to that of a frame."""
    cos = frame.cos * azimuth.x + frame.sin * azimuth.y
    sin = frame.sin * azimuth.x - frame.cos * azimuth.y
    return Turn(cos, sin)

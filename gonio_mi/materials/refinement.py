"""Refinement of incident directions: intervals between them, split or settled.

Polar angles first, and azimuths on the ring of each.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..results.azimuth_symmetry import AzimuthSymmetry, azimuth_of
from ..results.campaign_outcome import PredictionError

# Segments are not split into parts below so many degrees. What a split leaves of the
# error of a segment: more than a fourth, since lobes change faster at grazing
# incidence.
MIN_SEGMENT_WIDTH = 0.25
ERROR_LEFT_BY_SPLIT = 1 / 2


@dataclass(frozen=True)
class Interval:
    """Neighbours on an axis of incident directions, between which light is predicted.

    Attributes
    ----------
    low, high : float
        In the axis' own unit.
    on : float
        Which of several parallel axes: the polar angle of a ring of azimuths.
    """

    low: float
    high: float
    on: float = 0.0

    def parts(self, middle: float) -> tuple[Interval, Interval]:
        """Both parts beside a middle."""
        return replace(self, high=middle), replace(self, low=middle)


@dataclass
class Axis:
    """Intervals of polar angles, or of azimuths, and what is expected in them.

    Attributes
    ----------
    middle : callable
        Where to split an interval; None where it is as narrow as it may be.
    left : float
        What a split is expected to leave of the error of an interval. A fourth, where
        lobes are smooth and change as fast in both parts.
    errors : dict
        Largest error expected in each interval; None if nothing is known.
    """

    middle: Callable[[Interval], float | None]
    left: float = 1 / 4
    errors: dict[Interval, float | None] = field(default_factory=dict)

    def levels(self, on: float = 0.0) -> list[float]:
        """Ends of the intervals, ascending."""
        own = [one for one in self.errors if one.on == on]
        return sorted({one.low for one in own} | {one.high for one in own})

    def around(self, value: float, on: float = 0.0) -> Interval:
        """Interval that holds a value."""
        return next(i for i in self.errors if i.on == on and i.low <= value <= i.high)

    def split(self, interval: Interval, error: float) -> float | None:
        """Split where an error was seen; return the middle, or None if it cannot be."""
        middle = self.middle(interval)
        if middle is None:
            self.errors[interval] = error
            return None
        del self.errors[interval]
        for part in interval.parts(middle):
            self.errors[part] = self.left * error
        return middle

    def unsettled(self, limit: float) -> list[Interval]:
        """Intervals that may be wrong by more, and that can be split."""
        return [
            interval
            for interval, error in self.errors.items()
            if (error is None or error > limit) and self.middle(interval) is not None
        ]


def refined(
    axis: Axis,
    limit: float,
    errors_at: Callable[[Sequence[Interval], Sequence[float]], Sequence[float]],
    check: Callable[[], None] = lambda: None,
) -> None:
    """Split intervals until the error in the middle of each is at most `limit`.

    An interval is looked at where nothing is known of it, or where what is expected
    from a wider one is too much; a middle that was predicted well enough is not needed.
    Of those that are, the worst is split first.

    Parameters
    ----------
    axis : Axis
    limit : float
    errors_at : callable
        Errors of the predictions in the middles of intervals.
    check : callable
        Raises an exception if there are more intervals than may be: the last split is
        undone, and it is passed on.
    """
    while todo := axis.unsettled(limit):
        middles = [axis.middle(interval) or 0.0 for interval in todo]
        found = dict(zip(todo, errors_at(todo, middles)))
        axis.errors |= found
        for interval in sorted(found, key=lambda one: found[one], reverse=True):
            if found[interval] <= limit:
                break
            before = axis.errors.copy()
            axis.split(interval, found[interval])
            try:
                check()
            except Exception:
                axis.errors = before
                raise


class IncidentRings:
    """Directions that a material is made of, and the intervals between them.

    Parameters
    ----------
    angles : sequence of float
        Polar angles to begin with, in degrees.
    symmetry : AzimuthSymmetry
        Azimuths are chosen in its domain only.
    n_azimuths : int
        Of a whole turn to begin with; of an isotropic specimen one is enough.

    Attributes
    ----------
    segments : Axis
        Between polar angles, in degrees.
    gaps : Axis
        Between azimuths of each polar angle, in sectors.
    """

    def __init__(
        self, angles: Sequence[float], symmetry: AzimuthSymmetry, n_azimuths: int
    ) -> None:
        self.symmetry, self.n_azimuths = symmetry, n_azimuths
        self.isotropic = n_azimuths == 1
        self.segments = Axis(
            _middle_angle, ERROR_LEFT_BY_SPLIT, dict.fromkeys(_intervals(angles))
        )
        self.gaps = Axis(_middle_sector)

    def begin_gaps(self) -> None:
        """Give every ring the azimuths to begin with."""
        for theta in self.segments.levels()[1:]:
            self.gaps.errors |= dict.fromkeys(_intervals(self._first_sectors(), theta))

    def azimuth(self, sector: float) -> float:
        """Azimuth of a sector's edge in degrees."""
        return azimuth_of(sector, self.symmetry.n_sectors)

    @property
    def first_azimuths(self) -> list[float]:
        """Initial azimuths in degrees."""
        return [self.azimuth(sector) for sector in self._own(self._first_sectors())]

    def ring(self, theta: float) -> list[tuple[float, float]]:
        """Directions of one polar angle that the material is made of."""
        sectors = self._own(self.gaps.levels(theta)) or [0.0]
        return [(theta, self.azimuth(sector)) for sector in sectors]

    def directions(self) -> list[tuple[float, float]]:
        """All directions that the material is made of."""
        return [one for theta in self.segments.levels() for one in self.ring(theta)]

    def expected(self, limit: float) -> float:
        """How many directions an error of `limit` will need, by the errors known."""

        def parts(axis: Axis) -> float:
            errors = [4 * limit if e is None else e for e in axis.errors.values()]
            return float(np.sqrt(np.maximum(np.divide(errors, limit), 1)).sum())

        n_rings = 1 + parts(self.segments)
        n_azimuths = (2 - self.isotropic) * float(len(self.first_azimuths))
        if self.gaps.errors:
            n_azimuths = parts(self.gaps) / (len(self.segments.levels()) - 1)
        return n_rings * n_azimuths

    def split_at(self, missed: Iterable[PredictionError]) -> bool:
        """Split what holds the directions that were missed; whether anything was.

        Each segment or gap once, for the worst of them.
        """
        before = len(self.segments.errors), len(self.gaps.errors)
        worst = sorted(missed, key=lambda one: one.error, reverse=True)
        done: set[Interval] = set()
        for one, (segment, gaps) in [(one, self._around(one)) for one in worst]:
            if done & {segment, *gaps}:
                continue
            of_gaps = max((self.gaps.errors[gap] or 0.0 for gap in gaps), default=0.0)
            by_angle = (self.segments.errors[segment] or 0.0) >= of_gaps
            for split_segment in (by_angle, not by_angle):
                split = self._split_segment if split_segment else self.gaps.split
                here = [segment] if split_segment else gaps
                # all of them, also after the first that can be
                if {split(each, one.error) for each in here} - {None}:
                    done |= set(here)
                    break
        return before != (len(self.segments.errors), len(self.gaps.errors))

    def _around(self, one: PredictionError) -> tuple[Interval, list[Interval]]:
        """Segment that holds a direction, and the gaps of azimuth on both its ends."""
        segment = self.segments.around(one.theta_i)
        symmetry = self.symmetry
        sector = symmetry.home(one.phi_i * symmetry.n_sectors / 360)
        sector = min(max(sector, symmetry.domain[0]), symmetry.domain[1])
        rings = [
            theta for theta in (segment.low, segment.high) if self.gaps.levels(theta)
        ]
        return segment, [self.gaps.around(sector, theta) for theta in rings]

    def _split_segment(self, segment: Interval, error: float) -> float | None:
        """Split a segment; its new ring has the azimuths of both its neighbours."""
        middle = self.segments.split(segment, error)
        levels = {
            s for end in (segment.low, segment.high) for s in self.gaps.levels(end)
        }
        if middle is not None and levels:
            for gap in _intervals(sorted(levels), middle):
                self.gaps.errors[gap] = max(
                    self.gaps.errors[self.gaps.around((gap.low + gap.high) / 2, end)]
                    or 0.0
                    for end in (segment.low, segment.high)
                    if self.gaps.levels(end)
                )
        return middle

    def _first_sectors(self) -> list[float]:
        """Initial azimuths in sectors, and the upper end of their range.

        Of an isotropic specimen one azimuth, and no end.
        """
        if self.isotropic:
            return [0.0]
        return self.symmetry.spread(self.n_azimuths)

    def _own(self, levels: list[float]) -> list[float]:
        """Azimuths without the last one where it is the first one's image."""
        of_all = self.isotropic or self.symmetry.mirror is not None
        return levels if of_all else levels[:-1]


def _intervals(levels: Sequence[float], on: float = 0.0) -> list[Interval]:
    """Intervals between ascending levels."""
    return [Interval(low, high, on) for low, high in itertools.pairwise(levels)]


def _middle_angle(segment: Interval) -> float | None:
    """Middle of a segment in degrees; None for one that is narrow enough."""
    if segment.high - segment.low < 2 * MIN_SEGMENT_WIDTH:
        return None
    return (segment.low + segment.high) / 2


def _middle_sector(gap: Interval) -> float | None:
    """Sector in the middle of a gap; None if there is none."""
    return float((gap.low + gap.high) // 2) if gap.high - gap.low >= 2 else None

"""Where a campaign measures next: intervals of directions, split or settled."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

__all__ = ["Axis", "Interval", "refined"]


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
        low, high = Interval(self.low, middle, self.on), self.high
        return low, Interval(middle, high, self.on)


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
    errors_at: Callable[[Sequence[Interval], Iterable[float]], Sequence[float]],
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

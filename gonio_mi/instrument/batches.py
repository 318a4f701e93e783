"""Sending batches of rays: a given number, or until the record is precise enough."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..results.ray_density import paper_rays, precision
from ..results.record import Record
from ..results.tally import Tally
from ..settings.measurement_settings import PILOT_RAYS, MeasurementSettings
from ..transport.bench import Bench
from .instrument import Instrument

__all__ = ["Target", "n_batches", "send", "send_until"]


# The paper's error tolerance and confidence (section 5.2).
PAPER_EPSILON, PAPER_DELTA = 0.005, 0.01


def n_batches(tallies: Sequence[Tally]) -> int:
    """Batches of all `tallies`."""
    return sum(tally.n_batches for tally in tallies)


def send(
    instrument: Instrument,
    bench: Bench,
    key: tuple[int, ...],
    plan: Sequence[int],
    tallies: list[Tally],
    report: Callable[[float], Any] | None,
) -> None:
    """Append the tallies of the batches of `plan` that are still missing."""
    first = n_batches(tallies)
    for tally in instrument.tallies(bench, key, plan[first:], first, progress=report):
        tallies.append(tally)


def send_until(
    target: Target,
    instrument: Instrument,
    bench: Bench,
    key: tuple[int, ...],
    tallies: list[Tally],
    report: Callable[[float], Any] | None,
) -> None:
    """Let all batches grow by rounds until `target` is met; one tally in the end.

    The number of batches is fixed, so that what decides about stopping has the same
    degrees of freedom at every look; rounds grow to what the last look predicts, so
    that there are few looks.
    """
    batches = instrument.settings.batches
    each, goal = 0, PILOT_RAYS // batches  # rays of every batch
    while each < goal:
        sizes = [goal - each] * batches
        sent = instrument.tallies(bench, key, sizes, start=each, progress=report)
        grown = Tally.join(list(sent))
        tallies[:] = [tallies[0].accumulate(grown) if tallies else grown]
        each = goal
        record = instrument.record(bench, tallies[0], key[0])
        goal = target.next_goal(record, each * batches) // batches


@dataclass(frozen=True)
class Target:
    """Precision at which to stop."""

    rel_err: float
    max_rays: int
    floor: float

    @classmethod
    def of(cls, settings: MeasurementSettings) -> Target | None:
        """Target of the settings; None where a number of rays, or an integral, is."""
        if settings.rel_err is None or settings.estimator == "quadrature":
            return None
        return cls(settings.rel_err, settings.max_rays, settings.floor)

    def next_goal(self, record: Record, sent: int) -> int:
        """Rays in all that the record predicts; `sent` if it is good enough."""
        worst, _ = precision(record, self.floor)
        if worst <= self.rel_err:
            return sent
        # the error of the worst patch falls as 1 / sqrt(rays), or faster; a tenth more
        # keeps the looks few. What is not known yet asks for as many rays again.
        growth = 1.1 * (worst / self.rel_err) ** 2 if np.isfinite(worst) else 2.0
        return min(int(sent * min(max(growth, 1.25), 16.0)), self.max_rays)

    def reached(self, record: Record) -> dict[str, Any]:
        """What the record's settings say of the target, for the worst direction."""
        looks = [precision(record[i], self.floor) for i in range(len(record))]
        n_lobe = max(n for _, n in looks)
        n_patches = record.subdivision.n_patches * (1 + record.has_lower)
        return {
            "rel_err": self.rel_err,
            "reached": max(worst for worst, _ in looks),
            "floor": self.floor,
            "n_lobe": n_lobe,
            "paper_rays": paper_rays(n_patches, PAPER_EPSILON, PAPER_DELTA),
        }

"""Sending batches of rays: a given number, or until the record is precise enough."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ..results.misplacement import noise_of
from ..results.precision import precision
from ..results.ray_bounds import paper_rays
from ..results.record import Record
from ..results.tally import Fate, Tally
from ..settings.measurement_settings import PILOT_RAYS, MeasurementSettings
from ..transport.bench import Bench
from .instrument import Instrument

__all__ = ["Target", "rays_sent", "rounds", "send", "send_until"]


# The paper's error tolerance and confidence (section 5.2).
PAPER_EPSILON, PAPER_DELTA = 0.005, 0.01

# By which power of the error the rays grow, and how much at once, of `rel_err` and of
# `noise`. The error of the worst patch falls as 1 / sqrt(rays), or faster: looking
# again at twice the rays saves up to a third of them. Noise is a sum of all patches,
# which is known well, and falls as rays**-0.63 where a groove is traced.
CONVERGENCE = {False: (2.0, 2.0), True: (1.6, 4.0)}


def rays_sent(tallies: Sequence[Tally], passes: int) -> list[int]:
    """Rays of each batch of `tallies`, which sent them `passes` times."""
    counts = [tally.fates[:, : len(Fate)].sum(axis=1) // passes for tally in tallies]
    return [int(rays) for some in counts for rays in some]


def rounds(plan: Sequence[int], step: int, start: int = 0) -> list[list[int]]:
    """Rays that each batch has sent after each round; `plan` after the last.

    What whole rounds have sent is what Ctrl-C keeps. A round adds `step` rays to each
    batch, or up to an eighth of what was sent before it, and ends at a multiple of a
    power of two, where points of low discrepancy are even. The sums are rounded after
    each, so that rounds depend on numbers of rays and on nothing else.

    Parameters
    ----------
    plan : sequence of int
        Rays of each batch, in descending order and alike within one ray.
    step : int
        A power of two.
    start : int
        Rays of each batch that were sent before.
    """
    ends = []
    each = _next_end(start, step)
    while each + step // 2 < plan[-1]:  # else the last one would be much shorter
        ends.append([each] * len(plan))
        each = _next_end(each, step)
    return [*ends, list(plan)]


def _next_end(each: int, step: int) -> int:
    """Rays that each batch has sent after one more round."""
    step = max(step, 1 << each.bit_length() >> 4)
    return (each // step + 1) * step


def send(
    instrument: Instrument,
    bench: Bench,
    key: tuple[int, ...],
    plan: Sequence[int],
    tallies: list[Tally],
    report: Callable[[float], Any] | None,
) -> None:
    """Let all batches grow by rounds to `plan`, from what `tallies` hold of them.

    Whenever it is interrupted, `tallies` hold all batches after a whole round; or in
    the first round those that have finished it.
    """
    sent, step = rays_sent(tallies, instrument.passes), instrument.round_rays(bench)
    start = sent[-1] if sent else 0
    more = partial(instrument.tallies, bench, key, progress=report)
    if 0 < len(sent) < len(plan):
        level = [min(size, sent[0]) for size in plan]
        ends, start = rounds(level, step), level[-1]
        others = [] if len(ends) > 1 else tallies
        _grow(more, ends, 0, len(sent), others)
        if others is not tallies:
            tallies.extend(others)
    if start < plan[-1]:
        _grow(more, rounds(plan, step, start), start, 0, tallies)


def _grow(
    more: Callable[..., Iterable[Tally]],
    ends: Sequence[Sequence[int]],
    start: int,
    first: int,
    tallies: list[Tally],
) -> None:
    """Let the batches from number `first` on grow from `start` rays to each of `ends`.

    Those of the first rays are appended to `tallies` one by one; what is sent after
    that is added to them in whole rounds.
    """
    for end in ends:
        grown = more([size - start for size in end[first:]], first, start)
        if start == 0:
            for tally in grown:
                tallies.append(tally)
        else:
            whole = Tally.join(list(grown))
            tallies[:] = [Tally.join(tallies).accumulate(whole)]
        start = end[-1]


def send_until(
    target: Target,
    instrument: Instrument,
    bench: Bench,
    key: tuple[int, ...],
    tallies: list[Tally],
    report: Callable[[float], Any] | None,
) -> None:
    """Let all batches grow until `target` is met; one tally in the end.

    The number of batches is fixed, so that what decides about stopping has the same
    degrees of freedom at every look; they grow to about what the last look predicts.
    """
    batches = instrument.settings.batches
    most = instrument.settings.max_rays // batches
    # rays of every batch, at first two or more
    each, goal = 0, max(PILOT_RAYS // (batches * instrument.points), 2)
    while each < goal:
        each = goal
        send(instrument, bench, key, [each] * batches, tallies, report)
        tallies[:] = [Tally.join(tallies)]
        record = instrument.record(bench, tallies[0], key[0])
        goal = target.next_goal(record, each * batches) // batches
        if goal > each:
            goal = _even(goal, most)


def _even(rays: int, most: int) -> int:
    """So many rays or up to an eighth more, where points of low discrepancy are even.

    From there on few launches along a curve are enough, which take aligned blocks.
    """
    step = max(1 << rays.bit_length() >> 4, 1)
    return min(-(-rays // step) * step, most)


@dataclass(frozen=True)
class Target:
    """Precision at which to stop.

    Attributes
    ----------
    goal : float
    of_noise : bool
        Whether it is one of `noise`; else of `rel_err`.
    max_rays : int
    floor : float
    """

    goal: float
    of_noise: bool
    max_rays: int
    floor: float

    @classmethod
    def of(cls, settings: MeasurementSettings) -> Target | None:
        """Target of the settings; None where a number of rays, or an integral, is."""
        goal = settings.noise or settings.rel_err
        if goal is None or settings.estimator == "quadrature":
            return None
        of_noise = settings.noise is not None
        return cls(goal, of_noise, settings.max_rays, settings.floor)

    @property
    def name(self) -> str:
        """Setting that it comes from."""
        return "noise" if self.of_noise else "rel_err"

    def found(self, record: Record) -> float:
        """How precise a record of one incident direction is."""
        return noise_of(record) if self.of_noise else precision(record, self.floor)[0]

    def next_goal(self, record: Record, sent: int) -> int:
        """Rays in all that the record predicts; `sent` if it is good enough."""
        worst = self.found(record)
        if worst <= self.goal:
            return sent
        # what is not known yet asks for as many rays again
        ratio = worst / self.goal if np.isfinite(worst) else 2.0**0.5
        power, most = CONVERGENCE[self.of_noise]
        growth = min(max(ratio**power, 1.25), most)
        return min(int(sent * growth), self.max_rays)

    def reached(self, record: Record) -> dict[str, Any]:
        """What the record's settings say of the target, for the worst direction."""
        if self.of_noise:
            reached = max(noise_of(record[i]) for i in range(len(record)))
            return {"noise": self.goal, "reached": reached}
        looks = [precision(record[i], self.floor) for i in range(len(record))]
        n_lobe = max(n for _, n in looks)
        n_patches = record.subdivision.n_patches * (1 + record.has_lower)
        return {
            "rel_err": self.goal,
            "reached": max(worst for worst, _ in looks),
            "floor": self.floor,
            "n_lobe": n_lobe,
            "paper_rays": paper_rays(n_patches, PAPER_EPSILON, PAPER_DELTA),
        }

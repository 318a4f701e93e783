"""Rounds of batches, up to a number of rays or to a precision: the stopping rule."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..results.planning import paper_rays, precision
from ..results.prediction_error import expected_noise
from ..results.record import Record
from ..results.tally import Fate, Tally, batch_sizes
from ..settings.measurement_settings import PILOT_RAYS, MeasurementSettings

# The paper's error tolerance and confidence (section 5.2).
PAPER_EPSILON, PAPER_DELTA = 0.005, 0.01

# By which power of the error the rays grow, and how much at once, of `precision` and
# of `noise`. The error of the worst patch falls as 1 / sqrt(rays), or faster: looking
# again at twice the rays saves up to a third of them. Noise is a sum of all patches,
# which is known well, and falls as rays**-0.63 where a groove is traced.
CONVERGENCE = {False: (2.0, 2.0), True: (1.6, 4.0)}


@dataclass(frozen=True)
class Round:
    """Rays that some batches send next.

    Attributes
    ----------
    sizes : tuple of int
        Of each batch, in descending order and alike within one ray; as often again for
        each further four wavelengths.
    first : int
        Number of the first of these batches.
    start : int
        Rays of each of them that were sent before.
    """

    sizes: tuple[int, ...]
    first: int = 0
    start: int = 0


def schedule(
    settings: MeasurementSettings,
    step: int,
    passes: int,
    tallies: list[Tally],
    look: Callable[[Tally], Record],
) -> Iterator[Round]:
    """Rounds that lead to what is asked for, from what `tallies` hold.

    Parameters
    ----------
    settings : MeasurementSettings
    step : int
        Rays of each batch in the first rounds; see :func:`rounds`.
    passes : int
        How often the rays are sent.
    tallies : list of Tally
        To which the caller adds each round, before the next one.
    look : callable
        Record of a tally, by whose precision is decided whether to go on.
    """
    for plan in _plans(settings, tallies, look):
        sent = rays_sent(tallies, passes)
        start = sent[-1] if sent else 0
        if 0 < len(sent) < len(plan):  # the first round was interrupted
            sizes = [min(size, sent[0]) for size in plan]
            start = sizes[-1]
            yield Round(tuple(sizes[len(sent) :]), len(sent))
        for end in rounds(plan, step, start) if start < plan[-1] else []:
            yield Round(tuple(size - start for size in end), start=start)
            start = end[-1]


def _plans(
    settings: MeasurementSettings, tallies: list[Tally], look: Callable[[Tally], Record]
) -> Iterator[list[int]]:
    """Rays of each batch in the end, or until the next look at the precision.

    The number of batches is fixed, so that what decides about stopping has the same
    degrees of freedom at every look; they grow to about what the last look predicts.
    """
    target, batches = Target.of(settings), settings.batches
    if target is None:
        yield batch_sizes(settings.rays, batches)
        return
    # rays of every batch, at first two or more
    each, goal = 0, max(PILOT_RAYS // (batches * settings.n_looks), 2)
    while each < goal:
        each = goal
        yield [each] * batches
        tallies[:] = [Tally.join(tallies)]
        goal = target.next_goal(look(tallies[0]), each * batches) // batches
        if goal > each:
            # up to an eighth more, which completes a low-discrepancy set: from there
            # on a few launches along a curve are enough
            step = max(1 << goal.bit_length() >> 4, 1)
            goal = min(-(-goal // step) * step, settings.max_rays // batches)


def rays_sent(tallies: Sequence[Tally], passes: int) -> list[int]:
    """Rays of each batch of `tallies`, which sent them `passes` times."""
    fates = [tally.fates[:, : Fate.OVER_THE_EDGE] for tally in tallies]
    counts = [each.sum(axis=1) // passes for each in fates]
    return [int(rays) for some in counts for rays in some]


def rounds(plan: Sequence[int], step: int, start: int = 0) -> list[list[int]]:
    """Rays that each batch has sent after each round; `plan` after the last.

    What whole rounds have sent is what Ctrl-C keeps. A round adds `step` rays to each
    batch, or up to an eighth of what was sent before it, and ends at a multiple of a
    power of two, which completes a low-discrepancy set. The sums are rounded after
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


@dataclass(frozen=True)
class Target:
    """Precision at which to stop.

    Attributes
    ----------
    goal : float
    of_noise : bool
        Whether it is one of `noise`; else of `precision`.
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
        goal = settings.noise or settings.precision
        if goal is None:
            return None
        return cls(goal, settings.noise is not None, settings.max_rays, settings.floor)

    @property
    def name(self) -> str:
        """Setting that it comes from."""
        return "noise" if self.of_noise else "rel_err"

    def precision_of(self, record: Record) -> float:
        """How precise a record of one incident direction is."""
        return (
            expected_noise(record)
            if self.of_noise
            else precision(record, self.floor)[0]
        )

    def next_goal(self, record: Record, sent: int) -> int:
        """Rays in all that the record predicts; `sent` if it is good enough."""
        worst = self.precision_of(record)
        if worst <= self.goal:
            return sent
        # what is not known yet asks for as many rays again
        ratio = worst / self.goal if np.isfinite(worst) else 2.0**0.5
        power, most = CONVERGENCE[self.of_noise]
        growth = min(max(ratio**power, 1.25), most)
        return min(int(sent * growth), self.max_rays)

    def reached(self, record: Record) -> dict[str, Any]:
        """What the record's provenance says of the target, for the worst direction."""
        if self.of_noise:
            return {"reached": max(map(expected_noise, record))}
        looks = [precision(one, self.floor) for one in record]
        n_lobe = max(n for _, n in looks)
        n_patches = record.subdivision.n_patches * record.n_hemispheres
        return {
            "reached": max(worst for worst, _ in looks),
            "n_lobe": n_lobe,
            "paper_rays": paper_rays(n_patches, PAPER_EPSILON, PAPER_DELTA),
        }

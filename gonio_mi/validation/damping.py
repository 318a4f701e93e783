"""Heavy weights are damped, so that a sum of them can be judged whatever their tails.

A weight may be far above the mean, up to an infinite variance: then the sum of a finite
number of samples is nearly always too small, and so is its standard error. So each
weight W of a direction is multiplied by min(1, c / r), where r is ``eval`` over ``pdf``
there. Whatever the number c, the mean of that is known: the integral of
min(``eval``, c ``pdf``), a bounded function. As c we take the largest for which a
sum is as good as normal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..array_types import Floats, Integers, Numbers

__all__ = ["SMALL", "Damping"]

# A sum of independent terms is as good as normal if none is more than a tenth of its
# standard deviation: its skewness is less than that, and the error of the normal law
# (Esseen 1956) less than 0.05, which the skewness explains nearly all of. This is the
# square of 1/10: c^2 = SMALL n m2(c), with m2 the mean square of a damped weight.
SMALL = 0.01

# Hits that a group of patches must have: four times as many as equal weights need.
ENOUGH_HITS = 4 / SMALL


class Ratios(Protocol):
    """What of samples damps them: their patches, and ``eval`` over ``pdf``."""

    index: Integers
    ratio: Floats


@dataclass(frozen=True)
class Damping:
    """Groups of consecutive patches, and the limit of their weights.

    Attributes
    ----------
    first : ndarray of int, shape (n_groups,)
        First patch of each group.
    limits : ndarray, shape (2 n_patches + 1,)
        Of each patch; the last is that of samples in no patch, infinite.
    """

    first: Integers
    limits: Floats

    @staticmethod
    def of(pilot: Ratios, n_patches: int, n: int) -> Damping:
        """Damping of `n` samples, from a pilot :class:`Samples` of fewer."""
        n_pilot = len(pilot.index)
        inside = pilot.index < n_patches
        index, ratio = pilot.index[inside], pilot.ratio[inside]
        hits = np.bincount(index, minlength=n_patches) * (n / n_pilot)
        first = groups(hits, ENOUGH_HITS)
        starts = first if first.size else np.zeros(1, int)
        group = np.searchsorted(starts, np.arange(n_patches), side="right") - 1
        limits = _limits(ratio, group[index], len(starts), SMALL * n / n_pilot)
        return Damping(first, np.append(limits[group], np.inf))

    def factors(self, drawn: Ratios) -> Floats:
        """Factor of each weight of :class:`Samples`."""
        limit = self.limits[drawn.index]
        heavy = drawn.ratio > limit
        return np.divide(limit, drawn.ratio, out=np.ones(len(limit)), where=heavy)


def _limits(ratio: Floats, group: Integers, n_groups: int, share: float) -> Floats:
    """Limit c of each group: ``share * sum(min(ratio / c, 1)^2) = 1``."""
    usable = np.isfinite(ratio) & (ratio > 0)
    low, high = np.full(n_groups, np.inf), np.zeros(n_groups)
    np.minimum.at(low, group[usable], ratio[usable])
    np.maximum.at(high, group[usable], ratio[usable])
    lit = high > 0
    low, high = np.where(lit, low, 1.0), np.where(lit, high, 1.0)
    high = high * np.sqrt(max(1.0, share * len(ratio)))
    for _ in range(60):
        middle = np.sqrt(low * high)
        squares = np.minimum(ratio / middle[group], 1) ** 2
        above = share * np.bincount(group, squares, minlength=n_groups) > 1
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return np.where(lit, low, 0.0)


def groups(hits: Numbers, enough: float) -> Integers:
    """First patch of each group of consecutive patches with enough hits."""
    starts, total = [], enough
    for i, own in enumerate(hits.tolist()):
        if total >= enough:
            starts.append(i)
            total = 0.0
        total += own
    if total < enough:
        starts.pop()
    return np.array(starts, dtype=int)

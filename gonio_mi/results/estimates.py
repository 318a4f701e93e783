"""Estimates from a tally: flux fractions, their standard errors and intervals."""

from dataclasses import dataclass
from typing import cast

import numpy as np

from ..array_types import Counts, Floats, Numbers
from . import statistics
from .tally import Tally

__all__ = ["Estimates"]

# Below this many hits the sum of a patch is too skewed for Student's t.
FEW_HITS = 100
# The same for rays of a low-discrepancy sequence, whose counts scatter less.
FEW_EVEN_HITS = 30
# Deposits of one patch below which the few large ones among them may be missing.
FEW_DEPOSITS = 300


@dataclass(frozen=True, eq=False)
class Estimates:
    """What the tally of one incident direction says of each hemisphere.

    Hemisphere 0 is the emitter's side. Values of its patches have the shape ``(n_theta,
    n_phi, channels)``, those of its total ``(channels,)``.

    Attributes
    ----------
    tally : Tally
    independent : bool
        Whether its rays are independent; else of a low-discrepancy sequence.
    deposited : bool
        Whether its hits are deposits: several from one ray, or none.
    passes : int
        How often each ray was sent, for more wavelengths than one carries.
    """

    tally: Tally
    independent: bool
    deposited: bool = False
    passes: int = 1

    @property
    def hits(self) -> Counts:
        """Hits per patch of one pass, shape ``(n_hemispheres, n_theta, n_phi)``."""
        return self.tally.hits // np.uint64(self.passes)

    @property
    def rays(self) -> int:
        """Rays of one pass that met the specimen."""
        return self._all_rays // self.passes

    @property
    def binomial(self) -> bool:
        """Whether each patch counted independent rays of one channel, one by one."""
        tally = self.tally
        return (
            self.independent
            and tally.errors is None
            and tally.scale == 1
            and tally.channels == 1
            and np.array_equal(tally.sums[..., 0].sum(axis=0), tally.hits)
            and tally.incident.sum() == self._all_rays
        )

    def fraction(self, hemisphere: int) -> Floats:
        """Flux fraction of each patch."""
        return statistics.ratio(self.tally.sums[:, hemisphere], self._incident)

    def std_err(self, hemisphere: int) -> Floats:
        """Standard error of :meth:`fraction`; NaN where there was no hit."""
        sums = self.tally.sums[:, hemisphere]
        if self.tally.errors is not None:
            return np.hypot(self._scatter(sums), self._error(hemisphere))
        hits = self.tally.hits[hemisphere][..., None]
        if self.binomial:
            return statistics.binomial_std_err(hits, self._all_rays)
        std_err = statistics.batch_std_err(sums, self._incident)
        return np.where(hits > 0, std_err, np.nan)

    def total(self, hemisphere: int) -> Floats:
        """Flux fraction of all patches together."""
        return statistics.ratio(self._sum(hemisphere), self.tally.incident)

    def total_std_err(self, hemisphere: int) -> Floats:
        """Standard error of :meth:`total`."""
        sums = self._sum(hemisphere)
        if self.tally.errors is None:
            return statistics.batch_std_err(sums, self.tally.incident)
        return np.hypot(self._scatter(sums), self._error(hemisphere).sum(axis=(0, 1)))

    def interval(self, hemisphere: int, level: float) -> tuple[Floats, Floats]:
        """Limits of :meth:`fraction`, ``(low, high)``; see :meth:`Record.interval`."""
        fraction = self.fraction(hemisphere)
        if self.tally.errors is not None:
            sums, error = self.tally.sums[:, hemisphere], self._error(hemisphere)
            return self._integral_interval(fraction, sums, error, level)
        hits = self.hits[hemisphere][..., None]
        if self.binomial:
            return statistics.binomial_interval(hits, self.rays, level)
        with np.errstate(invalid="ignore"):
            weight = fraction * self.rays / hits
        std_err = self.std_err(hemisphere)
        largest = np.nanmax(weight, initial=1.0)
        low, high = self._student(fraction, std_err, weight, hits, level)
        unlike = self._unlike_interval(fraction, std_err, weight, largest, level)
        if self.deposited:
            few = (hits < FEW_DEPOSITS) & (hits > 0)
        else:
            few = hits < (FEW_HITS if self.independent else FEW_EVEN_HITS)
            few &= hits > 0
            alike = statistics.binomial_interval(hits, self.rays, level)
            low, high = (
                np.where(few, limit * weight, student)
                for limit, student in zip(alike, (low, high))
            )
            few &= self.tally.scale > 1  # what is counted weighs 1
        low = np.where(few, np.fmin(low, unlike[0]), low)
        high = np.where(few, np.fmax(high, unlike[1]), high)
        most = statistics.upper_limit(self.rays, level) * largest
        return np.where(hits == 0, 0.0, low), np.where(hits == 0, most, high)

    def total_interval(self, hemisphere: int, level: float) -> tuple[Floats, Floats]:
        """Limits of :meth:`total`, ``(low, high)``; see :meth:`Record.interval`."""
        value = self.total(hemisphere)
        if self.tally.errors is not None:
            error = self._error(hemisphere).sum(axis=(0, 1))
            return self._integral_interval(value, self._sum(hemisphere), error, level)
        hits = self.tally.hits[hemisphere].sum() // self.passes
        return self._sampled_interval(
            value, self.total_std_err(hemisphere), hits, level
        )

    @property
    def direct(self) -> Floats:
        """Flux fraction that passed a periodic specimen without any event."""
        return statistics.ratio(self.tally.direct, self.tally.incident)

    @property
    def direct_std_err(self) -> Floats:
        """Standard error of `direct`."""
        return statistics.batch_std_err(self.tally.direct, self.tally.incident)

    def direct_interval(self, level: float) -> tuple[Floats, Floats]:
        """Limits of `direct`, ``(low, high)``; see :meth:`Record.interval`."""
        hits = self.tally.ledger.direct // self.passes
        return self._sampled_interval(self.direct, self.direct_std_err, hits, level)

    def _sampled_interval(
        self, value: Floats, std_err: Floats, hits: int, level: float
    ) -> tuple[Floats, Floats]:
        """Interval of a sum over many patches, of so many hits in all."""
        if self.binomial or hits == 0:
            of_each = np.broadcast_to(hits, value.shape)
            return statistics.binomial_interval(of_each, self.rays, level)
        weight = value * self.rays / hits
        return self._student(value, std_err, weight, hits, level)

    def _unlike_interval(
        self,
        fraction: Floats,
        std_err: Floats,
        weight: Floats,
        largest: float,
        level: float,
    ) -> tuple[Floats, Floats]:
        """Interval of a sum of few weights unlike each other; NaN where it is dark.

        One more may have been missed by chance: of deposits, the `largest` of all; of
        rays, one that weighs the mean of those in the patch, each counted by what it
        weighs, for the scatter of few hits is the sum of their squared weights.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.deposited:
                missed: Floats | float = largest / self.rays
            else:
                missed = np.fmax(weight / self.rays, std_err**2 / fraction)
            return statistics.gamma_interval(fraction, std_err, missed, level)

    def _student(
        self,
        value: Floats,
        std_err: Floats,
        weight: Floats,
        hits: Counts | int,
        level: float,
    ) -> tuple[Floats, Floats]:
        """Interval by Student's t, which leaves open what too few rays show.

        So many rays as would leave an empty patch empty may be of another kind, of
        which none was seen (Hanley and Lippman-Hand 1983, JAMA 249, 1743): rays that
        are lost, or received as well; and where all were received, which hits of unit
        weight at most can exceed, rays of that weight.
        """
        unseen = statistics.upper_limit(self.rays, level)
        more = (hits < self.rays) | self.deposited
        above = np.where(more, weight, np.maximum(1 - weight, 0))
        return statistics.student_interval(
            value,
            std_err,
            self.tally.n_batches,
            level,
            below=unseen * weight,
            above=unseen * above,
        )

    def _integral_interval(
        self, value: Floats, sums: Numbers, error: Floats, level: float
    ) -> tuple[Floats, Floats]:
        """Interval of integrals that may be wrong by `error`, and sampled `sums`."""
        low, high = statistics.student_interval(
            value, self._scatter(sums), self.tally.n_batches, level
        )
        return low - error, high + error

    @property
    def _incident(self) -> Numbers:
        """Incident flux per batch, broadcastable to the sums of one hemisphere."""
        return self.tally.incident[:, None, None, :]

    @property
    def _all_rays(self) -> int:
        """Rays of all passes that met the specimen."""
        ledger = self.tally.ledger
        return ledger.emitted - ledger.missed - ledger.unlit

    def _sum(self, hemisphere: int) -> Numbers:
        """Sum over the patches of one hemisphere, per batch and channel."""
        return self.tally.sums[:, hemisphere].sum(axis=(1, 2))

    def _error(self, hemisphere: int) -> Floats:
        """What the integrals of a hemisphere's flux fractions may be wrong by."""
        errors = cast(Floats, self.tally.errors)  # asked for of integrals only
        return errors[hemisphere] / self.tally.incident.max(axis=0)

    def _scatter(self, sums: Numbers) -> Floats:
        """Standard error of the sampled part of `sums`; 0 if nothing was sent."""
        if not self.tally.ledger.emitted:
            return np.zeros(sums.shape[1:])
        shape = -1, *[1] * (sums.ndim - 2), self.tally.channels
        return statistics.batch_std_err(sums, self.tally.incident.reshape(shape))

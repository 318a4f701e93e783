"""Estimates of flux fractions, with standard errors and intervals, by their kind."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Counts, Flags, Floats, Numbers
from ..settings.measurement_settings import BRANCHES
from ..single_precision import ROUNDING
from . import statistics
from .tally import Integrals, Tally

# Below this many hits the sum of a patch is too skewed for Student's t.
MIN_HITS = 100
# The same for rays of a low-discrepancy sequence, whose counts scatter less.
MIN_EVEN_HITS = 30
# Deposits of one patch below which the few large ones among them may be missing.
MIN_DEPOSITS = 300

# Scatter of deposits, in units of that of as many independent ones all alike, above
# which Student's t is not enough. Measured with a point in each patch: in the median
# 0.3 on diffuse facets, 2.5 on glossy ones, where it held 81 to 92 % and not 95.
MAX_EVEN_SCATTER = 0.5
# Part of the patches, above which that holds for all. On grooves of rough conductors
# 0.8 to 0.96 are so (alpha 0.05 to 0.2), of rough plastic up to 0.55, diffuse 0.34.
MAX_UNEVEN_PATCHES = 0.75

# How much heavier than the hits of a patch those must be that make all patches scatter,
# so that the patch is judged by them. Up to that, its own hits tell enough of it.
MIN_WEIGHT_RATIO = 2.0


@dataclass(frozen=True, eq=False)
class Estimates(ABC):
    """What is known of one incident direction, and how well.

    Hemisphere 0 is the emitter's side. Values of its patches have the shape ``(n_theta,
    n_phi, channels)``, those of its total ``(channels,)``. Limits are ``(low, high)``,
    as :meth:`Record.interval` describes them.

    Attributes
    ----------
    tally : Tally
    passes : int
        How often each ray was sent, for more wavelengths than one carries.
    """

    tally: Tally
    passes: int = field(default=1, kw_only=True)

    @property
    def hits(self) -> Counts:
        """Hits per patch of one pass, shape ``(n_hemispheres, n_theta, n_phi)``.

        Rounded up: a patch that one pass alone hits was hit.
        """
        return -(-self.tally.hits.astype(np.int64) // self.passes).astype(np.uint64)

    @property
    def rays(self) -> int:
        """Rays of one pass that met the specimen."""
        return self._all_rays // self.passes

    @property
    def n_batches(self) -> int | Floats:
        """Batches by whose scatter Student's t goes."""
        return self.tally.n_batches

    @property
    def without_hit(self) -> Flags:
        """Whether a patch is known by an upper limit only, shaped like `hits`."""
        return np.zeros(self.tally.hits.shape, bool)

    def dark(self, hemisphere: int) -> Flags:
        """Whether a value is known by an upper limit only, shaped like `fraction`.

        Of several channels, one may be dark in a patch where others were received.
        """
        return self._nowhere(hemisphere)

    def pooled(self, hemisphere: int) -> Flags:
        """Whether a patch's own hits show too little of its scatter, like `fraction`.

        It is then judged by the hits of all patches of the hemisphere as well.
        """
        return self._nowhere(hemisphere)

    @property
    def binomial(self) -> bool:
        """Whether each patch counted independent rays of one channel, one by one."""
        return False

    def fraction(self, hemisphere: int) -> Floats:
        """Flux fraction of each patch."""
        return statistics.ratio(self.tally.sums[:, hemisphere], self._incident)

    @abstractmethod
    def std_err(self, hemisphere: int) -> Floats:
        """Standard error of :meth:`fraction`; NaN where it is not known."""

    def noise(self, hemisphere: int) -> Floats:
        """Standard error that is right on average, though not in every patch."""
        return self.std_err(hemisphere)

    @abstractmethod
    def interval(self, hemisphere: int, level: float) -> tuple[Floats, Floats]:
        """Limits of :meth:`fraction`."""

    def total(self, hemisphere: int) -> Floats:
        """Flux fraction of all patches together."""
        return statistics.ratio(self._sum(hemisphere), self.tally.incident)

    @abstractmethod
    def total_std_err(self, hemisphere: int) -> Floats:
        """Standard error of :meth:`total`."""

    @abstractmethod
    def total_interval(self, hemisphere: int, level: float) -> tuple[Floats, Floats]:
        """Limits of :meth:`total`."""

    @property
    def direct(self) -> Floats:
        """Flux fraction that passed a periodic specimen without any event."""
        return statistics.ratio(self.tally.direct, self.tally.incident)

    @property
    @abstractmethod
    def direct_std_err(self) -> Floats:
        """Standard error of `direct`."""

    @abstractmethod
    def direct_interval(self, level: float) -> tuple[Floats, Floats]:
        """Limits of `direct`."""

    @property
    def _incident(self) -> Numbers:
        """Incident flux per batch, broadcastable to the sums of one hemisphere."""
        return self.tally.incident[:, None, None, :]

    @property
    def _all_rays(self) -> int:
        """Rays of all passes that met the specimen."""
        ledger = self.tally.ledger
        return ledger.emitted - ledger.missed - ledger.unlit

    def _nowhere(self, hemisphere: int) -> Flags:
        return np.zeros(self.tally.sums[0, hemisphere].shape, bool)

    def _sum(self, hemisphere: int) -> Numbers:
        """Sum over the patches of one hemisphere, per batch and channel."""
        return self.tally.sums[:, hemisphere].sum(axis=(1, 2))


class Regime(IntEnum):
    """How much is known of a patch's scatter: whether its hits are few, or heavy rare.

    ``MANY`` hits have limits by Student's t, ``FEW`` those of their count, and in both
    cases at least those of unlike weights where heavy hits are ``RARE`` or few hits
    weigh unlike; nothing was received in the ``DARK``, which has an upper limit.
    """

    MANY = 0
    RARE = 1
    FEW = 2
    FEW_AND_RARE = 3
    DARK = 4


@dataclass(frozen=True, eq=False)
class SampledEstimates(Estimates):
    """Estimates from rays alone: counts, or weights that scatter between batches.

    Attributes
    ----------
    independent : bool
        Whether the rays are independent; else of a low-discrepancy sequence.
    deposited : bool
        Whether hits are deposits: several from one ray, or none.
    """

    independent: bool
    deposited: bool = False

    @property
    def without_hit(self) -> Flags:
        """Whether no ray came."""
        return self.tally.hits == 0

    def dark(self, hemisphere: int) -> Flags:
        """Whether no ray carried anything."""
        return np.max(self.tally.sums[:, hemisphere], axis=0, initial=0) == 0

    @property
    def unlike_power(self) -> bool:
        """Whether rays carry unlike power, and batches unlike parts of it."""
        return bool(np.any(self.tally.incident % self.tally.scale))

    @property
    def n_batches(self) -> int | Floats:
        """Batches; of unlike power as many as are alike, per channel."""
        if self.unlike_power:
            return statistics.effective_batches(self.tally.incident)
        return super().n_batches

    @property
    def binomial(self) -> bool:
        """Whether each patch counted independent rays of one channel, one by one."""
        tally = self.tally
        return (
            self.independent
            and tally.scale == 1
            and tally.channels == 1
            and np.array_equal(tally.sums[..., 0].sum(axis=0), tally.hits)
            and tally.incident.sum() == self._all_rays
        )

    def std_err(self, hemisphere: int) -> Floats:
        """Standard error of :meth:`fraction`; NaN where it is :meth:`dark`.

        Where it is :meth:`pooled`, at least that of the heavy hits that other patches
        let expect.
        """
        scatter, hits = self._scatter(hemisphere), self.hits[hemisphere][..., None]
        if self.binomial:
            return scatter
        heavy, share = self._heavy(hemisphere)
        value, least = self.fraction(hemisphere), np.sqrt(share * hits) * heavy
        pooled = self._rare(value, scatter, hits, heavy, share)
        return np.where(pooled, np.fmax(scatter, least), scatter)

    def pooled(self, hemisphere: int) -> Flags:
        """Whether hits much heavier than its mean one are rare in a patch."""
        if self.binomial:
            return super().pooled(hemisphere)
        hits = self.hits[hemisphere][..., None]
        value, scatter = self.fraction(hemisphere), self._scatter(hemisphere)
        return self._rare(value, scatter, hits, *self._heavy(hemisphere))

    def n_heavy(self, hemisphere: int) -> Floats:
        """How many of the hits make patches scatter, shape ``(channels,)``.

        Infinite where they are not much heavier than the mean one.
        """
        (heavy, _), hits = self._heavy(hemisphere), self.tally.hits[hemisphere].sum()
        square = np.nansum(self._scatter(hemisphere) ** 2, axis=(0, 1))
        alone = heavy * hits > MIN_WEIGHT_RATIO * self.total(hemisphere)
        return np.divide(
            square, heavy**2, out=np.full(heavy.shape, np.inf), where=alone
        )

    def _rare(
        self,
        value: Floats,
        scatter: Floats,
        hits: Counts | int,
        heavy: Floats,
        share: Floats | float = 1.0,
    ) -> Flags:
        """Whether hits as `heavy` as scatter are rare in a `value` of so many hits.

        Their `share` in its hits must be so large that they would scatter more than it
        does, or it must have received one.
        """
        square = np.nan_to_num(scatter) ** 2
        few = square < MIN_EVEN_HITS * heavy**2
        some = (square < share * hits * heavy**2) | (2 * square > heavy**2)
        return (hits > 0) & (heavy * hits > MIN_WEIGHT_RATIO * value) & few & some

    def _heavy(self, hemisphere: int) -> Floats:
        """Weight of the hits that make patches scatter, as part of the incident flux.

        One per channel; and their share in all hits.
        """
        hits = self.hits[hemisphere][..., None]
        sums = self.tally.sums[:, hemisphere]
        return statistics.heavy_hits(sums, self._incident, hits)

    def _scatter(self, hemisphere: int) -> Floats:
        """Standard error of :meth:`fraction` from its own batches, or its own hits."""
        if self.binomial:
            hits = self.tally.hits[hemisphere][..., None]
            return statistics.binomial_std_err(hits, self._all_rays)
        sums = self.tally.sums[:, hemisphere]
        std_err = statistics.batch_std_err(sums, self._incident, self.unlike_power)
        return np.where(self.dark(hemisphere), np.nan, std_err)

    def total_std_err(self, hemisphere: int) -> Floats:
        """Standard error of :meth:`total`."""
        sums, incident = self._sum(hemisphere), self.tally.incident
        return statistics.batch_std_err(sums, incident, self.unlike_power)

    def interval(self, hemisphere: int, level: float) -> tuple[Floats, Floats]:
        """Limits of :meth:`fraction`."""
        fraction = self.fraction(hemisphere)
        hits = self.hits[hemisphere][..., None]
        if self.binomial:
            return statistics.binomial_interval(hits, self.rays, level)
        with np.errstate(invalid="ignore"):
            weight = fraction * self.rays / hits
        scatter, (heavy, share) = self._scatter(hemisphere), self._heavy(hemisphere)
        largest = np.nanmax(weight, initial=1.0)
        few = self._few(fraction, scatter, hits)
        rare = self._rare(fraction, scatter, hits, heavy, share)
        regime = Regime.FEW * few + Regime.RARE * rare
        regime = np.where(self.dark(hemisphere), Regime.DARK, regime)
        missed = np.where(few, largest, weight) if self.deposited else weight
        if self.unlike_power and not self.deposited:
            # light of unlike power: the mean of any patch's rays, each by its power
            with np.errstate(invalid="ignore"):
                square = np.nanmax(scatter**2 / fraction, axis=(0, 1), initial=0.0)
            missed = np.fmax(weight, square * self.rays)
        heavy = np.where(rare, heavy, 0.0)
        limits_of = partial(self._unlike_interval, level)
        unlike = _where(few | rare, limits_of, fraction, scatter, missed, heavy)
        above = weight if self.deposited else self._may_exceed(weight, hits)
        student = alike = self._student(fraction, scatter, weight, above, level)
        if not self.deposited:
            limits_of = partial(statistics.binomial_interval, level=level)
            low, high = _where(few, limits_of, hits, self.rays)
            alike = low * weight, high * weight
        weighs_one = self.tally.scale == 1 and not self.deposited
        dark = np.zeros(()), statistics.upper_limit(self.rays, level) * largest
        limits = {
            Regime.MANY: student,
            Regime.RARE: _widened(student, unlike),
            Regime.FEW: alike if weighs_one else _widened(alike, unlike),
            Regime.FEW_AND_RARE: _widened(alike, unlike),
            Regime.DARK: dark,
        }
        those = [regime == one for one in limits]
        lows, highs = zip(*limits.values())
        return np.maximum(np.select(those, lows), 0.0), np.select(those, highs)

    def _few(self, value: Floats, scatter: Floats, hits: Counts) -> Flags:
        """Whether there are hits, but too few or too unlike ones for Student's t."""
        if not self.deposited:
            enough = MIN_HITS if self.independent else MIN_EVEN_HITS
            return (hits > 0) & (hits < enough)
        # so far from evenly spread and alike that some of great weight are missing;
        # where most patches say so, those that do not may have missed all of them
        uneven = scatter * np.sqrt(hits) > MAX_EVEN_SCATTER * value
        lit = (hits > 0).sum() * self.tally.channels
        uneven |= uneven.sum() > MAX_UNEVEN_PATCHES * lit
        return ((hits < MIN_DEPOSITS) | uneven) & (hits > 0)

    def total_interval(self, hemisphere: int, level: float) -> tuple[Floats, Floats]:
        """Limits of :meth:`total`."""
        value, std_err = self.total(hemisphere), self.total_std_err(hemisphere)
        hits = self.tally.hits[hemisphere].sum() // self.passes
        heavy, _ = self._heavy(hemisphere)
        return self._sampled_interval(value, std_err, hits, heavy, level)

    @property
    def direct_std_err(self) -> Floats:
        """Standard error of `direct`."""
        direct, incident = self.tally.direct, self.tally.incident
        return statistics.batch_std_err(direct, incident, self.unlike_power)

    def direct_interval(self, level: float) -> tuple[Floats, Floats]:
        """Limits of `direct`."""
        hits = self.tally.ledger.direct // self.passes
        std_err, alike = self.direct_std_err, np.zeros(self.direct.shape)
        return self._sampled_interval(self.direct, std_err, hits, alike, level)

    def _sampled_interval(
        self, value: Floats, std_err: Floats, hits: int, heavy: Floats, level: float
    ) -> tuple[Floats, Floats]:
        """Interval of a sum over many patches, of so many hits in all."""
        if self.binomial or hits == 0:
            of_each = np.broadcast_to(hits, value.shape)
            return statistics.binomial_interval(of_each, self.rays, level)
        weight = value * self.rays / hits
        above = self._may_exceed(weight, hits)
        if self.deposited:  # several of a ray, however many are as many as rays
            above = np.maximum(weight, 1 - weight)
        limits = self._student(value, std_err, weight, above, level)
        unlike = self._unlike_interval(level, value, std_err, weight, heavy)
        rare = self._rare(value, std_err, hits, heavy)
        wide = zip(_widened(limits, unlike), limits)
        low, high = (np.where(rare, *ends) for ends in wide)
        low = np.maximum(low, 0.0)  # no flux is negative
        # a channel that none of these hits carried is dark as without them
        none = statistics.binomial_interval(0, self.rays, level)
        return np.where(value > 0, low, none[0]), np.where(value > 0, high, none[1])

    def _unlike_interval(
        self,
        level: float,
        value: Floats,
        scatter: Floats,
        missed: Floats | float,
        heavy: Floats,
    ) -> tuple[Floats, Floats]:
        """Interval of a sum of few weights unlike each other; NaN where it is dark.

        One more may have been missed by chance, of the weight `missed`; of rays, at
        least one that weighs the mean of those in the patch, each counted by what it
        weighs, for the scatter of few hits is the sum of their squared weights.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            largest = np.fmax(missed / self.rays, heavy)
            if not self.deposited:
                largest = np.fmax(largest, scatter**2 / value)
            return statistics.gamma_interval(value, scatter, largest, level, heavy)

    def _may_exceed(self, weight: Floats, hits: Counts | int) -> Floats:
        """What a ray unlike all others may add: the weight of one more hit.

        Or where all were received, what a ray of unit weight has above it.
        """
        return np.where(hits < self.rays, weight, np.maximum(1 - weight, 0))

    def _student(
        self,
        value: Floats,
        std_err: Floats,
        weight: Floats,
        above: Floats,
        level: float,
    ) -> tuple[Floats, Floats]:
        """Interval by Student's t, which leaves open what too few rays show.

        So many rays as would leave an empty patch empty may be of another kind, of
        which none was seen (Hanley and Lippman-Hand 1983, JAMA 249, 1743): rays that
        are lost, or that add the weight `above`. However many the rays, they leave
        open the rounding of what they carry.
        """
        unseen = statistics.upper_limit(self.rays, level)
        rounding, n = ROUNDING * value, self.n_batches
        below = np.maximum(unseen * weight, rounding)
        above = np.where(above > 0, np.maximum(unseen * above, rounding), 0.0)
        return statistics.student_interval(value, std_err, n, level, below, above)


def _where(
    some: Flags, limits: Callable[..., tuple[Floats, Floats]], *arrays: ArrayLike
) -> tuple[Floats, Floats]:
    """Limits in some places, NaN elsewhere: quantiles take long."""
    found = np.full((2, *some.shape), np.nan)
    found[:, some] = limits(*(np.broadcast_to(x, some.shape)[some] for x in arrays))
    return found[0], found[1]


def _widened(
    limits: tuple[Floats, Floats], others: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Limits that reach at least to others, where these are known."""
    return np.fmin(limits[0], others[0]), np.fmax(limits[1], others[1])


@dataclass(frozen=True, eq=False)
class ControlledEstimates(SampledEstimates):
    """Estimates of what rays change of a first order that is known without them.

    Each ray changes a patch by its power of 1 at most, up or down, and most not at all:
    of those that do, the scatter tells how many there were, and by chance one more may
    have been missed. Nothing is dark, for facets need no ray to be seen. A sum that
    rays made negative is told as 0, in patches of less than their chance error; totals
    are of all sums as they are.

    Attributes
    ----------
    rounding : float
        Part of a value that rounding may change alike in all batches.
    """

    rounding: float = field(default=ROUNDING, kw_only=True)

    @property
    def _one(self) -> float:
        """Power of a hit of a patch over that of all rays: that of a ray."""
        return 1 / self.rays

    @property
    def without_hit(self) -> Flags:
        """Whether a patch is known by an upper limit only: none is."""
        return np.zeros(self.tally.hits.shape, bool)

    def dark(self, hemisphere: int) -> Flags:
        """Whether a value is known by an upper limit only: none is."""
        return self._nowhere(hemisphere)

    def pooled(self, hemisphere: int) -> Flags:
        """Whether a patch is judged by the hits of others: none is."""
        return self._nowhere(hemisphere)

    def fraction(self, hemisphere: int) -> Floats:
        """Flux fraction of each patch, 0 where chance made it negative."""
        return np.maximum(super().fraction(hemisphere), 0.0)

    def std_err(self, hemisphere: int) -> Floats:
        """Standard error of :meth:`fraction`, with that of one more hit."""
        return np.hypot(self._scatter(hemisphere), self._one)

    def total_std_err(self, hemisphere: int) -> Floats:
        """Standard error of :meth:`total`, with that of one more ray."""
        scatter = np.hypot(super().total_std_err(hemisphere), 1 / self.rays)
        return np.hypot(scatter, self.rounding * self.total(hemisphere))

    def interval(self, hemisphere: int, level: float) -> tuple[Floats, Floats]:
        """Limits of :meth:`fraction`."""
        value = super().fraction(hemisphere)
        return self._changed(value, self._scatter(hemisphere), self._one, level)

    def total_interval(self, hemisphere: int, level: float) -> tuple[Floats, Floats]:
        """Limits of :meth:`total`."""
        scatter = super().total_std_err(hemisphere)
        return self._changed(self.total(hemisphere), scatter, 1 / self.rays, level)

    def _changed(
        self, value: Floats, scatter: Floats, one: float, level: float
    ) -> tuple[Floats, Floats]:
        """Interval by Student's t, or of a Poisson count of hits if that is wider."""
        counted = scatter**2 / one
        high = statistics.gamma_interval(counted, scatter, one, level)[1]
        least = np.fmax(high - counted, self.rounding * value)
        low, high = statistics.student_interval(
            value, scatter, self.tally.n_batches, level, below=least, above=least
        )
        return np.maximum(low, 0.0), np.maximum(high, 0.0)


@dataclass(frozen=True, eq=False)
class SplitEstimates(ControlledEstimates):
    """Estimates where points of the surface tell the first order, in batches too.

    Most patches receive few branches, or none, which their own scatter does not show;
    their intervals therefore allow for one more branch, and those of totals for one
    more ray: what no point met is bright, but rarer than one in all rays.
    """

    @property
    def _one(self) -> float:
        """Power of a branch over that of all rays; of a ray where these were alone."""
        ledger = self.tally.ledger
        alone = self.tally.hits.sum() == ledger.reflected + ledger.transmitted
        return 1 / (self.rays * (1 if alone else BRANCHES))

    def noise(self, hemisphere: int) -> Floats:
        """Scatter of the batches, without what rays may have missed."""
        return self._scatter(hemisphere)

    def interval(self, hemisphere: int, level: float) -> tuple[Floats, Floats]:
        """Limits of :meth:`fraction`, also where few points send most of it.

        As many as explain its scatter, of which one more may have been missed; that
        weighs at least as much as in the median patch.
        """
        value, scatter = self.fraction(hemisphere), self._scatter(hemisphere)
        weight = np.zeros(value.shape)
        np.divide(scatter**2, value, out=weight, where=(value > 0) & (scatter > 0))
        weight = np.fmax(weight, np.median(weight, axis=(0, 1)))
        few = statistics.gamma_interval(value, scatter, weight, level)
        return _widened(super().interval(hemisphere, level), few)


@dataclass(frozen=True, eq=False)
class IntegralEstimates(Estimates):
    """Estimates from integrals, which may be wrong by their error.

    Delta components were sampled beside them, if there are some: these scatter. No
    patch needs a ray, and an integral of 0 is known by its error: nothing is dark.
    """

    tally: Integrals

    def std_err(self, hemisphere: int) -> Floats:
        """Error of the integrals with the scatter of what was sampled."""
        sums = self.tally.sums[:, hemisphere]
        return np.hypot(self._scatter(sums), self._error(hemisphere))

    def interval(self, hemisphere: int, level: float) -> tuple[Floats, Floats]:
        """Limits of :meth:`fraction`."""
        sums, error = self.tally.sums[:, hemisphere], self._error(hemisphere)
        return self._limits(self.fraction(hemisphere), sums, error, level)

    def total_std_err(self, hemisphere: int) -> Floats:
        """Standard error of :meth:`total`: errors add up as if none cancelled."""
        scatter = self._scatter(self._sum(hemisphere))
        return np.hypot(scatter, self._error(hemisphere).sum(axis=(0, 1)))

    def total_interval(self, hemisphere: int, level: float) -> tuple[Floats, Floats]:
        """Limits of :meth:`total`."""
        error = self._error(hemisphere).sum(axis=(0, 1))
        return self._limits(self.total(hemisphere), self._sum(hemisphere), error, level)

    @property
    def direct_std_err(self) -> Floats:
        """Standard error of `direct`: 0, since no light passes the plane."""
        return self._scatter(self.tally.direct)

    def direct_interval(self, level: float) -> tuple[Floats, Floats]:
        """Limits of `direct`."""
        none = np.zeros(self.tally.channels)
        return self._limits(self.direct, self.tally.direct, none, level)

    def _limits(
        self, value: Floats, sums: Numbers, error: Floats, level: float
    ) -> tuple[Floats, Floats]:
        """Limits of integrals that may be wrong by `error`, and sampled `sums`."""
        low, high = statistics.student_interval(
            value, self._scatter(sums), self.tally.n_batches, level
        )
        return low - error, high + error

    def _error(self, hemisphere: int) -> Floats:
        """What the integrals of a hemisphere's flux fractions may be wrong by."""
        return self.tally.errors[hemisphere] / self.tally.incident.max(axis=0)

    def _scatter(self, sums: Numbers) -> Floats:
        """Standard error of the sampled part of `sums`; 0 if nothing was sent."""
        if not self.tally.ledger.emitted:
            return np.zeros(sums.shape[1:])
        shape = -1, *[1] * (sums.ndim - 2), self.tally.channels
        return statistics.batch_std_err(sums, self.tally.incident.reshape(shape))

"""Value, standard error and limits of sums over patches, by the kind of their light.

A patch, a hemisphere, what passed unscattered and any weighted sum have the same rules.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial, reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Flags, Floats, Integers, Numbers
from ..settings.measurement_settings import BRANCHES
from ..single_precision import ROUNDING
from . import statistics
from .tally import Integrals, Tally

# Below this many hits a sum is too skewed for Student's t.
MIN_HITS = 100
# The same for rays of a low-discrepancy sequence, whose counts scatter less.
MIN_EVEN_HITS = 30
# Deposits of a sum below which the few large ones among them may be missing.
MIN_DEPOSITS = 300

# Scatter of deposits, in units of that of as many independent ones all alike, above
# which Student's t is not enough. Measured with a point in each patch: in the median
# 0.3 on diffuse facets, 2.5 on glossy ones, where it held 81 to 92 % and not 95.
MAX_EVEN_SCATTER = 0.5
# Part of the patches, above which that holds for all. On grooves of rough conductors
# 0.8 to 0.96 are so (alpha 0.05 to 0.2), of rough plastic up to 0.55, diffuse 0.34.
MAX_UNEVEN_PATCHES = 0.75

# How much heavier than the mean hit of a sum those must be that make all patches
# scatter, so that it is judged by them. Up to that, its own hits tell enough of it.
MIN_WEIGHT_RATIO = 2.0


@dataclass(frozen=True, eq=False)
class Around:
    """What the hits of all patches of a hemisphere tell of a sum over some of them.

    Attributes
    ----------
    heavy, share : ndarray, shape (channels,)
        Weight of the hits that make patches scatter, as a fraction of the incident
        flux, and their share in all hits.
    typical : ndarray, shape (channels,)
        Median weight of the points of a patch, of the estimator `split`, as a fraction.
    largest, unlike : ndarray, shape (channels,)
        Largest mean weight of a patch's hits, and what a missed one may weigh where
        rays carry unlike power, in units of a ray; that is the former at least.
    uneven : bool
        Whether deposits scatter too much for Student's t in most patches.
    part : ndarray, broadcastable to ``(..., channels)``
        Part of a hemisphere that the sum is of, by projected solid angle.
    """

    heavy: Floats
    share: Floats
    typical: Floats
    largest: Floats
    unlike: Floats
    uneven: bool = False
    part: Floats | float = 1.0

    @classmethod
    def nothing(cls, channels: int) -> Around:
        """Of a sum whose own hits are all that tell of it."""
        none = np.zeros(channels)
        return cls(none, none, none, none + 1.0, none)

    def scaled(self, flux: Floats, ray: Floats, part: float) -> Around:
        """With fractions of another flux and another ray, for other patches."""
        return replace(
            self,
            heavy=self.heavy * flux,
            typical=self.typical * flux,
            largest=self.largest * ray,
            unlike=self.unlike * ray,
            part=part,
        )

    def joined(self, other: Around) -> Around:
        """Of both hemispheres: the larger of all."""
        names = "heavy", "share", "typical", "largest", "unlike", "uneven", "part"
        found: dict[str, Any] = {
            n: np.maximum(getattr(self, n), getattr(other, n)) for n in names
        }
        return Around(**found)


@dataclass(frozen=True, eq=False)
class Estimate(ABC):
    """A sum over patches, or each of several, in each channel.

    Attributes
    ----------
    light : Estimates
        What the sums share.
    sums : ndarray, shape (n_batches, ..., channels)
    incident : ndarray, shape (n_batches, channels)
        Flux of which they are fractions.
    hits : ndarray of integers, shape (...)
        Hits of one pass.
    rays : int
        Rays of one pass that bring the flux `incident`.
    rest : callable, optional
        Returns what all patches tell of it; without it these are all patches.
    """

    light: Estimates
    sums: Numbers
    incident: Numbers
    hits: Integers
    rays: int
    rest: Callable[[], Around] | None = None

    @cached_property
    def value(self) -> Floats:
        """Flux fractions, shape ``(..., channels)``; negative by chance on facets."""
        return statistics.ratio(self.sums, self._incident)

    @property
    @abstractmethod
    def scatter(self) -> Floats:
        """Standard error from the sum's own batches, or its own hits."""

    @property
    @abstractmethod
    def std_err(self) -> Floats:
        """Standard error of `value`; NaN where it is not known."""

    @property
    def noise(self) -> Floats:
        """Standard error that is right on average, though not of every sum."""
        return self.std_err

    @abstractmethod
    def interval(self, level: float) -> tuple[Floats, Floats]:
        """Limits ``(low, high)``, as :meth:`Record.interval` describes them."""

    @property
    def dark(self) -> Flags:
        """Whether a value is known by an upper limit only, like `value`.

        Of several channels, one may be dark where others were received.
        """
        return np.zeros(self.sums.shape[1:], bool)

    @property
    def pooled(self) -> Flags:
        """Whether its own hits show too little of its scatter, like `value`.

        It is then judged by the hits of all patches of the hemisphere as well.
        """
        return np.zeros(self.sums.shape[1:], bool)

    @property
    def few(self) -> Flags:
        """Whether hits are too few or too unlike for Student's t, like `value`."""
        return np.zeros(self.sums.shape[1:], bool)

    @property
    def binomial(self) -> bool:
        """Whether independent rays of one channel were counted, one by one."""
        return False

    def find_around(self) -> Around:
        """What these patches of one hemisphere tell of sums over some of them."""
        nothing = Around.nothing(self.sums.shape[-1])
        return replace(nothing, part=self.light.parts[..., None])

    @cached_property
    def around(self) -> Around:
        """What the hits of all patches of the hemisphere tell of it."""
        return self.rest() if self.rest else self.find_around()

    @property
    def _incident(self) -> Numbers:
        """Incident flux per batch, broadcastable to the sums."""
        n, *rows, channels = self.sums.shape
        return self.incident.reshape(n, *(1 for _ in rows), channels)


@dataclass(frozen=True, eq=False)
class SampledEstimate(Estimate):
    """From rays alone: counts, or weights that scatter between batches."""

    @property
    def dark(self) -> Flags:
        """Whether no ray carried anything."""
        return np.asarray(~np.any(self.sums, axis=0))

    @cached_property
    def binomial(self) -> bool:
        """Whether independent rays of one channel were counted, one by one."""
        tally = self.light.tally
        return (
            self.light.independent
            and tally.scale == 1
            and self.sums.shape[-1] == 1
            and np.array_equal(self.sums[..., 0].sum(axis=0), self.hits)
            and self.incident.sum() == self.rays
        )

    @cached_property
    def scatter(self) -> Floats:
        """Standard error from the sum's own batches, or its own hits."""
        if self.binomial:
            return statistics.binomial_std_err(self._hits, self.rays)
        unlike = self.light.unlike_power
        std_err = statistics.batch_std_err(self.sums, self._incident, unlike)
        return np.where(self.dark, np.nan, std_err)

    @property
    def std_err(self) -> Floats:
        """Standard error of `value`; NaN where it is `dark`.

        Where it is `pooled`, at least that of the heavy hits that other patches let
        expect.
        """
        if self.binomial:
            return self.scatter
        around = self.around
        least = np.sqrt(around.share * self._hits) * around.heavy
        return np.where(self.pooled, np.fmax(self.scatter, least), self.scatter)

    @cached_property
    def pooled(self) -> Flags:
        """Whether hits much heavier than its mean one are rare in it.

        Their share in its hits must be so large that they would scatter more than it
        does, or it must have received one.
        """
        if self.binomial:
            return super().pooled
        hits, around = self._hits, self.around
        square, heavy = np.nan_to_num(self.scatter) ** 2, around.heavy
        few = square < MIN_EVEN_HITS * heavy**2
        some = (square < around.share * hits * heavy**2) | (2 * square > heavy**2)
        alone = heavy * hits > MIN_WEIGHT_RATIO * self.value
        return np.asarray((hits > 0) & alone & few & some)

    @cached_property
    def few(self) -> Flags:
        """Whether there are hits, but too few or too unlike ones for Student's t."""
        hits = self._hits
        if not self.light.deposited:
            enough = MIN_HITS if self.light.independent else MIN_EVEN_HITS
            few = (hits > 0) & (hits < enough)
        else:
            uneven = self._uneven | self.around.uneven
            few = ((hits < MIN_DEPOSITS) | uneven) & (hits > 0)
        return np.broadcast_to(few, self.value.shape)

    def interval(self, level: float) -> tuple[Floats, Floats]:
        """Limits of `value`: by Student's t, or of few or rare hits."""
        hits = self._hits
        if self.binomial:
            return statistics.binomial_interval(hits, self.rays, level)
        low, high = self._student(level)
        counted, rare = self.few, self.pooled & ~self.dark
        if counted.any() and not self.light.deposited:

            def by_count(n: Floats, weight: Floats) -> tuple[Floats, Floats]:
                ends = statistics.binomial_interval(n, self.rays, level)
                return ends[0] * weight, ends[1] * weight

            ends = _where(counted, by_count, hits, self._weight)
            if not self.light.independent:  # which scatter less: the narrower of both
                ends = np.fmax(ends[0], low), np.fmin(ends[1], high)
            low, high = (np.where(counted, *pair) for pair in zip(ends, (low, high)))
        exact = self.light.independent and self.light.tally.scale == 1
        wide = rare if exact else rare | self.few
        low, high = _widened((low, high), self._unlike(level, wide, rare))
        limit = statistics.upper_limit(self.rays, level) * self.around.largest
        low = np.where(self.dark, 0.0, np.maximum(low, 0.0))  # no flux is negative
        return low, np.where(self.dark, limit, high)

    def find_around(self) -> Around:
        """What these patches of one hemisphere tell of sums over some of them."""
        heavy, share = statistics.heavy_hits(self.sums, self._incident, self._hits)
        unlike = np.zeros(len(heavy))
        if self.light.unlike_power and not self.light.deposited:
            # light of unlike power: the mean of any patch's rays, each by its power
            with np.errstate(invalid="ignore"):
                square = self.scatter**2 / self.value
            unlike = np.nanmax(square, axis=(0, 1), initial=0.0) * self.rays
        uneven = False
        if self.light.deposited:
            # where most patches say so, those that do not may have missed all of them
            lit = (self.hits > 0).sum() * self.sums.shape[-1]
            uneven = bool(self._uneven.sum() > MAX_UNEVEN_PATCHES * lit)
        none = np.zeros(len(heavy))
        largest = none + np.nanmax(self._weight, initial=1.0)
        part = self.light.parts[..., None]
        return Around(heavy, share, none, largest, unlike, uneven, part)

    @property
    def _hits(self) -> Integers:
        """Hits, broadcastable to `value`."""
        return np.asarray(self.hits)[..., None]

    @cached_property
    def _weight(self) -> Floats:
        """Mean weight of a hit in units of a ray's; NaN without a hit."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.value * self.rays / self._hits)

    @property
    def _uneven(self) -> Flags:
        """Whether deposits are so far from even that some of great weight are missing.

        That is from evenly spread, and all alike.
        """
        uneven = self.scatter * np.sqrt(self._hits) > MAX_EVEN_SCATTER * self.value
        return np.asarray(uneven)

    def _unlike(self, level: float, where: Flags, rare: Flags) -> tuple[Floats, Floats]:
        """Interval of a sum of few weights unlike each other; NaN elsewhere.

        One more may have been missed by chance; of rays at least one that weighs the
        mean of those in the sum, each counted by what it weighs, for the scatter of few
        hits is the sum of their squared weights.
        """
        around, value, scatter = self.around, self.value, self.scatter
        missed = self._weight
        if self.light.deposited:
            missed = np.where(self.few, around.largest, missed)
        else:
            missed = np.fmax(missed, around.unlike)
        heavy = np.where(rare, around.heavy, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            largest = np.fmax(missed / self.rays, heavy)
            if not self.light.deposited:
                largest = np.fmax(largest, scatter**2 / value)

            def limits(*arrays: Floats) -> tuple[Floats, Floats]:
                value, scatter, largest, heavy = arrays
                return statistics.gamma_interval(value, scatter, largest, level, heavy)

            return _where(where, limits, value, scatter, largest, heavy)

    def _student(self, level: float) -> tuple[Floats, Floats]:
        """Interval by Student's t, which leaves open what too few rays show.

        So many rays as would leave an empty patch empty may be of another kind, of
        which none was seen (Hanley and Lippman-Hand 1983, JAMA 249, 1743): rays that
        are lost, or that add the weight of one more hit. Where all were received, it
        is what a ray of unit weight has above it; a ray unlike all others of those
        that deposit spreads over the patches. However many the rays, they leave open
        the rounding of what they carry.
        """
        weight, unseen = self._weight, statistics.upper_limit(self.rays, level)
        rounding, n = ROUNDING * self.value, self.light.n_batches
        if self.light.deposited:
            above = np.maximum(weight, (1 - weight) * self.around.part)
        else:
            all_rays = self._hits >= self.rays
            above = np.where(all_rays, np.maximum(1 - weight, 0), weight)
        below = np.maximum(unseen * weight, rounding)
        above = np.where(above > 0, np.maximum(unseen * above, rounding), 0.0)
        return statistics.student_interval(
            self.value, self.scatter, n, level, below, above
        )


@dataclass(frozen=True, eq=False)
class ControlledEstimate(SampledEstimate):
    """What rays change of a first order that is known without them.

    Each ray changes a patch by its power of 1 at most, up or down, and most not at all:
    of those that do, the scatter tells how many there were, and by chance one more may
    have been missed. Nothing is dark, for facets need no ray to be seen.
    """

    @property
    def dark(self) -> Flags:
        """Whether a value is known by an upper limit only: none is."""
        return np.zeros(self.sums.shape[1:], bool)

    @property
    def binomial(self) -> bool:
        """Whether rays were counted, one by one: facets are not."""
        return False

    @property
    def pooled(self) -> Flags:
        """Whether it is judged by the hits of others: none is."""
        return np.zeros(self.sums.shape[1:], bool)

    @property
    def _one(self) -> Floats | float:
        """Power of one more hit as a fraction of the incident flux: that of a ray."""
        return self.around.largest / self.rays

    @property
    def std_err(self) -> Floats:
        """Standard error of `value`, with that of one more hit."""
        scatter = np.hypot(self.scatter, self._one)
        return np.hypot(scatter, self.light.rounding * self.value)

    def find_around(self) -> Around:
        """A hit has the power of a ray."""
        return Estimate.find_around(self)

    def interval(self, level: float) -> tuple[Floats, Floats]:
        """By Student's t, or of a Poisson count of hits if that is wider."""
        value, scatter, one = self.value, self.scatter, self._one
        counted = scatter**2 / one
        high = statistics.gamma_interval(counted, scatter, one, level)[1]
        least = np.fmax(high - counted, self.light.rounding * np.maximum(value, 0))
        low, high = statistics.student_interval(
            value, scatter, self.light.tally.n_batches, level, below=least, above=least
        )
        return np.maximum(low, 0.0), np.maximum(high, 0.0)


@dataclass(frozen=True, eq=False)
class SplitEstimate(ControlledEstimate):
    """What points of the surface tell of the first order, in batches too.

    Most patches receive few branches or none, which the scatter does not show. The
    interval of a patch therefore allows for one more branch, and that of a sum over
    many patches for all branches of a ray: places that no point met may be bright, but
    are rarer than one in all rays.
    """

    @property
    def noise(self) -> Floats:
        """Scatter of the batches, without what rays may have missed."""
        return self.scatter

    @property
    def _one(self) -> Floats | float:
        """Power of the branches of a ray that a sum receives; of a ray without any."""
        tally, ledger = self.light.tally, self.light.tally.ledger
        alone = tally.hits.sum() == ledger.reflected + ledger.transmitted
        return super()._one * (
            1 if alone else np.maximum(1 / BRANCHES, self.around.part)
        )

    def find_around(self) -> Around:
        """Points have the weight of those in the median patch at least."""
        value, scatter = self.value, self.scatter
        weight = np.zeros(value.shape)
        np.divide(scatter**2, value, out=weight, where=(value > 0) & (scatter > 0))
        return replace(super().find_around(), typical=np.median(weight, axis=(0, 1)))

    def interval(self, level: float) -> tuple[Floats, Floats]:
        """Also where few points send most of it.

        As many as explain the scatter, of which one more may have been missed.
        """
        value, scatter = self.value, self.scatter
        weight = np.zeros(value.shape)
        np.divide(scatter**2, value, out=weight, where=(value > 0) & (scatter > 0))
        weight = np.fmax(weight, self.around.typical)
        few = statistics.gamma_interval(value, scatter, weight, level)
        return _widened(super().interval(level), few)


@dataclass(frozen=True, eq=False)
class IntegralEstimate(Estimate):
    """Integrals, which may be wrong by their error.

    Delta components were sampled beside them, if there are some: these scatter. No
    patch needs a ray, and an integral of 0 is known by its error: nothing is dark.
    Errors of patches add up as if none cancelled.

    Attributes
    ----------
    error : ndarray, shape (..., channels)
        What the integrals in `value` may be wrong by.
    """

    error: Floats = field(kw_only=True)

    @property
    def scatter(self) -> Floats:
        """Standard error of the sampled part; 0 if nothing was sent."""
        if not self.light.tally.ledger.emitted:
            return np.zeros(self.sums.shape[1:])
        return statistics.batch_std_err(self.sums, self._incident)

    @property
    def std_err(self) -> Floats:
        """Error of the integrals with the scatter of what was sampled."""
        return np.hypot(self.scatter, self.error)

    def interval(self, level: float) -> tuple[Floats, Floats]:
        """By Student's t, with the error on either side."""
        low, high = statistics.student_interval(
            self.value, self.scatter, self.light.tally.n_batches, level
        )
        return low - self.error, high + self.error


@dataclass(frozen=True, eq=False)
class Estimates:
    """What is known of one incident direction, and how well.

    Hemisphere 0 is the emitter's side.

    Attributes
    ----------
    tally : Tally
    kind : type of Estimate
    independent : bool
        Whether the rays are independent; else of a low-discrepancy sequence.
    deposited : bool
        Whether hits are deposits: several from one ray, or none.
    passes : int
        How often each ray was sent, for more wavelengths than one carries.
    rounding : float
        Part of a value of facets that rounding may change alike in all batches.
    solid : ndarray, shape (n_theta, n_phi), optional
        Projected solid angles of the patches in sr; without them all are alike.
    """

    tally: Tally
    kind: Callable[..., Estimate] = SampledEstimate
    independent: bool = False
    deposited: bool = False
    passes: int = 1
    rounding: float = ROUNDING
    solid: Floats | None = None

    @cached_property
    def hits(self) -> Integers:
        """Hits per patch of one pass, shape ``(n_hemispheres, n_theta, n_phi)``.

        Rounded up: a patch that one pass alone hits was hit.
        """
        return self._of_a_pass(self.tally.hits)

    @cached_property
    def rays(self) -> int:
        """Rays of one pass that met the specimen."""
        ledger = self.tally.ledger
        return (ledger.emitted - ledger.missed - ledger.unlit) // self.passes

    @cached_property
    def parts(self) -> Floats:
        """Part of a hemisphere that each patch is, by projected solid angle."""
        if self.solid is not None:
            return self.solid / np.pi
        shape = self.tally.hits.shape[1:]
        return np.full(shape, 1 / (shape[0] * shape[1]))

    @cached_property
    def unlike_power(self) -> bool:
        """Whether rays carry unlike power, and batches unlike parts of it."""
        return bool(np.any(self.tally.incident % self.tally.scale))

    @cached_property
    def n_batches(self) -> int | Floats:
        """Batches by whose scatter Student's t goes.

        Of unlike power as many as are alike, per channel.
        """
        if self.unlike_power:
            return statistics.effective_batches(self.tally.incident)
        return self.tally.n_batches

    @property
    def binomial(self) -> bool:
        """Whether each patch counted independent rays of one channel, one by one."""
        return all(self.patches(i).binomial for i in range(len(self.hits)))

    @property
    def without_hit(self) -> Flags:
        """Whether a patch is known by an upper limit only, shaped like `hits`."""
        dark = [self.patches(i).dark.all(axis=-1) for i in range(len(self.hits))]
        return np.stack(dark) & (self.tally.hits == 0)

    def patches(self, hemisphere: int) -> Estimate:
        """Each patch, ``(n_theta, n_phi, channels)``."""
        return self._patches[hemisphere]

    def total(self, hemisphere: int) -> Estimate:
        """All patches of a hemisphere, shape ``(channels,)``."""
        weights = np.zeros(self.tally.hits.shape)
        weights[hemisphere] = 1.0
        return self.weighted(weights)

    @cached_property
    def direct(self) -> Estimate:
        """What passed a periodic specimen without any event, shape ``(channels,)``."""
        tally, hits = self.tally, self._of_a_pass(self.tally.ledger.direct)
        own = partial(Around.nothing, tally.channels)
        where = self, tally.direct, tally.incident, hits, self.rays, own
        if isinstance(tally, Integrals):
            return IntegralEstimate(*where, error=np.zeros(tally.channels))
        return SampledEstimate(*where)

    def weighted(self, weights: Floats, over: Floats | None = None) -> Estimate:
        """Weighted sum of patches, shape ``(channels,)``.

        Parameters
        ----------
        weights, over : ndarray, shape (n_hemispheres, n_theta, n_phi)
            The sum is a fraction of the flux that came, or of that of `over`, whose
            own hits are then all the rays there are.
        """
        tally, incident, rays = self.tally, self.tally.incident, self.rays
        if over is not None:
            incident = summed(tally.sums, over)
            if not self.deposited:
                rays = int(self._of_a_pass(tally.hits[over > 0].sum(dtype=np.uint64)))

        def rest() -> Around:
            """Of the hemispheres in which the sum has patches."""
            with np.errstate(divide="ignore", invalid="ignore"):
                flux = tally.incident.sum(axis=0) / incident.sum(axis=0)
            found = []
            for own, patches in zip(np.abs(weights), self._patches):
                if own.any():
                    size, part = flux * own.max(), float(self.parts[own > 0].sum())
                    one = patches.around.scaled(size, size * rays / self.rays, part)
                    if self.unlike_power and over is None:
                        # of all that a heavy ray sends, its own power is a part
                        one = replace(one, share=one.share * max(1 - part, 0.0))
                    found.append(one)
            return reduce(Around.joined, found or [Around.nothing(tally.channels)])

        sums = summed(tally.sums, weights)
        hits = self._of_a_pass(tally.hits[weights != 0].sum(dtype=np.uint64))
        where = self, sums, incident, hits, rays, rest
        if not isinstance(tally, Integrals):
            return self.kind(*where)
        spread = np.abs(weights)
        if over is not None:
            spread = spread + over * statistics.ratio(sums, incident)
        error = summed((tally.errors / incident.max(axis=0))[None], spread)[0]
        return self.kind(*where, error=error)

    def n_heavy(self, hemisphere: int) -> Floats:
        """How many of the hits make patches scatter, shape ``(channels,)``.

        Infinite where they are not much heavier than the mean one.
        """
        patches, hits = self.patches(hemisphere), self.tally.hits[hemisphere].sum()
        heavy, square = patches.around.heavy, np.nansum(patches.scatter**2, axis=(0, 1))
        alone = heavy * hits > MIN_WEIGHT_RATIO * self.total(hemisphere).value
        return np.divide(
            square, heavy**2, out=np.full(heavy.shape, np.inf), where=alone
        )

    @cached_property
    def _patches(self) -> list[Estimate]:
        """Estimates of the patches of each hemisphere."""
        tally, found = self.tally, []
        for i, hits in enumerate(self.hits):
            where = self, tally.sums[:, i], tally.incident, hits, self.rays
            more = {}
            if isinstance(tally, Integrals):
                more = {"error": tally.errors[i] / tally.incident.max(axis=0)}
            found.append(self.kind(*where, **more))
        return found

    def _of_a_pass(self, n: Any) -> Integers:
        """Number of hits of one pass, rounded up."""
        n = np.asarray(n, np.int64)
        return n if self.passes == 1 else np.asarray(-(-n // self.passes))


def summed(sums: Numbers, weights: Floats) -> Numbers:
    """Weighted sum over patches, per batch and channel.

    Parameters
    ----------
    sums : ndarray, shape (n_batches, n_hemispheres, n_theta, n_phi, channels)
    weights : ndarray, shape (n_hemispheres, n_theta, n_phi)
        Where all of a hemisphere are 1, its sums are added up as they are.
    """
    found = np.zeros((len(sums), sums.shape[-1]), sums.dtype)
    for i, own in enumerate(weights):
        if own.any():
            part = sums[:, i] if np.all(own == 1) else sums[:, i] * own[..., None]
            found = found + part.sum(axis=(1, 2))
    return found


def _where(
    some: Flags, limits: Callable[..., tuple[Floats, Floats]], *arrays: ArrayLike
) -> tuple[Floats, Floats]:
    """Limits in some places, NaN elsewhere: quantiles take long."""
    found = np.full((2, *some.shape), np.nan)
    if some.any():
        found[:, some] = limits(*(np.broadcast_to(x, some.shape)[some] for x in arrays))
    return found[0], found[1]


def _widened(
    limits: tuple[Floats, Floats], others: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Limits that reach at least to others, where these are known."""
    return np.fmin(limits[0], others[0]), np.fmax(limits[1], others[1])

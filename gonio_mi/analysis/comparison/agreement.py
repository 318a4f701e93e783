"""Scores of points that two sides have measured, and tests whether they agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy  # its parts are imported when used

from ...array_types import Flags, Floats, Integers
from ...results.record import Record
from ...results.statistics import student_score, two_sided_score
from ...results.tally import without_chance
from ...single_precision import FEW_ROUNDINGS
from ..points import Points

# Below this many hits the mean of batches is too skewed for Student's t far out: its
# two-sided tail at 1e-5 is 1.3 times too heavy at 1000 hits, 4.4 times at 100.
MIN_STUDENT_HITS = 1000

# Hits that stand for an integral's: more than enough for Student's t.
HITS_OF_INTEGRALS = 2.0**60

# Exact probabilities below about 1e-295 are not told apart.
MAX_EXACT_SCORE = 36.7


@dataclass(eq=False)
class Readings:
    """Values of a record at some points: one incident direction, independent batches.

    Integrals have no batches, and their `std_err` bounds what they are wrong by: no
    score of a point or a sum is larger by chance than the same bound allows.

    `residual` has the shape (n_batches, n), and ``residual.T @ residual`` is the
    covariance of the values, estimated from the batches; `exposure` is the number of
    hits per unit of value, `weight` the mean flux of a hit, and `usual` that of all
    hits in the hemisphere; `solid` are projected solid angles.
    """

    value: np.ndarray
    std_err: np.ndarray
    residual: np.ndarray
    hits: np.ndarray
    exposure: np.ndarray
    weight: np.ndarray
    usual: np.ndarray
    solid: np.ndarray
    dof: float

    @classmethod
    def of(
        cls,
        record: Record,
        index: int,
        hemisphere: Integers | int,
        channel: Integers | int,
        patch: Integers,
    ) -> Readings:
        """Readings at flat patch indices, of each its hemisphere and channel."""
        hemisphere, channel, patch = np.broadcast_arrays(hemisphere, channel, patch)
        one, tally = record[index], record.tallies[index]
        estimates = record.estimates[index]
        row, column = np.divmod(patch, record.subdivision.shape[1])
        where = (hemisphere, row, column, channel)
        pair: Any = (one.brdf, one.btdf) if record.has_lower else (one.brdf,)
        errors: Any = (one.brdf_std_err, one.btdf_std_err)[: len(pair)]
        solid = record.subdivision.projected_solid_angles[row, column]
        hits, rays = estimates.hits[where[:3]], estimates.rays
        value = np.stack(pair)[where]
        flux = tally.sums.sum(axis=(0, 2, 3), dtype=float) / tally.scale
        all_hits = estimates.hits.sum(axis=(1, 2))[:, None]
        mean_weight = flux / np.maximum(all_hits, 1)
        usual = np.where(mean_weight > 0, mean_weight, 1.0)[hemisphere, channel]
        # the mean weight of a hit, as far as the flux that came with it
        weight = np.where(hits > 0, value * solid * rays / np.maximum(hits, 1), usual)
        weight = np.where(weight > 0, weight, usual)
        if without_chance([tally]):
            return cls(
                value=value,
                std_err=np.stack(errors)[where],
                residual=np.zeros((0, len(value))),
                hits=np.full(len(value), HITS_OF_INTEGRALS),
                exposure=HITS_OF_INTEGRALS * solid,
                weight=np.ones(len(value)),
                usual=np.ones(len(value)),
                solid=solid,
                dof=1e9,
            )
        each = Points.of_record(record, index, where).roots
        return cls(
            value=value,
            std_err=np.stack(errors)[where],
            residual=each / solid,
            hits=hits.astype(float),
            exposure=rays * solid / weight,
            weight=weight,
            usual=usual,
            solid=solid,
            dof=1e9 if estimates.binomial else len(each) - 1.0,
        )

    @property
    def error(self) -> Floats:
        """Standard error; one hit's worth where there was none.

        The sum of a batch is not trusted to more than a rounded hit, 1/12 in square,
        where points so regular that batches hardly differ claim it.
        """
        rounded = np.sqrt(len(self.residual) / 12) / self.exposure
        known = np.isfinite(self.std_err)
        return np.where(known, np.maximum(self.std_err, rounded), 1 / self.exposure)

    def total(self, solid: Floats) -> tuple[Any, Any, float]:
        """Sum of values over solid angles, its variance and degrees of freedom."""
        if not len(self.residual):  # errors of integrals may be all of one sign
            return self.value @ solid, (self.error @ solid) ** 2, self.dof
        if len(self.residual) < 2:
            return self.value @ solid, self.error**2 @ solid**2, self.dof
        variance = np.sum((self.residual @ solid) ** 2)
        return self.value @ solid, variance, len(self.residual) - 1.0

    def correlation(self, sigma: Floats) -> Floats:
        """Share of the points' covariance: its root, over `sigma` of each point."""
        norm = np.sqrt(np.sum(self.residual**2, axis=0))
        share = np.where(norm > 0, self.error / sigma, 0.0)
        return self.residual * (share / np.where(norm > 0, norm, 1.0))


@dataclass(eq=False)
class Variation:
    """How far what is compared with readings may be from them by its place in a patch.

    `bound` is by how much at most, `hidden` the mean square of what the noise of the
    readings hides of it, without bias: negative by chance.
    """

    bound: np.ndarray
    hidden: np.ndarray


@dataclass(eq=False)
class PointSet:
    """Points of one record and incident direction, and what they are compared with.

    The errors of `other` are without those of `other_readings`, and without the common
    factor that :func:`judge` fits.
    """

    columns: dict[str, Any]  # directions and channel of the points
    readings: Readings
    other: Points
    total_of: list[Any]  # to which total each point belongs
    other_readings: Readings | None = None
    variation: Variation | None = None  # of means over patches beside points
    sharing: int = 1  # how many sets may have one noise, as copies of one direction


def judge(
    sets: Sequence[PointSet], scale: float
) -> tuple[Floats, Floats, dict[str, float], dict[str, float]]:
    """Scores of all points, and the tests of :func:`gonio_mi.compare`.

    Parameters
    ----------
    sets : list of PointSet
    scale : float
        Relative standard uncertainty of a factor common to all values compared with.

    Returns
    -------
    z, error : ndarray of float64, shape (n_points,)
        Normal scores, and the standard errors of what the readings are compared with.
    statistics, p_values : dict of float
    """
    fitted = _fitted_scale(sets, scale)
    scores, errors, trace2 = [], [], 0.0
    totals: dict[object, _Total] = {}
    for one in sets:
        shared = scale * np.abs(one.other.value)
        z, sigma = _scores(one, 1 + fitted)
        scores.append(z)
        own = 0.0 if one.other_readings is None else one.other_readings.error
        errors.append(np.sqrt(one.other.std_err**2 + shared**2 + own**2))
        trace2 += one.sharing * _trace_of_square(one, sigma)
        for key in set(one.total_of):
            _add_total(totals.setdefault(key, _Total()), one, key, shared)
    z = np.concatenate(scores)
    n = len(z)
    pull = fitted / scale if scale else 0.0
    most = sum(len(one.other.value) / one.sharing for one in sets)
    chi2, dof = float(z @ z + pull**2), min(float(n**2 / trace2), most)
    worst = float(np.abs(z).max())
    total = [abs(t.score) for t in totals.values() if t.hits >= MIN_STUDENT_HITS]
    statistics = {
        "chi2": chi2,
        "chi2_dof": dof,
        "scale": 1 + fitted,
        "worst": worst,
        "total": max(total, default=np.nan),
    }
    p_values = {
        "chi2": float(scipy.special.chdtrc(dof, chi2 * dof / n)),
        "worst": _p_value_of_largest(worst, n),
        "total": _p_value_of_largest(statistics["total"], len(total)) if total else 1.0,
    }
    return z, np.concatenate(errors), statistics, p_values


def mostly_few(sets: Sequence[PointSet]) -> bool:
    """Whether most points have fewer than `MIN_STUDENT_HITS` hits on either side."""
    few = np.concatenate([_errors(one, 1.0)[2] for one in sets])
    return bool(few.mean() > 0.5)


def _fitted_scale(sets: Sequence[PointSet], scale: float) -> float:
    """Most likely relative error of the common scale, whose standard error is `scale`.

    With its own square in units of `scale`, the scores of what is left have the sum of
    squares that the full covariance would give. Patches with few hits are left out.
    """
    if not scale:
        return 0.0
    pull, weight = 0.0, 1 / scale**2
    for one in sets:
        sigma2, _, few, _ = _errors(one, 1.0)
        bound = 0.0 if one.variation is None else one.variation.bound
        inverse = np.where(few, 0.0, 1 / (sigma2 + bound**2))
        pull += np.sum(
            one.other.value * (one.readings.value - one.other.value) * inverse
        )
        weight += np.sum(one.other.value**2 * inverse)
    return pull / weight


@dataclass
class _Total:
    """Sum of the differences of all points in flux, with its variance."""

    difference: float = 0.0
    variance: float = 0.0
    shared: float = 0.0
    welch: float = 0.0
    hits: float = 0.0
    bound: float = 0.0
    # of variation: the sum over solid angles, and these
    hidden: Floats = field(default_factory=lambda: np.zeros(2))

    @property
    def score(self) -> float:
        """Normal score of the difference, beyond what variation in patches explains."""
        variance = self.variance + self.shared**2
        dof = variance**2 / self.welch if self.welch else np.inf
        bound = self.bound + np.sqrt(max(self.hidden.prod(), 0.0))
        beyond = max(abs(self.difference) - bound, 0.0)
        return float(student_score(beyond / np.sqrt(variance), dof))


def _add_total(total: _Total, one: PointSet, key: object, shared: Floats) -> None:
    """Add the points of a set that belong to `key`."""
    solid = one.readings.solid * np.array([own == key for own in one.total_of])
    value, variance, dof = one.readings.total(solid)
    other = one.other.value @ solid
    total.difference += value - other
    total.variance += variance + one.other.std_err**2 @ solid**2
    total.variance += (FEW_ROUNDINGS * other) ** 2 + np.finfo(float).tiny
    total.welch += variance**2 / dof
    total.welch += one.other.std_err**4 / one.other.dof @ solid**4
    total.shared += shared @ solid
    total.hits += one.readings.hits @ (solid > 0)
    if one.variation is not None:
        total.bound += one.variation.bound @ solid
        total.hidden += one.variation.hidden @ solid, solid.sum()
    if one.other_readings is not None:
        _, variance, dof = one.other_readings.total(solid)
        total.variance += variance
        total.welch += variance**2 / dof


def _errors(one: PointSet, factor: float) -> tuple[Floats, Floats, Flags, Flags]:
    """Variance of each difference, its d.o.f., where hits are few, where none.

    Welch's, and no more than a table says of its own: on the safe side (Mickey and
    Brown 1966, Annals of Mathematical Statistics 37, 639).
    """
    mine, others = one.readings, one.other_readings
    rounding = FEW_ROUNDINGS * factor * one.other.value
    sigma2 = mine.error**2 + one.other.std_err**2 + rounding**2
    if one.variation is not None:
        sigma2 = sigma2 + np.maximum(one.variation.hidden, 0)
    welch = mine.error**4 / mine.dof + one.other.std_err**4 / one.other.dof
    few, empty = mine.hits < MIN_STUDENT_HITS, mine.hits == 0
    if others is not None:
        sigma2 = sigma2 + others.error**2
        welch = welch + others.error**4 / others.dof
        few, empty = few | (others.hits < MIN_STUDENT_HITS), empty | (others.hits == 0)
    dof = sigma2**2 / np.maximum(welch, np.finfo(float).tiny)
    # Welch's are too many where an error of few repetitions is small by chance
    return sigma2, np.minimum(dof, one.other.dof), few, empty


def _scores(one: PointSet, factor: float) -> tuple[Floats, Floats]:
    """Normal score of each point's difference, and its standard error.

    What the readings are compared with is multiplied by `factor`.
    """
    mine, others = one.readings, one.other_readings
    sigma2, dof, few, empty = _errors(one, factor)
    other = factor * one.other.value
    if one.variation is not None:
        bound = one.variation.bound
        other = other + np.clip(mine.value - other, -bound, bound)
    z = student_score((mine.value - other) / np.sqrt(sigma2), dof)
    if others is None:
        exact = _hits_score(mine, other, sigma2 - mine.error**2)
    elif np.any(one.other.std_err) or factor != 1:
        exact = np.full(z.shape, np.nan)
    else:
        exact = _two_hits_score(mine, others)
    # an exact probability that is too small for a score says only that z is large
    known = np.abs(exact) < MAX_EXACT_SCORE
    larger = np.where(np.abs(z) > np.abs(exact), z, exact)
    exact = np.where(known | np.isnan(exact), exact, larger)
    smaller = np.where(empty | (np.abs(exact) < np.abs(z)), exact, z)
    return np.where(few & np.isfinite(exact), smaller, z), np.sqrt(sigma2)


def _hits_score(mine: Readings, other: Floats, variance: Floats) -> Floats:
    """Score of the number of hits, if `other` and its variance tell their mean.

    Poisson's law, or the negative binomial where the mean itself follows a gamma
    distribution of that variance. NaN where the mean is not positive.
    """
    k, e = mine.hits, mine.exposure
    mean = np.where(other > 0, other * e, np.nan)
    spread = variance * e**2
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        shape = mean**2 / spread
        p = shape / (shape + mean)
        sure = spread < 1e-6 * mean
        below = np.where(
            sure, scipy.special.pdtr(k, mean), scipy.special.betainc(shape, k + 1, p)
        )
        poisson = scipy.special.pdtrc(np.maximum(k - 1, 0), mean)
        above = np.where(
            sure, poisson, scipy.special.betaincc(shape, np.maximum(k, 1), p)
        )
    below = np.maximum(below, _fewer_by_chance(mine, other))
    score = two_sided_score(below, np.where(k == 0, 1.0, above))
    # without hits, nothing speaks against a value of 0 or less
    return np.where((other <= 0) & (k == 0), 0.0, score)


def _fewer_by_chance(mine: Readings, other: Floats) -> Floats:
    """Probability of no more light than there is, if hits of great weight are missing.

    One of the `usual` weight may be, or as great as they are on average, each counted
    by its weight (Fay and Feuer 1997, Statistics in Medicine 16, 791): a few that weigh
    next to nothing tell as little as none.
    """
    rays = mine.exposure * mine.weight  # times the solid angle
    light, hits = rays * mine.value, np.maximum(mine.hits, 1)
    squares = np.maximum(rays * mine.error, light / np.sqrt(hits)) ** 2
    squares = np.where((mine.hits > 0) & (light > 0), squares, 0.0)
    mean = np.divide(squares, light, where=light > 0, out=np.zeros_like(light))
    missed = np.maximum(mine.usual, mean)
    light = np.maximum(light, 0.0)
    scale = (squares + missed**2) / (light + missed)
    expected = np.maximum(other, 0) * rays
    fewer: Floats = scipy.special.gammaincc((light + missed) / scale, expected / scale)
    return fewer


def _two_hits_score(mine: Readings, others: Readings) -> Floats:
    """Score of the hits of one record, given the sum of both: a binomial law."""
    a, b = mine.hits, others.hits
    # where there were few hits, the other record tells what one more is worth
    own, theirs = mine.exposure * mine.weight, others.exposure * others.weight
    one_more = (a * mine.weight + others.weight) / (a + 1)
    own = own / np.where(b > 0, one_more, mine.weight)
    one_more = (b * others.weight + mine.weight) / (b + 1)
    theirs = theirs / np.where(a > 0, one_more, others.weight)
    share = own / (own + theirs)
    below = np.where(
        b == 0, 1.0, scipy.special.betainc(np.maximum(b, 1), a + 1, 1 - share)
    )
    above = np.where(a == 0, 1.0, scipy.special.betainc(np.maximum(a, 1), b + 1, share))
    return np.where(a + b == 0, 0.0, two_sided_score(below, above))


def _trace_of_square(one: PointSet, sigma: Floats) -> float:
    """Trace of R^2 for the correlation R of the differences of a set's points.

    R is estimated from few batches: what chance adds to the squares of its entries,
    ``1 / dof`` of each, is taken off.
    """
    blocks = [r for r in (one.readings, one.other_readings) if r is not None]
    roots = [block.correlation(sigma) for block in blocks if len(block.residual) > 2]
    shares = [np.sum(root**2, axis=0) for root in roots]
    rest = 1 - sum(shares)  # what is independent between points
    trace = np.sum(rest**2)
    for i, (root, share) in enumerate(zip(roots, shares)):
        dof = len(root) - 1
        diagonal = np.sum(share**2)
        beside = np.sum((root @ root.T) ** 2) - diagonal
        chance = (np.sum(share) ** 2 - diagonal) / dof
        trace += diagonal + max(0.0, (beside - chance) * dof / (dof - 1))
        trace += 2 * np.sum(share * rest)
        for before in roots[:i]:
            trace += 2 * np.sum((root @ before.T) ** 2)
    return trace


def _p_value_of_largest(z: float, n: int) -> float:
    """Probability that the largest of `n` independent normal scores reaches `z`."""
    return float(-np.expm1(n * np.log1p(-min(2 * scipy.special.ndtr(-z), 1 - 1e-16))))

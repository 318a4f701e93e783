"""Scores of points that two sides have measured, and tests whether they agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy  # its parts are imported when used

from ...array_types import Flags, Floats
from ...results.statistics import student_score, two_sided_score
from ...single_precision import FEW_ROUNDINGS
from ..points import CountedPoints, Points
from .sum_of_squares import p_value_of_squares

# Below this many hits the mean of batches is too skewed for Student's t far out: its
# two-sided tail at 1e-5 is 1.3 times too heavy at 1000 hits, 4.4 times at 100.
MIN_STUDENT_HITS = 1000

# Exact probabilities below about 1e-295 are not told apart.
MAX_EXACT_SCORE = 36.7


@dataclass(eq=False)
class Variation:
    """How far points may be from the means over patches that they are compared with.

    `bound` is by how much at most, `hidden` the mean square of what the noise of the
    means hides of it, without bias: negative by chance.
    """

    bound: np.ndarray
    hidden: np.ndarray


@dataclass(eq=False)
class PointPairs:
    """Points of two sides at the same places, whose errors go together.

    Of a record those of one incident direction.

    Of the uncertainty of a common factor, which :func:`judge` fits, `other` has no
    part.
    """

    columns: dict[str, Any]  # directions and channel of the points
    mine: Points
    other: Points
    weight: Floats  # of each point in a total: in sr, or cosines of rows of tables
    total_of: list[Any]  # to which total each point belongs
    variation: Variation | None = None  # of means over patches beside points
    sharing: int = 1  # how many sets may have one noise, as copies of one direction


def judge(
    sets: Sequence[PointPairs], scale: float
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
        Normal scores, and the standard errors of the other side's values.
    statistics, p_values : dict of float
    """
    fitted = _fitted_scale(sets, scale)
    scores, errors, common, trace2 = [], [], [], 0.0
    totals: dict[object, _Total] = {}
    for one in sets:
        shared = scale * np.abs(one.other.value)
        z, sigma = _scores(one, 1 + fitted)
        scores.append(z)
        errors.append(np.hypot(one.other.error, shared))
        common.append(_common_roots(one, sigma))
        trace2 += one.sharing * _trace_of_square(one, sigma)
        for key in set(one.total_of):
            _add_total(totals.setdefault(key, _Total()), one, key, shared)
    trace2 += _trace_between(sets, common)
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
        "chi2": p_value_of_squares(chi2, trace2, np.hstack(common), most),
        "worst": _p_value_of_largest(worst, n),
        "total": _p_value_of_largest(statistics["total"], len(total)) if total else 1.0,
    }
    return z, np.concatenate(errors), statistics, p_values


def mostly_few(sets: Sequence[PointPairs]) -> bool:
    """Whether most points have fewer than `MIN_STUDENT_HITS` hits on either side."""
    few = np.concatenate([_errors(one, 1.0)[2] for one in sets])
    return bool(few.mean() > 0.5)


def _fitted_scale(sets: Sequence[PointPairs], scale: float) -> float:
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
        apart = one.mine.value - one.other.value
        pull += np.sum(one.other.value * apart * inverse)
        weight += np.sum(one.other.value**2 * inverse)
    return float(pull / weight)


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


def _add_total(total: _Total, one: PointPairs, key: object, shared: Floats) -> None:
    """Add the points of a set that belong to `key`."""
    weight = one.weight * np.array([own == key for own in one.total_of])
    sums = [side.total(weight) for side in (one.mine, one.other)]
    (value, _, _), (other, _, _) = sums
    total.difference += value - other
    total.variance += sum(variance for _, variance, _ in sums)
    total.variance += (FEW_ROUNDINGS * other) ** 2 + np.finfo(float).tiny
    total.welch += sum(welch for _, _, welch in sums)
    total.shared += shared @ weight
    total.hits += one.mine.hits @ (weight > 0)
    if one.variation is not None:
        total.bound += one.variation.bound @ weight
        total.hidden += one.variation.hidden @ weight, weight.sum()


def _errors(one: PointPairs, factor: float) -> tuple[Floats, Floats, Flags, Flags]:
    """Variance of each difference, its d.o.f. (Welch's), where few hits, where none."""
    mine, other = one.mine, one.other
    rounding = FEW_ROUNDINGS * factor * other.value
    sigma2 = mine.error**2 + other.error**2 + rounding**2
    if one.variation is not None:
        sigma2 = sigma2 + np.maximum(one.variation.hidden, 0)
    welch, dof = mine.welch + other.welch, np.full(len(sigma2), np.inf)
    np.divide(sigma2**2, welch, out=dof, where=welch > 0)
    dof = np.minimum(dof, np.minimum(mine.dof, other.dof))
    hits = np.minimum(mine.hits, other.hits)
    return sigma2, dof, hits < MIN_STUDENT_HITS, hits == 0


def _scores(one: PointPairs, factor: float) -> tuple[Floats, Floats]:
    """Normal score of each point's difference, and its standard error.

    The other's values are multiplied by `factor`.
    """
    mine, other = one.mine, one.other
    sigma2, dof, few, empty = _errors(one, factor)
    value = factor * other.value
    if one.variation is not None:
        bound = one.variation.bound
        value = value + np.clip(mine.value - value, -bound, bound)
    z = student_score((mine.value - value) / np.sqrt(sigma2), dof)
    exact = np.full(z.shape, np.nan)
    if isinstance(mine, CountedPoints) and isinstance(other, CountedPoints):
        if factor == 1 and not np.any(other.std_err):
            exact = _two_hits_score(mine, other)
    elif isinstance(mine, CountedPoints):
        exact = _hits_score(mine, value, sigma2)
    elif isinstance(other, CountedPoints) and factor == 1:
        exact = -_hits_score(other, mine.value, sigma2)
    # an exact probability that is too small for a score says only that z is large
    known = np.abs(exact) < MAX_EXACT_SCORE
    larger = np.where(np.abs(z) > np.abs(exact), z, exact)
    exact = np.where(known | np.isnan(exact), exact, larger)
    smaller = np.where(empty | (np.abs(exact) < np.abs(z)), exact, z)
    return np.where(few & np.isfinite(exact), smaller, z), np.sqrt(sigma2)


def _hits_score(mine: CountedPoints, other: Floats, sigma2: Floats) -> Floats:
    """Score of the number of hits, if `other` and its variance tell their mean.

    The variance is what a difference has beside that of the rays. Poisson's law, or the
    negative binomial where the mean itself follows a gamma distribution of that
    variance. NaN where the mean is not positive.
    """
    k, e = mine.hits, mine.exposure
    mean = np.where(other > 0, other * e, np.nan)
    spread = (sigma2 - mine.ray_error**2) * e**2
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


def _fewer_by_chance(mine: CountedPoints, other: Floats) -> Floats:
    """Probability of no more light than there is, if hits of great weight are missing.

    One of the `usual` weight may be, or as great as they are on average, each counted
    by its weight (Fay and Feuer 1997, Statistics in Medicine 16, 791): a few that weigh
    next to nothing tell as little as none.
    """
    rays = mine.exposure * mine.weight  # times the solid angle
    light, hits = rays * mine.value, np.maximum(mine.hits, 1)
    squares = np.maximum(rays * mine.ray_error, light / np.sqrt(hits)) ** 2
    squares = np.where((mine.hits > 0) & (light > 0), squares, 0.0)
    mean = np.divide(squares, light, where=light > 0, out=np.zeros_like(light))
    missed = np.maximum(mine.usual, mean)
    light = np.maximum(light, 0.0)
    scale = (squares + missed**2) / (light + missed)
    expected = np.maximum(other, 0) * rays
    fewer: Floats = scipy.special.gammaincc((light + missed) / scale, expected / scale)
    return fewer


def _two_hits_score(mine: CountedPoints, others: CountedPoints) -> Floats:
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


def _trace_of_square(one: PointPairs, sigma: Floats) -> float:
    """Trace of R^2 for the correlation R of the differences of a set's points.

    R is estimated from few batches: what chance adds to the squares of its entries,
    ``1 / dof`` of each, is taken off.
    """
    roots, dofs = zip(*(side.correlation(sigma) for side in (one.mine, one.other)))
    shares = [np.sum(root**2, axis=0) for root in roots]
    rest = 1 - sum(shares)  # what is independent between points
    trace = np.sum(rest**2) + 2 * np.sum((roots[0] @ roots[1].T) ** 2)
    for dof, root, share in zip(dofs, roots, shares):
        diagonal = np.sum(share**2)
        beside = np.sum((root @ root.T) ** 2) - diagonal
        chance = (np.sum(share) ** 2 - diagonal) / dof
        trace += diagonal + max(0.0, (beside - chance) / (1 - 1 / dof))
        trace += 2 * np.sum(share * rest)
    return float(trace)


def _common_roots(one: PointPairs, sigma: Floats) -> Floats:
    """Roots of the correlations that are common to all sets.

    A fit's parameters are off by the same at all directions; of what batches tell, each
    set has its own.
    """
    known = (side.correlation(sigma) for side in (one.mine, one.other))
    roots = [root for root, dof in known if np.isinf(dof)]
    return np.vstack([np.zeros((0, len(sigma))), *roots])


def _trace_between(sets: Sequence[PointPairs], common: Sequence[Floats]) -> float:
    """Contribution of common errors between sets to the trace of R^2.

    Copies of one direction have counted each other already, with all their errors.
    """
    squares = [root @ root.T for root in common]
    own = sum(one.sharing * np.sum(square**2) for one, square in zip(sets, squares))
    return max(float(np.sum(np.sum(squares, axis=0) ** 2) - own), 0.0)


def _p_value_of_largest(z: float, n: int) -> float:
    """Probability that the largest of `n` independent normal scores reaches `z`."""
    return float(-np.expm1(n * np.log1p(-min(2 * scipy.special.ndtr(-z), 1 - 1e-16))))

"""Four maps of a BSDF on the same patches, and scores of samples against integrals.

Counted directions and summed weights come from ``sample``, the other two are integrals
of ``pdf`` and ``eval``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import mitsuba as mi
import numpy as np
from scipy import special

from ..array_types import Floats, Integers
from ..collector import RingsAndSectors
from ..errors import SpecimenError
from ..results.statistics import two_sided_score
from .conditions import Condition
from .integrals import Expected, PatchIntegrals, integrals
from .probe import Probe
from .samples import rounding
from .tally import SMALL_TERM, Damping, PatchTotals, batch_of, groups, patch_totals

# Patches are merged until that many hits are due.
MIN_HITS = 100

# One sample in that many is a pilot, which chooses groups and limits of weights.
PILOT = 8

# Fraction of the variance of a sum that its heaviest weight may have where weights are
# not `eval` over `pdf`, so that only samples show how heavy they may be.
HEAVIEST_TERM = 4 * SMALL_TERM

# A random number has 2^23 values; at the two ends of three of them a formula may lose
# a sample, though no density says so.
END_ROUNDING = 6 * 2.0**-23

# Part of a variance below which nothing is left to chance: all samples are collected.
MIN_VARIANCE = 0.01

# Weights whose squares and cubes are 0 in single precision.
MIN_WEIGHT = 1e-12

# Score of a difference that chance cannot make.
IMPOSSIBLE_SCORE = 1e6

# Standard errors of a difference that are left to chance.
CHANCE = 3.0


@dataclass(frozen=True)
class Scores:
    """Normal scores of groups of patches.

    Attributes
    ----------
    z : ndarray, shape (n_groups,)
        NaN where it cannot be judged.
    first : ndarray of int, shape (n_groups,)
        Index of the first patch of each group.
    total : float
        Score of the sum of all patches.
    mean_variance : float
        Of the sum of `z`, over their number: less than 1, for a sample that is in one
        group is not in another.
    """

    z: Floats
    first: Integers
    total: float
    mean_variance: float = 1.0

    @property
    def p_values(self) -> dict[str, float]:
        """P-values of the total, mean and spread of scores, and of the worst."""
        z = self.z[np.isfinite(self.z)]
        n = len(z)
        views = {"total": 2 * special.ndtr(-abs(self.total))}
        if n and self.mean_variance > MIN_VARIANCE:
            scale = np.sqrt(n / self.mean_variance)
            views["mean"] = 2 * special.ndtr(-abs(z.mean()) * scale)
        if n:
            views["spread"] = special.chdtrc(n, float(z @ z))
            tail = 2 * special.ndtr(-np.abs(z).max())
            views["worst"] = -np.expm1(n * np.log1p(-min(tail, 1 - 1e-16)))
        return {view: float(p) for view, p in views.items()}

    @property
    def statistics(self) -> dict[str, str]:
        """Text on the statistic behind each of these p-values."""
        z = self.z[np.isfinite(self.z)]
        n = len(z)
        texts = {"total": f"z of the sum {_score(self.total)}"}
        if n:
            texts["mean"] = f"mean z {_score(z.mean())} of {n} groups of patches"
            texts["spread"] = f"mean z^2 {_score(z @ z / n)} of {n} groups of patches"
            worst = z[np.abs(z).argmax()]
            texts["worst"] = f"worst z {_score(worst)} of {n} groups of patches"
        return texts


def _score(z: Any) -> str:
    """Score as text; beyond 100, its sign only."""
    return f"{z:+.3g}" if abs(z) < 100 else f"beyond {np.sign(z) * 100:+.0f}"


@dataclass(frozen=True)
class FourMaps:
    """Sums over samples and integrals, by patch of both hemispheres.

    Attributes
    ----------
    condition : Condition
    subdivision : RingsAndSectors
    totals : PatchTotals
        Of samples; see there for the order of patches.
    due : Expected
        Integrals of ``pdf``, of damped weights, and of ``eval``.
    damping : Damping
        Of heavy weights.
    pdf_rounding, eval_rounding : float
        Relative error that single precision may leave in them.
    """

    condition: Condition
    subdivision: RingsAndSectors
    totals: PatchTotals
    due: Expected
    damping: Damping
    pdf_rounding: float
    eval_rounding: float

    @property
    def pdf(self) -> Floats:
        """Integral of ``pdf`` where ``eval`` is not black, by patch, (2 n_patches,)."""
        return self.due.counts.values

    @property
    def drawn(self) -> Floats:
        """Share of the samples by patch, shape (2 n_patches,)."""
        return self.totals.counts / self.totals.n

    @property
    def mass(self) -> float:
        """Integral of ``pdf``, also where ``eval`` is black."""
        return float(self.pdf.sum() + self.due.unused.values.sum())

    @property
    def weights(self) -> Floats:
        """Mean of the damped weight by patch, shape (2 n_patches,)."""
        return self.due.weights.values

    @property
    def smooth_flux(self) -> Floats:
        """Integral of ``eval``, shape (channels,)."""
        return np.array([one.values.sum() for one in self.due.channels])

    @property
    def smooth_bound(self) -> Floats:
        """Bound on the error of `smooth_flux`."""
        return np.array([one.sum_bound for one in self.due.channels])

    @property
    def pdf_sum_bound(self) -> float:
        """Bound on the error of the sum of `pdf`."""
        rounding = self.pdf_rounding * self.pdf.sum() + END_ROUNDING
        return self.due.counts.sum_bound + rounding

    @property
    def is_count_random(self) -> bool:
        """Whether chance moves the number of directions more than `pdf_sum_bound`.

        It does not if nearly all samples are collected: then the score tells the error
        of the integral, which repeats itself in the next map.
        """
        p = self.pdf.sum()
        return bool(p * (1 - p) / self.totals.n > self.pdf_sum_bound**2)

    @property
    def judged(self) -> float:
        """Share of the light of ``eval`` whose weights are light enough to judge."""
        flux = self.smooth_flux.mean()
        return min(1.0, self.weights.sum() / flux) if flux > 0 else 1.0

    @cached_property
    def count_scores(self) -> Scores:
        """Counted directions against the integral of ``pdf``."""
        drawn, n = self.totals, self.totals.n
        due, bound, variance = _with_errors(self.due.counts, self.pdf_rounding)
        first = groups(n * due, MIN_HITS)
        k, q, e, v = (_merged(x, first) for x in (drawn.counts, due, bound, variance))
        z = _binomial_score(k, n, q, e) / _widened(n * v, q * (1 - q))
        total = _binomial_score(drawn.counts.sum(), n, due.sum(), self.pdf_sum_bound)
        share = np.sqrt(q / np.maximum(1 - q, q))
        return Scores(z, first, float(total), _mean_variance(share))

    @property
    def misfit(self) -> float:
        """Mean squared score of the counts, plus the square of that of their sum."""
        scores = self.count_scores
        return float(np.sum(scores.z**2)) / max(len(scores.z), 1) + scores.total**2

    @cached_property
    def weight_scores(self) -> Scores:
        """Summed weights, damped, against their mean."""
        drawn, n, first = self.totals, self.totals.n, self.damping.first
        if drawn.sums.sum() <= 0 and self.weights.sum() <= 0:
            return Scores(np.zeros(0), np.zeros(0, int), 0.0)
        due, bound, variance = _with_errors(self.due.weights, self.eval_rounding)
        if drawn.is_ratio:
            squares, cubes = n * self.due.squares.values, n * self.due.cubes.values
        else:
            squares, cubes = drawn.squares, drawn.cubes
        columns = drawn.sums, due, squares, cubes, bound, variance
        merged = [_merged(x, first) for x in columns]
        z = _sum_score(n, *merged)
        left = np.maximum(merged[2] - n * merged[1] ** 2, merged[2] * MIN_VARIANCE)
        share = merged[1] * np.sqrt(n / np.where(left > 0, left, np.inf))
        if not drawn.is_ratio and first.size:
            # how heavy tails are can only be seen in the samples themselves
            heaviest = np.maximum.reduceat(drawn.largest, first) ** 2
            z[heaviest > HEAVIEST_TERM * _merged(drawn.squares, first)] = np.nan
        total = [float(column.sum()) for column in columns]
        total[4] = self.due.weights.sum_bound + self.eval_rounding * total[1]
        total[5] = 0.0  # in that bound
        total = _sum_score(n, *map(np.atleast_1d, total))[0]
        kept = np.isfinite(z)
        return Scores(z, first, float(total), _mean_variance(share[kept]))

    def scores(self, name: str) -> Scores:
        """Scores by which the property ``sampling`` or ``weights`` is judged."""
        return self.count_scores if name == "sampling" else self.weight_scores


def four_maps(
    bsdf: mi.BSDF,
    condition: Condition,
    subdivision: RingsAndSectors,
    n: int,
    key: tuple[int, ...],
) -> FourMaps | None:
    """Draw samples and integrate; None if the integrals do not converge."""
    pilot = batch_of(bsdf, condition, subdivision, n // PILOT, (*key, 3))
    damping = Damping.of(pilot, 2 * subdivision.n_patches, n)
    totals = patch_totals(bsdf, condition, subdivision, n, key, damping)
    probe = Probe(bsdf, condition)
    try:
        due = integrals(probe, subdivision, totals, damping.limits)
    except SpecimenError:
        return None
    return FourMaps(condition, subdivision, totals, due, damping, *rounding(probe, key))


def in_radiance_mode(bsdf: mi.BSDF, maps: FourMaps, key: tuple[int, ...]) -> FourMaps:
    """Maps of new samples in radiance mode, of a BSDF whose integrals stay the same."""
    condition = replace(maps.condition, mode="radiance")
    patches, n = maps.subdivision, maps.totals.n
    totals = patch_totals(bsdf, condition, patches, n, key, maps.damping)
    return replace(maps, condition=condition, totals=totals)


def unexplained_fraction(maps: FourMaps, name: str) -> tuple[float, float]:
    """Fraction of the whole that is wrong, and the relative surplus of samples.

    Parameters
    ----------
    maps : FourMaps
    name : {"sampling", "weights"}
        Samples against ``pdf``, or sampled light against ``eval``.

    Returns
    -------
    fraction : float
        Too much or too little, or in other patches than is due, less what chance
        explains.
    surplus : float
        Of samples over integrals, times the cosine of wi.
    """
    n, scores = maps.totals.n, maps.scores(name)
    drawn, due = maps.totals.sums / n, maps.weights
    if name == "sampling":
        drawn, due = maps.drawn, maps.pdf
    whole = max(drawn.sum(), due.sum())
    gain = (drawn - due).sum()
    surplus = float(abs(maps.condition.wi[2]) * gain / max(whole, 1e-30))
    if not whole > 0:
        return 0.0, surplus
    total = abs(drawn.sum() - due.sum()) * _certain(np.array(scores.total))
    elsewhere = 0.0
    if scores.first.size:
        off = np.abs(np.add.reduceat(drawn - due, scores.first))
        elsewhere = float(np.sum(off * _certain(scores.z))) / 2
    return float(max(total, elsewhere) / whole), surplus


def unexplained_light(maps: FourMaps, name: str, max_p: float) -> float:
    """Bound on the light where samples are too many or few, over all of ``eval``.

    That of a patch, times how much of the samples or of their light is wrong there; and
    all that is too rare to judge. Where p-values of the mean or the spread of scores
    are below `max_p`, what all patches share is wrong, though chance explains each.
    """
    n, flux = maps.totals.n, np.mean([one.values for one in maps.due.channels], axis=0)
    drawn, due = maps.totals.sums / n, maps.weights
    if name == "sampling":
        drawn, due = maps.drawn, maps.pdf
    whole, scores = float(flux.sum()), maps.scores(name)
    if not (whole > 0 and scores.first.size):
        return 1.0
    columns = drawn - due, due, flux
    off, expected, light = (np.add.reduceat(x, scores.first) for x in columns)
    z, p = np.nan_to_num(scores.z), scores.p_values
    common = float(abs(z.mean())) if p.get("mean", 1.0) < max_p else 0.0
    if p.get("spread", 1.0) < max_p:
        spread = max(float(np.mean(z * z)) - 1, 0.0)
        common = max(common, spread**0.5)
    std_err = np.abs(off) / np.maximum(np.abs(z), 1e-30)
    off = np.maximum(np.abs(off) * _certain(z), std_err * common * (z != 0))
    off = np.minimum(off / np.maximum(expected, 1e-30), 1.0)
    return min(float(off @ light) / whole + 1 - maps.judged, 1.0)


def _certain(z: Floats) -> Floats:
    """Part of a difference with the score `z` that chance does not explain."""
    return np.maximum(1 - CHANCE / np.maximum(np.abs(np.nan_to_num(z)), CHANCE), 0)


def _with_errors(due: PatchIntegrals, relative: float) -> tuple[Floats, Floats, Floats]:
    """Values of integrals, bounds on their errors that include rounding, variances."""
    return due.values, due.bound + relative * np.abs(due.values), due.std_err**2


def _widened(variance: Floats, by_chance: Floats) -> Floats:
    """Standard deviation of a score that has a second error of that `variance`."""
    return np.sqrt(1 + variance / np.maximum(by_chance, variance + 1e-300))


def _mean_variance(share: Floats) -> float:
    """Variance of the sum of scores, over their number.

    Sums over two groups have the covariance -n m m', with the means m of a sample in
    each; `share` is sqrt(n) m over the standard deviation of its sum.
    """
    n = max(len(share), 1)
    return float(1 + (np.sum(share**2) - np.sum(share) ** 2) / n)


def _merged(values: Floats, first: Integers) -> Floats:
    return np.add.reduceat(values, first) if first.size else np.zeros(0)


def _binomial_score(
    k: Floats | float, n: int, q: Floats | float, error: Floats | float
) -> Floats:
    """Normal score of the exact binomial tail; `q` is known within `error`."""
    k = np.asarray(k, dtype=float)
    # the probability within the error that suits best
    p = np.clip(np.clip(k / n, q - error, q + error), 0, 1)
    variance = np.maximum(n * p * (1 - p), np.finfo(float).tiny)
    at_most = np.where(k >= n, 1.0, special.bdtr(np.minimum(k, n - 1), n, p))
    at_least = np.where(k <= 0, 1.0, special.bdtrc(np.maximum(k - 1, 0), n, p))
    exact = two_sided_score(at_most, at_least)
    # far out, where probabilities underflow, and for samples that cannot vary
    rough = (k - n * p) / np.sqrt(variance)
    far = (np.abs(rough) > 8) | ~np.isfinite(exact)
    return np.where(k == n * p, 0.0, np.where(far, np.clip(rough, -1e6, 1e6), exact))


def _sum_score(
    n: int,
    w: Floats,
    due: Floats,
    squares: Floats,
    cubes: Floats,
    error: Floats,
    variance: Floats,
) -> Floats:
    """Normal score of sums of weights; `due` is known within `error`.

    As a gamma variable, shifted, of the same mean, variance and skewness as the sum of
    `n` terms, whose powers have the sums `squares` and `cubes`. `variance` is that of
    `due`.
    """
    mean = np.clip(w / n, due - error, due + error)
    spread = np.maximum(squares - n * mean**2, 0)
    third = cubes - 3 * mean * squares + 2 * n * mean**3
    rounding = np.finfo(np.float32).eps * np.maximum(np.abs(w), n * np.abs(mean))
    rounding += n * MIN_WEIGHT
    sigma = np.sqrt(spread + n**2 * variance + rounding**2)
    rough = np.divide(w - n * mean, sigma, out=np.zeros_like(w), where=sigma > 0)
    rough = np.where((sigma == 0) & (w != n * mean), IMPOSSIBLE_SCORE, rough)
    skewness = np.divide(third, sigma**3, out=np.zeros_like(w), where=sigma > 0)
    # no weight is heavy enough for more; beyond, it is the rounding of nearly nothing
    skewness = np.clip(skewness, -np.sqrt(HEAVIEST_TERM), np.sqrt(HEAVIEST_TERM))
    return np.where(w == n * mean, 0.0, skew_score(rough, skewness))


def skew_score(z: Floats, skewness: Floats) -> Floats:
    """Normal score with the tail probability of a shifted gamma variable at `z`."""
    turned = np.sign(skewness) * z
    shape = 4 / np.maximum(np.abs(skewness), 1e-9) ** 2
    x = np.maximum(shape + turned * np.sqrt(shape), 0.0)
    exact = two_sided_score(special.gammainc(shape, x), special.gammaincc(shape, x))
    normal = (np.abs(skewness) < 1e-3) | (np.abs(z) > 8) | ~np.isfinite(exact)
    return np.where(normal, z, np.sign(skewness) * exact)

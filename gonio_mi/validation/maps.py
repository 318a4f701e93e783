"""Four maps of a BSDF on the same patches, and the scores of the drawn against the due.

Counted directions and summed weights come from ``sample``, the other two are integrals
of ``pdf`` and ``eval``.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import special

from ..collector import Subdivision
from ..errors import SpecimenError
from ..results.normal_scores import two_sided_score
from .collecting import rounding
from .drawing import Totals, count
from .integrals import Integrals, integrals
from .probe import Probe

__all__ = ["FourMaps", "Scores", "four_maps"]

# Patches are merged until that many equivalent hits are due.
ENOUGH_HITS = 100


@dataclass(frozen=True)
class Scores:
    """Normal scores of groups of patches.

    Attributes
    ----------
    z : ndarray, shape (n_groups,)
    first : ndarray of int, shape (n_groups,)
        Index of the first patch of each group.
    total : float
        Score of the sum of all patches.
    """

    z: np.ndarray
    first: np.ndarray
    total: float

    @property
    def p_values(self):
        """Probability of such scores by chance: of mean, spread, worst and total."""
        z, n = self.z, len(self.z)
        views = {"total": 2 * special.ndtr(-abs(self.total))}
        if n:
            views["mean"] = 2 * special.ndtr(-abs(z.mean()) * np.sqrt(n))
            views["spread"] = special.chdtrc(n, float(z @ z))
            tail = 2 * special.ndtr(-np.abs(z).max())
            views["worst"] = -np.expm1(n * np.log1p(-min(tail, 1 - 1e-16)))
        return {view: float(p) for view, p in views.items()}

    @property
    def statistics(self):
        """What each view is judged by, as text."""
        z, n = self.z, len(self.z)
        texts = {"total": f"z of the sum {self.total:+.1f}"}
        if n:
            texts["mean"] = f"mean z {z.mean():+.2f} of {n} patches"
            texts["spread"] = f"mean z^2 {z @ z / n:.2f} of {n} patches"
            texts["worst"] = f"worst z {z[np.abs(z).argmax()]:+.1f} of {n} patches"
        return texts


@dataclass(frozen=True)
class FourMaps:
    """What is drawn and what is due, by patch of both hemispheres.

    Attributes
    ----------
    condition : Condition
    subdivision : Subdivision
    totals : Totals
        Drawn; see there for the order of patches.
    due_counts, due_weights : Integrals
        Of ``pdf``, and of the mean over channels of ``eval``.
    pdf_rounding, eval_rounding : float
        Relative error that single precision may leave in them.
    smooth_flux : ndarray, shape (channels,)
        Sum of the integral of ``eval``, for each channel.
    smooth_bound : ndarray, shape (channels,)
        Within which that is right.
    """

    condition: object
    subdivision: Subdivision
    totals: Totals
    due_counts: Integrals
    due_weights: Integrals
    pdf_rounding: float
    eval_rounding: float
    smooth_flux: np.ndarray
    smooth_bound: np.ndarray

    @property
    def pdf(self):
        """Integral of ``pdf`` by patch, shape (2 n_patches,)."""
        return self.due_counts.values

    @property
    def eval(self):
        """Integral of the mean over channels of ``eval``, shape (2 n_patches,)."""
        return self.due_weights.values

    @property
    def pdf_sum_bound(self):
        """Within which the sum of `pdf` is right."""
        return self.due_counts.sum_bound + self.pdf_rounding * self.pdf.sum()

    @cached_property
    def count_scores(self):
        """Counted directions against the integral of ``pdf``."""
        drawn, n = self.totals, self.totals.n
        due, bound, variance = _uncertain(self.due_counts, self.pdf_rounding)
        first = _groups(n * due)
        k, q, e, v = (_merged(x, first) for x in (drawn.counts, due, bound, variance))
        z = _binomial_score(k, n, q, e) / _widened(n * v, q * (1 - q))
        total = _binomial_score(drawn.counts.sum(), n, due.sum(), self.pdf_sum_bound)
        return Scores(z, first, float(total))

    @cached_property
    def weight_scores(self):
        """Summed weights against the integral of ``eval``."""
        drawn, n = self.totals, self.totals.n
        if drawn.sums.sum() <= 0 and self.eval.sum() <= 0:
            return Scores(np.zeros(0), np.zeros(0, int), 0.0)
        usual = drawn.usual_weight
        due, bound, variance = _uncertain(self.due_weights, self.eval_rounding)
        first = _groups(n * due / usual)
        w, w2, q, e, v = (
            _merged(x, first) for x in (drawn.sums, drawn.squares, due, bound, variance)
        )
        z = _weight_score(w, w2, n, q, e, usual) / _widened(n * v, w2 / n)
        sums = (x.sum(keepdims=True) for x in (drawn.sums, drawn.squares))
        sum_bound = self.due_weights.sum_bound + self.eval_rounding * due.sum()
        total = _weight_score(*sums, n, due.sum(keepdims=True), sum_bound, usual)
        return Scores(z, first, float(total[0]))


def four_maps(bsdf, condition, subdivision, n, key):
    """Draw, integrate and return :class:`FourMaps`, or None if it does not converge."""
    totals = count(bsdf, condition, subdivision, n, key)
    probe = Probe(bsdf, condition)
    try:
        due_counts, *channels = integrals(probe, subdivision, totals)
    except SpecimenError:
        return None
    return FourMaps(
        condition,
        subdivision,
        totals,
        due_counts,
        Integrals.mean(channels),
        *rounding(probe, key),
        np.array([one.values.sum() for one in channels]),
        np.array([one.sum_bound for one in channels]),
    )


def _uncertain(due, relative):
    """Values of integrals, bounds of their errors with those of rounding, variances."""
    return due.values, due.bound + relative * np.abs(due.values), due.std_err**2


def _widened(variance, by_chance):
    """Standard deviation of a score that has a second random error."""
    return np.sqrt(1 + variance / np.maximum(by_chance, variance + 1e-300))


def _groups(due):
    """First patch of each group of consecutive patches with enough hits due."""
    starts, total = [], ENOUGH_HITS
    for i, hits in enumerate(due.tolist()):
        if total >= ENOUGH_HITS:
            starts.append(i)
            total = 0.0
        total += hits
    if total < ENOUGH_HITS:
        starts.pop()
    return np.array(starts, dtype=int)


def _merged(values, first):
    return np.add.reduceat(values, first) if first.size else np.zeros(0)


def _binomial_score(k, n, q, error):
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


def _weight_score(w, w2, n, due, error, usual):
    """Normal score of sums of weights; `due` is known within `error`.

    As a Poisson variable of the same relative variance (Bohm and Zech 2014, Nucl.
    Instrum. Methods A 748, 1), which is skew as the sum itself is; where the sum varies
    less than that, because nearly all samples contribute, by its variance.
    """
    mean = np.clip(w / n, due - error, due + error)
    scale = np.where(w > 0, w2 / np.where(w > 0, w, 1), usual)
    # a sum that is too small for want of heavy weights
    scale = np.maximum(scale, np.where(mean * n > w, 0.5 * usual, 0))
    variance = np.maximum(scale * np.maximum(w, n * mean) - n * mean**2, 0)
    rounding = np.finfo(np.float32).eps * np.maximum(np.abs(w), n * np.abs(mean))
    rough = (w - n * mean) / np.sqrt(variance + rounding**2)
    hits, expected = w / scale, np.maximum(n * mean / scale, 0)
    at_most = special.gammaincc(hits + 1, expected)
    at_least = special.gammainc(np.maximum(hits, 1e-9), expected)
    exact = two_sided_score(at_most, at_least)
    normal = (hits > 1000) | (np.abs(rough) > 8) | ~np.isfinite(exact)
    return np.where(w == n * mean, 0.0, np.where(normal, rough, exact))

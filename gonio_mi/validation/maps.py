"""Four maps of a BSDF on the same patches, and the scores of the drawn against the due.

Counted directions and summed weights come from ``sample``, the integrals of ``pdf`` and
``eval`` from converged quadrature.
"""

from dataclasses import dataclass
from functools import cached_property

import drjit as dr
import numpy as np
from scipy import special

from ..errors import SpecimenError
from ..quadrature import integrate
from ..subdivision import Subdivision
from .drawing import Totals, count
from .probe import Probe

__all__ = ["FourMaps", "Scores", "four_maps"]

# Patches are merged until that many equivalent hits are due.
ENOUGH_HITS = 100

# What the integrals are converged to, relative to a patch, and what may remain of the
# total where kinks hide from the rule's own estimate: a fifth of that was seen.
REL_ERR = 1e-3
PRECISION = 1e-4


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
    pdf, eval : ndarray, shape (2 n_patches,)
        Integrals of ``pdf`` and of the mean over channels of ``eval``.
    pdf_error, eval_error : ndarray, same shape
        Their estimated errors.
    smooth_flux : ndarray, shape (channels,)
        Sum of the integral of ``eval``, for each channel.
    """

    condition: object
    subdivision: Subdivision
    totals: Totals
    pdf: np.ndarray
    pdf_error: np.ndarray
    eval: np.ndarray
    eval_error: np.ndarray
    smooth_flux: np.ndarray

    @cached_property
    def count_scores(self):
        """Counted directions against the integral of ``pdf``."""
        drawn, n = self.totals, self.totals.n
        first = _groups(n * self.pdf)
        k, q, e = (_merged(x, first) for x in (drawn.counts, self.pdf, self._slack()))
        total = _binomial_score(
            drawn.counts.sum(), n, self.pdf.sum(), self._slack().sum()
        )
        return Scores(_binomial_score(k, n, q, e), first, float(total))

    @cached_property
    def weight_scores(self):
        """Summed weights against the integral of ``eval``."""
        drawn, n = self.totals, self.totals.n
        squares, sums = drawn.squares.sum(), drawn.sums.sum()
        if sums <= 0 and self.eval.sum() <= 0:
            return Scores(np.zeros(0), np.zeros(0, int), 0.0)
        usual = squares / sums if sums > 0 else 1.0
        error = self.eval_error + PRECISION * np.abs(self.eval)
        first = _groups(n * self.eval / usual)
        w, w2, due, e = (
            _merged(x, first) for x in (drawn.sums, drawn.squares, self.eval, error)
        )
        z = _weight_score(w, w2, n, due, e, usual)
        total = _weight_score(
            *(np.array([x]) for x in (sums, squares)),
            n,
            np.array([self.eval.sum()]),
            np.array([error.sum()]),
            usual,
        )
        return Scores(z, first, float(total[0]))

    def _slack(self):
        return self.pdf_error + PRECISION * np.abs(self.pdf)


def four_maps(bsdf, condition, subdivision, n, key):
    """Draw, integrate and return :class:`FourMaps`, or None if it does not converge."""
    totals = count(bsdf, condition, subdivision, n, key)
    view = _Integrand(Probe(bsdf, condition))
    try:
        found = integrate(
            view,
            condition.theta_i,
            condition.phi_i,
            subdivision,
            rel_err=REL_ERR,
            side=condition.side,
        )
    except SpecimenError:
        return None
    flux = found.flux.reshape(2 * subdivision.n_patches, -1)
    error = found.error.reshape(flux.shape)
    return FourMaps(
        condition,
        subdivision,
        totals,
        flux[:, 0],
        error[:, 0],
        flux[:, 1:].mean(axis=1),
        error[:, 1:].mean(axis=1),
        flux[:, 1:].sum(axis=0),
    )


class _Integrand:
    """A BSDF to :func:`integrate`, whose channels are its density and its values."""

    def __init__(self, probe):
        self.probe = probe

    def class_name(self):
        return self.probe.bsdf.class_name()

    def sample(self, _, si, sample1, sample2):
        del si
        one = self.probe.sample(sample1, sample2)
        return one.bs, one.weight

    def eval(self, _, si, wo):
        del si
        pdf, value = self.probe.pdf(wo), self.probe.eval(wo)
        # what is not finite has a property of its own
        return [dr.select(dr.isfinite(x), x, 0.0) for x in (pdf, *value)]


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
    exact = _two_sided(at_most, at_least)
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
    exact = _two_sided(at_most, at_least)
    normal = (hits > 1000) | (np.abs(rough) > 8) | ~np.isfinite(exact)
    return np.where(w == n * mean, 0.0, np.where(normal, rough, exact))


def _two_sided(below, above):
    """Normal score from the probabilities of at most and at least what was seen."""
    p = np.minimum(2 * np.minimum(below, above), 1.0)
    size = -special.ndtri(np.maximum(p / 2, 1e-300))
    return np.where(below < above, -size, size)

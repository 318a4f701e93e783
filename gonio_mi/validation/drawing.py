"""Samples of a BSDF, counted and summed by patch."""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..transport.arrays import DRJIT
from .probe import Probe, numbers, spectral

__all__ = ["Totals", "count", "seed_of", "uniform"]

# Samples of one launch, whose values come back one by one.
CHUNK = 2**20


@dataclass
class Totals:
    """Sums over all samples of one condition, by patch of both hemispheres.

    Patch ``k`` of the lit side has index ``k``, of the other ``n_patches + k``. What
    goes into a discrete direction is in no patch.

    Attributes
    ----------
    n : int
        Number of samples.
    counts, sums, squares : ndarray, shape (2 n_patches,)
        Number of samples in each patch, and the sums of their weights, a mean over
        channels, and of the squares of these.
    mean, variance : ndarray, shape (channels,)
        Of the weight of a sample, with those in discrete directions.
    delta_mean : ndarray, shape (channels,)
        What discrete directions have of `mean`.
    peaks : ndarray, shape (2 n_patches,)
        Greatest density of a sample in each patch.
    """

    n: int
    counts: np.ndarray
    sums: np.ndarray
    squares: np.ndarray
    mean: np.ndarray
    variance: np.ndarray
    delta_mean: np.ndarray
    peaks: np.ndarray

    @property
    def usual_weight(self):
        """Weight that most light is in: the mean, weighed by weights."""
        sums = self.sums.sum()
        return self.squares.sum() / sums if sums > 0 else 1.0


def count(bsdf, condition, subdivision, n, key):
    """Draw `n` independent samples and add them up by patch.

    Parameters
    ----------
    bsdf : mi.BSDF
    condition : Condition
    subdivision : Subdivision
    n : int
    key : tuple of int
        What tells these random numbers from all others.

    Returns
    -------
    Totals
    """
    probe = Probe(bsdf, condition)
    m = subdivision.n_patches
    face = 1.0 if condition.side == "front" else -1.0
    counts, sums, squares, peaks = (np.zeros(2 * m + 1) for _ in range(4))
    first, second, delta_first = 0.0, 0.0, 0.0
    for begin in range(0, n, CHUNK):
        size = min(CHUNK, n - begin)
        sample1, sample2 = uniform(size, (*key, begin))
        one = probe.sample(sample1, sample2)
        wo = one.bs.wo
        smooth = ~one.delta & _is_counted(probe, one)
        index = subdivision.patch_index(DRJIT, wo.x, wo.y, dr.abs(wo.z))
        index = dr.clip(index, 0, m - 1) + dr.select(face * wo.z < 0, float(m), 0.0)
        index = dr.select(smooth, mi.UInt32(index), 2 * m)
        delta = one.delta
        dr.eval(index, one.weight, one.bs.pdf, delta)
        index, weight = numbers(index, size), spectral(one.weight, size)
        weight = np.where(np.isfinite(weight), weight, 0.0)
        mean = weight.mean(axis=1)
        counts += np.bincount(index, minlength=2 * m + 1)
        sums += np.bincount(index, mean, minlength=2 * m + 1)
        squares += np.bincount(index, mean**2, minlength=2 * m + 1)
        np.maximum.at(peaks, index, numbers(one.bs.pdf, size))
        first = first + weight.sum(axis=0)
        second = second + (weight**2).sum(axis=0)
        delta_first = delta_first + weight[numbers(delta, size)].sum(axis=0)
    variance = np.maximum(second / n - (first / n) ** 2, 0)
    return Totals(
        n,
        counts[:-1],
        sums[:-1],
        squares[:-1],
        first / n,
        variance,
        delta_first / n,
        peaks[:-1],
    )


def _is_counted(probe, one):
    """Whether ``sample`` gave a direction; a zero weight means that it failed.

    Unless the BSDF is black there, and its density nevertheless positive.
    """
    given = dr.any(one.weight != 0)
    black = (one.bs.pdf > 0) & dr.all(probe.eval(one.bs.wo) == 0)
    return (given | (black & (probe.pdf(one.bs.wo) > 0))) & dr.isfinite(one.bs.wo.z)


def uniform(n, key):
    """Independent uniform numbers for ``sample``."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed_of(key), n)
    return sampler.next_1d(), sampler.next_2d()


def seed_of(key):
    """32-bit seed from a tuple of whole numbers, well mixed, no literal of a kernel."""
    seed = int(np.random.SeedSequence(key).generate_state(1)[0])
    return dr.opaque(mi.UInt32, seed)

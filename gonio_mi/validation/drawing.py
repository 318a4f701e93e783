"""Samples of a BSDF, counted and summed by patch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats, Integers
from ..collector.hemisphere import RingsAndSectors
from ..transport.arrays import DRJIT
from .conditions import Condition
from .damping import Damping
from .equality import FEW, unequal
from .probe import Probe, numbers, spectral

__all__ = ["Samples", "Totals", "count", "draw", "patch_of", "seed_of", "uniform"]

# Samples of one launch, whose values come back one by one.
CHUNK = 2**20

# The golden ratio of 2^32, whose multiples are spread evenly.
GOLDEN = 2654435769


@dataclass
class Totals:
    """Sums over all samples of one condition, by patch of both hemispheres.

    Patch ``k`` of the lit side has index ``k``, of the other ``n_patches + k``. What
    goes into a discrete direction is in no patch. Weights are means over channels,
    damped by :class:`Damping` where one is given.

    Attributes
    ----------
    n : int
        Number of samples.
    counts, sums, squares, cubes, largest : ndarray, shape (2 n_patches,)
        Number of samples in each patch, sums of their damped weights and of the second
        and third powers of these, and the largest.
    mean, variance : ndarray, shape (channels,)
        Of the weight of a sample, with those in discrete directions.
    delta_mean : ndarray, shape (channels,)
        What discrete directions have of `mean`.
    peaks : ndarray, shape (2 n_patches,)
        Greatest density of a sample in each patch.
    is_ratio : bool
        Whether weights are ``eval`` over ``pdf``, but for so few samples as rounding
        may spoil.
    """

    n: int
    counts: Floats
    sums: Floats
    squares: Floats
    cubes: Floats
    largest: Floats
    mean: Floats
    variance: Floats
    delta_mean: Floats
    peaks: Floats
    is_ratio: bool


def count(
    bsdf: mi.BSDF,
    condition: Condition,
    subdivision: RingsAndSectors,
    n: int,
    key: tuple[int, ...],
    damping: Damping | None = None,
) -> Totals:
    """Draw `n` independent samples and add them up by patch.

    Parameters
    ----------
    bsdf : mi.BSDF
    condition : Condition
    subdivision : RingsAndSectors
    n : int
    key : tuple of int
        What tells these random numbers from all others.
    damping : Damping, optional
        Of heavy weights.

    Returns
    -------
    Totals
    """
    m = 2 * subdivision.n_patches
    counts, sums, squares, cubes, peaks, largest = (np.zeros(m + 1) for _ in range(6))
    first, second, delta_first, n_other = 0.0, 0.0, 0.0, 0
    for begin in range(0, n, CHUNK):
        size = min(CHUNK, n - begin)
        drawn = draw(bsdf, condition, subdivision, size, (*key, begin))
        factor = 1.0 if damping is None else damping.factors(drawn)
        mean = drawn.weight.mean(axis=1) * factor
        index = drawn.index
        counts += np.bincount(index, minlength=m + 1)
        for total, power in ((sums, 1), (squares, 2), (cubes, 3)):
            total += np.bincount(index, mean**power, minlength=m + 1)
        np.maximum.at(largest, index, mean)
        np.maximum.at(peaks, index, drawn.sampled_pdf)
        first = first + drawn.weight.sum(axis=0)
        second = second + (drawn.weight**2).sum(axis=0)
        delta_first = delta_first + drawn.weight[drawn.delta].sum(axis=0)
        other = unequal(drawn.weight.mean(axis=1), drawn.ratio, 0.0)
        n_other += int(np.count_nonzero(other & (index < m)))
    variance = np.maximum(second / n - (first / n) ** 2, 0)
    by_patch = counts[:-1], sums[:-1], squares[:-1], cubes[:-1], largest[:-1]
    moments: tuple[Any, Any, Any] = (first / n, variance, delta_first / n)
    return Totals(n, *by_patch, *moments, peaks[:-1], n_other <= max(2, FEW * n))


@dataclass
class Samples:
    """Samples of one launch: arrays of ``(n,)``; `weight` is ``(n, channels)``.

    Attributes
    ----------
    index : ndarray of int
        Patch; that after the last for what is in none.
    weight, sampled_pdf, delta : ndarray
    ratio : ndarray
        ``eval`` over ``pdf`` at the direction, a mean over channels.
    """

    index: Integers
    weight: Floats
    sampled_pdf: Floats
    delta: Flags
    ratio: Floats


def draw(
    bsdf: mi.BSDF,
    condition: Condition,
    subdivision: RingsAndSectors,
    n: int,
    key: tuple[int, ...],
) -> Samples:
    """Draw `n` samples and return :class:`Samples`; values that are infinite are 0."""
    probe = Probe(bsdf, condition)
    m = subdivision.n_patches
    one = probe.sample(*uniform(n, key))
    wo, delta = one.bs.wo, one.delta
    value, pdf = probe.eval_and_pdf(wo)
    # a weight of zero means that sample failed, or that the BSDF is black there
    counted = ~delta & dr.any(one.weight != 0) & dr.isfinite(wo.z)
    wo = _with_azimuth(wo, n)
    index = dr.select(counted, patch_of(subdivision, condition, wo), 2 * m)
    dr.eval(index, delta)
    weight, density = spectral(one.weight, n), numbers(pdf, n).astype(float)
    ratio = np.full(n, np.inf)
    np.divide(spectral(value, n).mean(axis=1), density, out=ratio, where=density > 0)
    return Samples(
        numbers(index, n),
        np.where(np.isfinite(weight), weight, 0.0),
        numbers(one.bs.pdf, n),
        numbers(delta, n),
        ratio,
    )


def _with_azimuth(wo: mi.Vector3f, n: int) -> mi.Vector3f:
    """Directions that round to a pole, which is in no sector, go to all in turn."""
    turn = dr.two_pi * 2.0**-32 * mi.Float(GOLDEN * dr.arange(mi.UInt32, n))
    lost = (wo.x == 0) & (wo.y == 0)
    x, y = (1e-9 * f(turn) for f in (dr.cos, dr.sin))
    return mi.Vector3f(dr.select(lost, x, wo.x), dr.select(lost, y, wo.y), wo.z)


def patch_of(
    subdivision: RingsAndSectors, condition: Condition, wo: mi.Vector3f
) -> mi.UInt32:
    """Index of the patch of each direction, as of :class:`Totals`."""
    m = subdivision.n_patches
    face = 1.0 if condition.side == "front" else -1.0
    index = subdivision.patch_index(DRJIT, wo.x, wo.y, dr.abs(wo.z))
    index = dr.clip(index, 0, m - 1) + dr.select(face * wo.z < 0, float(m), 0.0)
    return mi.UInt32(index)


def uniform(n: int, key: tuple[int, ...]) -> tuple[mi.Float, mi.Point2f]:
    """Independent uniform numbers for ``sample``."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed_of(key), n)
    return sampler.next_1d(), sampler.next_2d()


def seed_of(key: tuple[int, ...]) -> mi.UInt32:
    """32-bit seed from a tuple of whole numbers, well mixed, no literal of a kernel."""
    seed = int(np.random.SeedSequence(key).generate_state(1)[0])
    return dr.opaque(mi.UInt32, seed)

"""Counts of samples and sums of their damped weights, by patch.

A weight may be far above the mean, up to an infinite variance: then the sum of a finite
number of samples is nearly always too small, and so is its standard error. So each
weight W of a direction is multiplied by min(1, c / r), where r is ``eval`` over ``pdf``
there. Whatever the number c, the mean of that is known: the integral of
min(``eval``, c ``pdf``), a bounded function. As c we take the largest for which a
sum is as good as normal.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats, Integers, Numbers
from ..collector.hemisphere import RingsAndSectors
from ..transport.collector_sphere import DRJIT
from .conditions import Condition
from .probe import Probe, numbers, spectral, uniform
from .samples import SPOILED, unequal

# Samples of one launch, whose values come back one by one.
CHUNK = 2**20

# The golden ratio of 2^32, whose multiples are spread evenly.
GOLDEN = 2654435769

# A sum of independent terms is as good as normal if none is more than a tenth of its
# standard deviation: its skewness is less than that, and the error of the normal law
# (Esseen 1956) less than 0.05, which the skewness explains nearly all of. This is the
# square of 1/10: c^2 = SMALL_TERM n m2(c), with m2 the mean square of a damped weight.
SMALL_TERM = 0.01

# Hits that a group of patches must have: four times as many as equal weights need.
MIN_HITS = 4 / SMALL_TERM


@dataclass
class Batch:
    """Samples of one launch: arrays of ``(n,)``; `weight` is ``(n, channels)``.

    Attributes
    ----------
    index : ndarray of int
        Patch; the one after the last for samples in none.
    weight, sampled_pdf, delta : ndarray
    ratio : ndarray
        ``eval`` over ``pdf`` at the direction, a mean over channels.
    """

    index: Integers
    weight: Floats
    sampled_pdf: Floats
    delta: Flags
    ratio: Floats


@dataclass(frozen=True)
class Damping:
    """Groups of consecutive patches, and the limit of their weights.

    Attributes
    ----------
    first : ndarray of int, shape (n_groups,)
        First patch of each group.
    limits : ndarray, shape (2 n_patches + 1,)
        Of each patch; the last is that of samples in no patch, infinite.
    """

    first: Integers
    limits: Floats

    @staticmethod
    def of(pilot: Batch, n_patches: int, n: int) -> Damping:
        """Damping of `n` samples, chosen by a pilot of fewer."""
        n_pilot = len(pilot.index)
        inside = pilot.index < n_patches
        index, ratio = pilot.index[inside], pilot.ratio[inside]
        hits = np.bincount(index, minlength=n_patches) * (n / n_pilot)
        first = groups(hits, MIN_HITS)
        starts = first if first.size else np.zeros(1, int)
        group = np.searchsorted(starts, np.arange(n_patches), side="right") - 1
        limits = _limits(ratio, group[index], len(starts), SMALL_TERM * n / n_pilot)
        return Damping(first, np.append(limits[group], np.inf))

    def factors(self, batch: Batch) -> Floats:
        """Factor by which each weight is damped."""
        limit = self.limits[batch.index]
        heavy = batch.ratio > limit
        return np.divide(limit, batch.ratio, out=np.ones(len(limit)), where=heavy)


def _limits(ratio: Floats, group: Integers, n_groups: int, share: float) -> Floats:
    """Limit c of each group: ``share * sum(min(ratio / c, 1)^2) = 1``."""
    usable = np.isfinite(ratio) & (ratio > 0)
    low, high = np.full(n_groups, np.inf), np.zeros(n_groups)
    np.minimum.at(low, group[usable], ratio[usable])
    np.maximum.at(high, group[usable], ratio[usable])
    lit = high > 0
    low, high = np.where(lit, low, 1.0), np.where(lit, high, 1.0)
    high = high * np.sqrt(max(1.0, share * len(ratio)))
    for _ in range(60):
        middle = np.sqrt(low * high)
        squares = np.minimum(ratio / middle[group], 1) ** 2
        above = share * np.bincount(group, squares, minlength=n_groups) > 1
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return np.where(lit, low, 0.0)


def groups(hits: Numbers, enough: float) -> Integers:
    """First patch of each group of consecutive patches with enough hits."""
    starts, total = [], enough
    for i, own in enumerate(hits.tolist()):
        if total >= enough:
            starts.append(i)
            total = 0.0
        total += own
    if total < enough:
        starts.pop()
    return np.array(starts, dtype=int)


@dataclass
class PatchTotals:
    """Sums over all samples of one condition, by patch of both hemispheres.

    Patch ``k`` of the lit side has index ``k``, of the other ``n_patches + k``; samples
    of discrete directions are in no patch. Weights are means over channels, damped by
    a :class:`Damping`.

    Attributes
    ----------
    n : int
        Number of samples.
    counts, sums, squares, cubes, largest : ndarray, shape (2 n_patches,)
        Number of samples in each patch, sums of their damped weights and of the second
        and third powers of these, and the largest.
    peaks : ndarray, shape (2 n_patches,)
        Greatest density of a sample in each patch.
    mean, variance : ndarray, shape (channels,)
        Of the weight of a sample, with those in discrete directions.
    delta_mean, delta_variance : ndarray, shape (channels,)
        What discrete directions have of `mean`, and the variance of that.
    is_ratio : bool
        Whether weights are ``eval`` over ``pdf``, except for so few samples as rounding
        may spoil.
    """

    n: int
    counts: Floats
    sums: Floats
    squares: Floats
    cubes: Floats
    largest: Floats
    peaks: Floats
    mean: Floats
    variance: Floats
    delta_mean: Floats
    delta_variance: Floats
    is_ratio: bool


def patch_totals(
    bsdf: mi.BSDF,
    condition: Condition,
    subdivision: RingsAndSectors,
    n: int,
    key: tuple[int, ...],
    damping: Damping,
) -> PatchTotals:
    """Draw `n` independent samples and add them up by patch.

    Parameters
    ----------
    bsdf : mi.BSDF
    condition : Condition
    subdivision : RingsAndSectors
    n : int
    key : tuple of int
        Tells these random numbers from all others.
    damping : Damping
        Of heavy weights.

    Returns
    -------
    PatchTotals
    """
    m = 2 * subdivision.n_patches
    counts, sums, squares, cubes, largest, peaks = np.zeros((6, m + 1))
    # sums over samples of the weight and its square, and of those of discrete ones
    moments: Floats = np.zeros((4, 1))
    n_other = 0
    for begin in range(0, n, CHUNK):
        size = min(CHUNK, n - begin)
        batch = batch_of(bsdf, condition, subdivision, size, (*key, begin))
        mean = batch.weight.mean(axis=1) * damping.factors(batch)
        index = batch.index
        counts += np.bincount(index, minlength=m + 1)
        for total, power in ((sums, 1), (squares, 2), (cubes, 3)):
            total += np.bincount(index, mean**power, minlength=m + 1)
        np.maximum.at(largest, index, mean)
        np.maximum.at(peaks, index, batch.sampled_pdf)
        weight, discrete = batch.weight, batch.weight[batch.delta]
        parts = (weight, weight**2, discrete, discrete**2)
        moments = moments + np.stack([part.sum(axis=0) for part in parts])
        other = unequal(weight.mean(axis=1), batch.ratio, 0.0)
        n_other += int(np.count_nonzero(other & (index < m)))
    first, second, delta_first, delta_second = moments / n
    variance = np.maximum(second - first**2, 0)
    delta_variance = np.maximum(delta_second - delta_first**2, 0)
    is_ratio = n_other <= max(2, SPOILED * n)
    return PatchTotals(
        n,
        *(counts[:-1], sums[:-1], squares[:-1], cubes[:-1], largest[:-1], peaks[:-1]),
        *(first, variance, delta_first, delta_variance),
        is_ratio,
    )


def batch_of(
    bsdf: mi.BSDF,
    condition: Condition,
    subdivision: RingsAndSectors,
    n: int,
    key: tuple[int, ...],
) -> Batch:
    """Draw `n` samples of one launch; weights that are not finite are 0."""
    probe = Probe(bsdf, condition)
    bs, sampled_weight = probe.sample(*uniform(n, key))
    value, pdf = probe.eval_and_pdf(bs.wo)
    # by wo alone, for all plugins: compiling this takes longer than most of theirs
    index = numbers(patch_of(subdivision, condition, bs.wo), n)
    weight, density = spectral(sampled_weight, n), numbers(pdf, n).astype(float)
    delta = (numbers(bs.sampled_type, n) & int(mi.BSDFFlags.Delta)) != 0
    # a weight of zero means that sample failed, or that the BSDF is black there
    counted = ~delta & (weight != 0).any(axis=1) & np.isfinite(numbers(bs.wo.z, n))
    ratio = np.full(n, np.inf)
    np.divide(spectral(value, n).mean(axis=1), density, out=ratio, where=density > 0)
    return Batch(
        np.where(counted, index, 2 * subdivision.n_patches),
        np.where(np.isfinite(weight), weight, 0.0),
        # of the type of the maxima, or to find those takes twenty times as long
        np.nan_to_num(numbers(bs.pdf, n).astype(float), nan=0.0, posinf=np.inf),
        delta,
        ratio,
    )


def _with_azimuth(wo: mi.Vector3f, n: int) -> mi.Vector3f:
    """Spread directions that round to a pole, which is in no sector, over azimuths."""
    turn = dr.two_pi * 2.0**-32 * mi.Float(GOLDEN * dr.arange(mi.UInt32, n))
    lost = (wo.x == 0) & (wo.y == 0)
    x, y = (1e-9 * f(turn) for f in (dr.cos, dr.sin))
    return mi.Vector3f(dr.select(lost, x, wo.x), dr.select(lost, y, wo.y), wo.z)


def patch_of(
    subdivision: RingsAndSectors, condition: Condition, wo: mi.Vector3f
) -> mi.UInt32:
    """Index of the patch of each direction, as of :class:`PatchTotals`."""
    m, wo = subdivision.n_patches, _with_azimuth(wo, dr.width(wo))
    face = dr.opaque(mi.Float, 1 if condition.side == "front" else -1)
    index = subdivision.patch_index(DRJIT, wo.x, wo.y, dr.abs(wo.z))
    index = dr.clip(index, 0, m - 1) + dr.select(face * wo.z < 0, float(m), 0.0)
    return mi.UInt32(index)

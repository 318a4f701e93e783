"""Samples of a BSDF: counted and summed by patch, and collected one by one."""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..plugins.arrays import DRJIT
from .probe import Probe, numbers, spectral

__all__ = ["Drawn", "Totals", "collect", "count", "rounding"]

# Samples of one launch, whose values come back one by one.
CHUNK = 2**20

# Samples that tell how well integrals can be known.
ROUNDED = 2**12

# Size of the displacement that tells how a function answers to rounding: 4 ulp of 1.
ULPS = 2.0**-21


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
        sample1, sample2 = _random(size, (*key, begin))
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


@dataclass
class Drawn:
    """Samples one by one, with what all functions say of their directions.

    Arrays of ``(n,)``, or ``(n, channels)`` for weights and values. Those with a
    trailing underscore are of the separate functions; `slack` is the largest change
    of value and density when both directions are displaced by rounding errors.

    Attributes
    ----------
    condition : Condition
    wo, weight, sampled_pdf, type, component, eta : ndarray
        Answer of ``sample``.
    sample1, sample2 : ndarray
        Its random numbers.
    eval, pdf, eval_slack, pdf_slack : ndarray
        Of ``eval`` and ``pdf`` at `wo`.
    joint : dict of ndarray
        Of ``eval_pdf`` and ``eval_pdf_sample``.
    other_mode : ndarray
        ``eval`` in the other transport mode.
    reverse, reverse_other_mode : ndarray
        ``eval`` with incident and outgoing directions exchanged.
    """

    condition: object
    wo: np.ndarray
    weight: np.ndarray
    sampled_pdf: np.ndarray
    type: np.ndarray
    component: np.ndarray
    eta: np.ndarray
    sample1: np.ndarray
    sample2: np.ndarray
    eval: np.ndarray
    pdf: np.ndarray
    eval_slack: np.ndarray
    pdf_slack: np.ndarray
    joint: dict
    other_mode: np.ndarray
    reverse: np.ndarray
    reverse_slack: np.ndarray
    reverse_other_mode: np.ndarray

    @property
    def n(self):
        """Number of samples."""
        return len(self.pdf)

    @property
    def delta(self):
        """Which samples have a discrete direction."""
        return (self.type & int(mi.BSDFFlags.Delta)) != 0

    @property
    def given(self):
        """Which samples did not fail."""
        return (self.weight != 0).any(axis=1)

    @property
    def smooth(self):
        """Which samples did not fail and have a density."""
        return self.given & ~self.delta & np.isfinite(self.wo).all(axis=1)

    @property
    def reflected(self):
        """Which directions are on the lit side."""
        return self.wo[:, 2] * self.condition.wi[2] > 0


def collect(bsdf, condition, n, key):
    """Draw `n` samples and ask all functions about each direction.

    Parameters and errors as of :func:`count`.
    """
    probe = Probe(bsdf, condition)
    sample1, sample2 = _random(n, key)
    one = probe.sample(sample1, sample2)
    bs = one.bs
    dr.eval(bs, one.weight, sample1, sample2)
    wo = mi.Vector3f(bs.wo)
    value, pdf = probe.eval(wo), probe.pdf(wo)
    joint = probe.eval_pdf(wo)
    triple = probe.eval_pdf_sample(wo, sample1, sample2)
    dr.eval(value, pdf, joint, triple[0], triple[1], triple[2].bs, triple[2].weight)
    same = triple[2]
    other = probe.condition.context
    other.reverse()
    other_mode = probe.eval(wo, ctx=other)
    wi = mi.Vector3f(probe.wi) + dr.zeros(mi.Vector3f, n)
    reverse = probe.eval(wi, wi=wo)
    reverse_other_mode = probe.eval(wi, wi=wo, ctx=other)
    eval_slack, pdf_slack, reverse_slack = _changes(
        wi,
        wo,
        key,
        (lambda wi, wo: probe.eval(wo, wi=wi), value),
        (lambda wi, wo: probe.pdf(wo, wi=wi), pdf),
        (lambda wi, wo: probe.eval(wi, wi=wo), reverse),
    )
    return Drawn(
        condition,
        spectral(wo, n),
        spectral(one.weight, n),
        numbers(bs.pdf, n).astype(float),
        numbers(bs.sampled_type, n),
        numbers(bs.sampled_component, n),
        numbers(bs.eta, n).astype(float),
        numbers(sample1, n),
        spectral(sample2, n),
        spectral(value, n),
        numbers(pdf, n).astype(float),
        spectral(eval_slack, n),
        numbers(pdf_slack, n).astype(float),
        {
            "eval_pdf": (spectral(joint[0], n), numbers(joint[1], n).astype(float)),
            "eval_pdf_sample": (
                spectral(triple[0], n),
                numbers(triple[1], n).astype(float),
            ),
            "wo": spectral(same.bs.wo, n),
            "weight": spectral(same.weight, n),
            "pdf": numbers(same.bs.pdf, n).astype(float),
        },
        spectral(other_mode, n),
        spectral(reverse, n),
        spectral(reverse_slack, n),
        spectral(reverse_other_mode, n),
    )


def rounding(probe, key):
    """Relative error that single precision may leave in integrals.

    A value in single precision is the true one at directions that are displaced by a
    few ulp; if that went the same way everywhere, an integral would be off by the mean
    of the changes.

    Returns
    -------
    pdf, eval : float
    """
    n = ROUNDED
    one = probe.sample(*_random(n, (*key, 2)))
    wo = mi.Vector3f(one.bs.wo)
    wi = mi.Vector3f(probe.wi) + dr.zeros(mi.Vector3f, n)
    dr.eval(wo, one.weight, one.bs)
    value, pdf = probe.eval(wo), probe.pdf(wo)
    slacks = _changes(
        wi,
        wo,
        key,
        (lambda wi, wo: probe.pdf(wo, wi=wi), pdf),
        (lambda wi, wo: probe.eval(wo, wi=wi), value),
    )
    density = numbers(pdf, n)
    usable = ~numbers(one.delta, n) & (density > 0) & np.isfinite(density)
    relative = []
    for function, slack in zip((pdf, value), slacks):
        sums = [
            np.nan_to_num(spectral_or_flat[usable] / density[usable]).sum()
            for spectral_or_flat in (_mean(slack, n), _mean(function, n))
        ]
        relative.append(float(sums[0] / sums[1]) if sums[1] > 0 else 0.0)
    return relative


def _mean(value, n):
    """Number for each sample: the mean over channels."""
    return numbers(value, n) if dr.depth_v(value) == 1 else spectral(value, n).mean(1)


def _changes(wi, wo, key, *functions):
    """Largest changes of functions (with their values) by rounding of directions."""
    largest = [0 * value for _, value in functions]
    for moved_wi, moved_wo in _displaced(wi, wo, key):
        dr.eval(moved_wi, moved_wo)
        for i, (function, value) in enumerate(functions):
            change = dr.abs(function(moved_wi, moved_wo) - value)
            dr.eval(change)  # one kernel for each function, whatever its arguments
            largest[i] = dr.maximum(largest[i], change)
        dr.eval(largest)
    return largest


def _displaced(wi, wo, key):
    """Both directions, displaced by rounding errors into six random directions."""
    n = dr.width(wo)
    signs = mi.load_dict({"type": "independent"})
    signs.seed(_seed((*key, 1)), n)

    def move(v):
        step = mi.Vector3f(*(2 * signs.next_1d() - 1 for _ in range(3)))
        return dr.normalize(v + ULPS * step), dr.normalize(v - ULPS * step)

    for _ in range(3):
        yield from zip(move(wi), move(wo))


def _random(n, key):
    """Independent uniform numbers for ``sample``."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(_seed(key), n)
    return sampler.next_1d(), sampler.next_2d()


def _seed(key):
    """32-bit seed from a tuple of whole numbers, well mixed, no literal of a kernel."""
    seed = int(np.random.SeedSequence(key).generate_state(1)[0])
    return dr.opaque(mi.UInt32, seed)

"""Individual samples of a BSDF, answers about their directions, and rounding."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats, Integers, Numbers
from ..mitsuba_compat import floats
from ..single_precision import BSDF_ROUNDING
from .arrays import Sides, drawn, full as all_elements, lit_from, opposite
from .conditions import Condition
from .probe import (
    Probe,
    Shared,
    full,
    is_delta,
    numbers,
    random_numbers,
    seed_of,
    spectral,
    uniform,
    vectors,
)

# Where operations are badly conditioned more than `BSDF_ROUNDING` is left: so many
# times the change under a displacement of both directions by 4 ulp of 1. Beyond that,
# of 77 right BSDFs one was seen to need more than 2^-18, GGX of roughness 0.05 with all
# normals: 1 sample in 2^16 needs more than `BSDF_ROUNDING`.
SLACK = 16
ULPS = 2.0**-21

# Fraction of samples that may differ by any amount, for they are as near to a jump,
# where two functions may take different sides: six jumps of a BSDF, at its horizons,
# along each of which there is at most one sample a radian.
SPOILED = 6 * SLACK * ULPS

# Fraction of the samples that may differ for all steps of their values to be searched
# for, and displacements of each: both together cost less than to ask once for all.
MAX_SEARCHED, N_DISPLACED = 0.01, 64

# Standard errors beyond which two means differ.
MAX_SCORE = 5

# Values in single precision that are as good as 0: powers of small cosines underflow.
UNDERFLOW = 1e-30

# Relative difference of elements of matrices, over the first one, that is no rounding.
ELEMENT_ROUNDING = 2e-3

# Samples that tell how well integrals can be known.
N_ROUNDED = 2**12

# Rounding of a cosine that is found by four operations.
COSINE_ROUNDING = 2.0**-22


def unequal(a: Numbers, b: Numbers, slack: Numbers | float) -> Flags:
    """Mask of samples whose values differ by more than rounding, shape ``(n,)``.

    The slack is that of each channel; elements of matrices round with the first one.
    """
    if np.array_equal(a, b):  # as most are, which costs a tenth of all below
        return np.zeros(len(a), dtype=bool)
    rounding, size = BSDF_ROUNDING, np.maximum(np.abs(a), np.abs(b))
    if a.ndim == 4:
        rounding, size = ELEMENT_ROUNDING, size[..., :1, :1]
        slack = slack if isinstance(slack, float) else slack[..., None, None]
    tolerance = rounding * size + SLACK * slack
    with np.errstate(invalid="ignore"):  # infinities are equal; `answers` names them
        differs = np.abs(a - b) > np.maximum(tolerance, UNDERFLOW)
    return differs.any(axis=tuple(range(1, differs.ndim)))


def ratio_of(above: Floats, below: Floats) -> Floats:
    """Ratios of answers, shape ``(n,)``; of spectra the one farthest from 1."""
    if np.array_equal(above, below):
        return np.ones(len(above))
    above, below = (x.reshape(len(x), -1) for x in (above, below))
    same = (above == below) | ~np.isfinite(above) | ~np.isfinite(below)
    ratio = np.where(same, 1.0, above / np.where(same, 1.0, np.maximum(below, 1e-30)))
    worst = np.abs(ratio - 1).argmax(axis=1)
    return np.take_along_axis(ratio, worst[:, None], axis=1)[:, 0]


def means_differ(a: Floats, b: Floats, wo: Floats, wo_b: Floats | None = None) -> bool:
    """Whether means of two answers to the same calls differ by more than chance.

    Of all, or times a polynomial of wo: noise has the mean 0 in every direction.
    Arrays are ``(n, channels)``, and wo of `b` is that of `a` unless it is given.
    """
    both = zip(moments(wo), moments(wo if wo_b is None else wo_b))
    for off in (a * first[:, None] - b * second[:, None] for first, second in both):
        std_err = off.std(axis=0) / np.sqrt(max(len(off), 1))
        if (np.abs(off.mean(axis=0)) > MAX_SCORE * std_err).any():
            return True
    return False


def moments(wo: Floats) -> tuple[Floats, ...]:
    """Values of polynomials of directions, each of shape (n,)."""
    x, y, z = wo.T
    return np.ones(len(wo)), x, y, z, z * z, x * y, x * x - y * y


def beyond_rounding(mask: Flags) -> bool:
    """Whether the mask has more samples than rounding may spoil."""
    return mask.sum() > max(2, SPOILED * len(mask))


def agree(a: Numbers, b: Numbers, slack: Numbers | float, mask: Flags) -> bool:
    """Whether answers about the samples of a mask are equal, but for rounding."""
    return not beyond_rounding(unequal(a, b, slack) & mask)


@dataclass
class Samples:
    """Samples one by one, with the answers of all functions at their directions.

    Arrays of ``(n,)``, or ``(n, channels)`` for weights and values, of Mueller matrices
    their first elements: :meth:`full` has all of them. A slack is the
    largest change of a value when both directions are displaced by rounding errors, and
    relative to its value no less than that of half of the samples. What was not asked
    is None.

    Attributes
    ----------
    condition : Condition
    wo, weight, sampled_pdf, type, component, eta : ndarray
        Answer of ``sample``.
    u : ndarray, shape (n, 3)
        Its random numbers.
    eval, pdf, eval_slack, pdf_slack : ndarray
        Of ``eval`` and ``pdf`` at `wo`.
    joint : dict of ndarray
        Of ``eval_pdf`` and ``eval_pdf_sample``.
    other_mode : ndarray
        ``eval`` in the other transport mode.
    reverse, reverse_other_mode : ndarray
        ``eval`` with incident and outgoing directions exchanged.
    matrices : dict of ndarray, shape (n, channels, 4, 4)
        Of Mueller matrices all elements, by the names of weights and values.
    """

    condition: Condition
    wo: Floats
    weight: Floats
    sampled_pdf: Floats
    type: Integers
    component: Integers
    eta: Floats
    u: Floats
    eval: Any = None
    pdf: Any = None
    joint: dict[str, Any] = field(default_factory=dict)
    eval_slack: Any = None
    pdf_slack: Any = None
    other_mode: Any = None
    reverse: Any = None
    reverse_slack: Any = None
    reverse_other_mode: Any = None
    matrices: dict[str, Floats] = field(default_factory=dict)
    asked: tuple[Any, ...] = ()

    def full(self, name: str) -> Floats:
        """Weights or values of that name with all elements of Mueller matrices."""
        return self.matrices[name] if self.matrices else getattr(self, name)

    def hold(
        self, stated: Callable[..., Sides], *given: Any
    ) -> tuple[Floats, Floats, Flags]:
        """What should be equal by a property, and which samples count.

        Numbers have the shape ``(n, channels)``, or that of matrices.
        """
        a, b, counts = stated(*self.asked, *given)
        a, b = np.broadcast_arrays(a, b, np.empty((1, self.n)))[:2]
        a, b = (x.T if x.ndim == 2 else x.transpose(3, 2, 0, 1) for x in (a, b))
        return a, b, np.broadcast_to(counts, self.n)

    @property
    def n(self) -> int:
        """Number of samples."""
        return len(self.sampled_pdf)

    @property
    def delta(self) -> Flags:
        """Mask of samples with a discrete direction."""
        return (self.type & int(mi.BSDFFlags.Delta)) != 0

    @property
    def given(self) -> Flags:
        """Mask of samples that did not fail."""
        return (self.weight != 0).any(axis=1)

    @property
    def discrete(self) -> Flags:
        """Mask of samples that did not fail, of a lobe of one direction."""
        return self.given & self.delta & np.isfinite(self.wo).all(axis=1)

    @property
    def null(self) -> Flags:
        """Mask of samples that go straight on, by a lobe of the type Null."""
        return self.given & ((self.type & int(mi.BSDFFlags.Null)) != 0)

    @property
    def smooth(self) -> Flags:
        """Mask of samples that did not fail and have a density."""
        return self.given & ~self.delta & np.isfinite(self.wo).all(axis=1)

    @property
    def usable(self) -> Flags:
        """Mask of those whose ``eval`` and densities are finite."""
        finite = np.isfinite(self.eval).all(axis=1) & np.isfinite(self.pdf)
        return self.smooth & finite & np.isfinite(self.sampled_pdf)

    @property
    def flux(self) -> Floats:
        """Weight times the density or probability that ``sample`` returns."""
        return self.weight * self.sampled_pdf[:, None]

    @property
    def flux_by_pdf(self) -> Floats:
        """Weight times the density of ``pdf``."""
        return self.weight * self.pdf[:, None]

    @property
    def wi(self) -> Floats:
        """Incident direction of each sample, shape ``(n, 3)``."""
        return np.broadcast_to(self.condition.wi, self.wo.shape)

    @property
    def reflected(self) -> Flags:
        """Mask of directions on the lit side."""
        return self.wo[:, 2] * self.wi[:, 2] > 0

    def select(self, mask: Any) -> Samples:
        """Samples of a mask, or a slice, without answers of the joint functions."""
        kept: dict[str, Any] = {
            name: value[mask]
            for name, value in vars(self).items()
            if isinstance(value, np.ndarray)
        }
        own = {name: value[mask] for name, value in self.matrices.items()}
        return replace(self, joint={}, asked=(), matrices=own, **kept)

    def with_answers(self, answers: Mapping[str, Any], **others: Any) -> Samples:
        """The same samples with further answers by name."""
        own = _arrays(answers, self.n)
        own["matrices"] = self.matrices | own["matrices"]
        return replace(self, **own, **others)

    @property
    def random(self) -> tuple[mi.Float, mi.Point2f]:
        """Random numbers as ``sample`` takes them."""
        return random_numbers(self.u)

    def share(self, part: Numbers) -> float:
        """Fraction of the light that is a `part` of the weight of each sample."""
        light = np.nan_to_num(np.abs(self.weight).mean(axis=1), posinf=0.0)
        return float(light @ part / max(light.sum(), UNDERFLOW))

    def fraction(self, mask: Flags) -> str:
        """Text on the percentage of samples in the mask, and where they are."""
        place = self.condition.place(mask)
        return f"{100 * mask.mean():.3g} % of the samples at {place}"

    def middle(self, mask: Flags) -> Condition:
        """Condition with one incident direction of the samples in the mask."""
        return self.condition.middle(mask)


def drawn_samples(probe: Probe, sample1: mi.Float, sample2: mi.Point2f) -> Samples:
    """Answers of ``sample`` alone about random numbers."""
    u = mi.Point3f(sample1, sample2.x, sample2.y)
    asked = Shared(probe), probe.condition.context, probe.interactions(dr.width(u)), u
    bs, weight = drawn(*asked)
    given = {"u": u, "wo": bs.wo, "weight": weight, "sampled_pdf": bs.pdf}
    given |= {"type": bs.sampled_type, "component": bs.sampled_component, "eta": bs.eta}
    return Samples(
        condition=probe.condition, asked=asked, **_arrays(given, dr.width(u))
    )


def samples_of(
    bsdf: mi.BSDF,
    condition: Condition,
    n: int,
    key: tuple[int, ...],
    compared: bool = True,
) -> Samples:
    """Draw `n` samples and ask all functions about each direction.

    Parameters as of :func:`~gonio_mi.validation.tally.patch_totals`. If nothing is to
    be `compared`, slacks, joint functions, the other mode and the reverse, all of which
    take most of the time, are not asked.
    """
    probe = Probe(bsdf, condition)
    samples = drawn_samples(probe, *uniform(n, key))
    plugin, ctx, si, u = samples.asked
    wo, wi = drawn(*samples.asked)[0].wo, si.wi
    answers: dict[str, Any] = {"eval": plugin.eval(ctx, si, wo)}
    answers["pdf"] = plugin.pdf(ctx, si, wo)
    if not compared:
        return samples.with_answers(answers)
    joint = _joint(plugin, ctx, si, wo, u)
    functions: dict[str, Any] = {
        "eval": lambda wi, wo: probe.eval(wo, wi=wi),
        "pdf": lambda wi, wo: probe.pdf(wo, wi=wi),
    }
    if not mi.is_polarized or _goes_both_ways(condition):
        other, back = opposite(ctx), lit_from(si, wo)
        answers["other_mode"] = plugin.eval(other, si, wo)
        answers["reverse"] = plugin.eval(ctx, back, wi)
        answers["reverse_other_mode"] = plugin.eval(other, back, wi)
        functions["reverse"] = lambda wi, wo: probe.eval(wi, wi=wo)
    displaced = [*_displaced(wi, wo, key), *_tilted(wi, wo)]
    # elements of matrices are not known so well that more would tell
    displaced = displaced[:2] if mi.is_polarized else displaced
    changes = _changes(displaced, *((f, answers[k]) for k, f in functions.items()))
    samples = samples.with_answers(answers, joint=joint)
    slacks: dict[str, Any] = {
        f"{name}_slack": _no_less(change, getattr(samples, name))
        for name, change in zip(functions, changes)
    }
    return replace(samples, **slacks)


def _goes_both_ways(condition: Condition) -> bool:
    """Whether matrices are compared with those of the other mode and way."""
    return condition.mode == "importance" and not condition.fields


def _arrays(answers: Mapping[str, Any], n: int) -> dict[str, Any]:
    """Answers by name as arrays of samples, and all elements of those with matrices."""
    found: dict[str, Any] = {"matrices": {}}
    for name, answer in answers.items():
        if dr.is_matrix_v(answer):
            found["matrices"][name] = full(answer, n)
        if dr.depth_v(answer) > 1:
            found[name] = spectral(answer, n)
        else:
            kind = float if dr.is_float_v(answer) else int
            found[name] = numbers(answer, n).astype(kind)
    return found


def _no_less(change: Numbers, value: Floats) -> Floats:
    """Slack that is, relative to the value, at least the median of all samples.

    Where a difference of nearly equal numbers has few steps left, displacements may
    change nothing by chance. Of matrices it is the largest `change` of all elements.
    """
    change = change.max(axis=(0, 1)) if change.ndim == 4 else change
    slack = np.broadcast_to(change.T, value.shape).astype(float)
    size = np.abs(value)
    usable = (size > 0) & np.isfinite(size) & np.isfinite(slack)
    if not usable.any():
        return slack
    half = np.median(slack[usable] / size[usable])
    return np.maximum(slack, half * np.where(np.isfinite(size), size, 0.0))


def _joint(plugin: Shared, ctx: Any, si: Any, wo: Any, u: Any) -> dict[str, Any]:
    """Answers of ``eval_pdf`` and ``eval_pdf_sample``, and the latter's samples.

    Of Mueller matrices the former alone.
    """
    n = dr.width(wo)

    def pair(value: mi.Spectrum, pdf: mi.Float) -> tuple[Floats, Floats]:
        return full(value, n), numbers(pdf, n).astype(float)

    answers: dict[str, Any] = {"eval_pdf": pair(*plugin.eval_pdf(ctx, si, wo))}
    if mi.is_polarized:
        return answers
    random = u.x, mi.Point2f(u.y, u.z)
    *both, bs, weight = plugin.eval_pdf_sample(ctx, si, wo, *random)
    sampled = _arrays({"wo": bs.wo, "weight": weight, "pdf": bs.pdf}, n)
    return answers | {"eval_pdf_sample": pair(*both)} | sampled


def rounding(probe: Probe, key: tuple[int, ...]) -> list[float]:
    """Relative error that single precision may leave in integrals.

    A value in single precision is the true one at directions that are displaced by a
    few ulp; if that went the same way everywhere, an integral would be off by the mean
    of the changes.

    Returns
    -------
    pdf, eval : float
    """
    n = N_ROUNDED
    bs, _ = probe.sample(*uniform(n, (*key, 2)))
    wo = mi.Vector3f(bs.wo)
    wi = mi.Vector3f(probe.wi) + dr.zeros(mi.Vector3f, n)
    dr.make_opaque(wi)
    value, pdf = probe.eval(wo), probe.pdf(wo)
    slacks = _changes(
        _displaced(wi, wo, key),
        (lambda wi, wo: probe.pdf(wo, wi=wi), pdf),
        (lambda wi, wo: probe.eval(wo, wi=wi), value),
    )
    density = numbers(pdf, n)
    usable = ~numbers(is_delta(bs), n) & (density > 0) & np.isfinite(density)
    relative = []
    for function, slack in zip((pdf, value), slacks):
        change, whole = (
            np.nan_to_num(_mean(one, n)[usable] / density[usable]).sum()
            for one in (slack, function)
        )
        relative.append(float(change / whole) if whole > 0 else 0.0)
    return relative


def closer_slacks(bsdf: mi.BSDF, samples: Samples) -> tuple[Floats, Floats]:
    """Slacks of ``eval`` and ``pdf`` of a few samples, by many more displacements.

    A difference of nearly equal numbers, as in Fresnel's equations for an index near 1,
    has few steps left, and the usual displacements may miss them all.
    """
    probe, n = Probe(bsdf, samples.condition), samples.n
    both = samples.wi, samples.wo
    wi, wo = (vectors(np.repeat(x, N_DISPLACED, axis=0)) for x in both)
    slacks = _changes(
        _displaced(wi, wo, (n, 4)),
        (lambda wi, wo: probe.eval(wo, wi=wi), probe.eval(wo)),
        (lambda wi, wo: probe.pdf(wo, wi=wi), probe.pdf(wo)),
    )
    value = spectral(slacks[0], n * N_DISPLACED).reshape(n, N_DISPLACED, -1)
    pdf = numbers(slacks[1], n * N_DISPLACED).reshape(n, N_DISPLACED)
    return value.max(axis=1), pdf.max(axis=1)


def _mean(value: Any, n: int) -> Numbers:
    """Mean over channels, one number for each sample."""
    flat = np.array(value).ndim == 1
    return numbers(value, n) if flat else spectral(value, n).mean(1)


def _changes(
    displaced: Iterable[tuple[mi.Vector3f, mi.Vector3f, float]],
    *functions: tuple[Callable[[mi.Vector3f, mi.Vector3f], Any], Any],
) -> list[Numbers]:
    """Largest weighted changes of functions, each of which comes with its values.

    All displacements share a launch, for recording a large plugin takes longer.
    """
    *moved, weights = zip(*displaced)
    dr.eval(moved)
    wi, wo = (mi.Vector3f(*(floats(*x) for x in zip(*one))) for one in moved)
    of_each = np.array(weights, np.float32)[:, None]
    largest = []
    for function, value in functions:
        here, there = map(_array, (value, function(wi, wo)))
        shape = *there.shape[:-1], dr.width(wo)
        there = np.broadcast_to(there, shape).reshape(*shape[:-1], len(weights), -1)
        with np.errstate(invalid="ignore", over="ignore"):
            change = of_each * np.abs(there - here[..., None, :])
            largest.append(np.maximum(0 * here, change.max(axis=-2)))
    return largest


def _array(value: Any) -> Numbers:
    """Array of a value, of matrices one element after the other."""
    return all_elements(value) if dr.is_matrix_v(value) else np.array(value)


def _displaced(
    wi: mi.Vector3f, wo: mi.Vector3f, key: tuple[int, ...]
) -> Iterator[tuple[mi.Vector3f, mi.Vector3f, float]]:
    """Both directions, displaced by rounding errors, with a weight of 1."""
    n = dr.width(wo)
    signs = mi.load_dict({"type": "independent"})
    signs.seed(seed_of((*key, 1)), n)

    def _step() -> mi.Vector3f:
        return mi.Vector3f(*(2 * signs.next_1d() - 1 for _ in range(3)))

    def _moved(v: mi.Vector3f, step: mi.Vector3f) -> tuple[mi.Vector3f, mi.Vector3f]:
        # of a unit vector only to within rounding, as all are in single precision
        return v + ULPS * step, v - ULPS * step

    steps = [(_step(), _step()) for _ in range(3)]
    dr.eval(steps)  # in a kernel that all share
    for of_wi, of_wo in steps:
        for moved in zip(_moved(wi, of_wi), _moved(wo, of_wo)):
            yield *moved, 1.0


def _tilted(
    wi: mi.Vector3f, wo: mi.Vector3f
) -> Iterator[tuple[mi.Vector3f, mi.Vector3f, float]]:
    """Outgoing directions whose half vector has a cosine that is off by rounding.

    A plugin that draws the cosine of a facet finds its sine from that: near the normal,
    the angle is off by the rounding of the cosine over the sine.
    """
    h = dr.normalize(wi + wo)
    h = dr.select(dr.abs(wi.z + wo.z) > 1e-4, h, mi.Vector3f(0, 0, 1))
    sine = dr.sqrt(dr.square(h.x) + dr.square(h.y))
    # a cosine that rounds to 1 leaves no azimuth
    off = sine > 0
    x, y = dr.select(off, h.x / sine, 1.0), dr.select(off, h.y / sine, 0.0)
    down = mi.Vector3f(x * h.z, y * h.z, -sine)
    angle = COSINE_ROUNDING / dr.maximum(sine, np.sqrt(COSINE_ROUNDING))
    for sign in (1.0, -1.0):
        moved = dr.normalize(h + sign * angle * down)
        # the change counts as it is, those of a displacement SLACK times
        yield wi, mi.reflect(wi, moved), 1 / SLACK

"""Weight times pdf is `eval`."""

from typing import Any

import numpy as np

from ...array_types import Flags, Floats
from ...single_precision import BSDF_ROUNDING
from ..arrays import Sides, density, drawn, full, rows, smooth, value
from ..densities import Means
from ..evidence import BIAS, INTERFACE, SAME, SAMPLED, Evidence, Question
from ..judgements import apart, by_sample
from ..mistakes import EVAL, SAMPLE, Claim, Mistake
from ..samples import (
    MAX_SCORE,
    MAX_SEARCHED,
    UNDERFLOW,
    Samples,
    beyond_rounding,
    closer_slacks,
    means_differ,
    ratio_of,
    unequal,
)
from .matrices import breach_of_elements


def sampled_weight(bsdf: Any, ctx: Any, si: Any, u: Any) -> Sides:
    """Weight times pdf is `eval`."""
    bs, weight = drawn(bsdf, ctx, si, u)
    flux = full(weight) * rows(bsdf.pdf(ctx, si, bs.wo, True))
    return flux, full(bsdf.eval(ctx, si, bs.wo, True)), smooth(bs, weight)


SAMPLED_WEIGHT = Question(
    "sampled_weight",
    __doc__,
    BIAS,
    SAMPLED,
    volumes=SAME,
    identity=True,
    matrices="weight times pdf is `eval`, in all elements",
    shown=Claim(sampled_weight, by_sample),
)


def mean_weight(bsdf: Any, ctx: Any, si: Any, u: Any) -> Means:
    """The mean weight is that of `eval` over pdf."""
    bs, weight = drawn(bsdf, ctx, si, u)
    pdf = np.fmax(density(bsdf, ctx, si, bs.wo), 1e-30)
    due = (value(bsdf, ctx, si, bs.wo) / pdf).mean(axis=0)
    x, y = (
        np.where(smooth(bs, weight), z, 0) for z in (rows(weight).mean(axis=0), due)
    )
    return np.mean(x), np.mean(y), np.std(x - y) / len(x) ** 0.5


# Samples that tell a mean, and the part of the changes by displacements that it may be
# off: none of the right BSDFs of the tests was, nor rough ones down to alpha 1e-4.
MIN_MEAN = 2**10
PART_OF_CHANGE = 64


class SampledWeight(Mistake):
    """Mistakes in sampled weights."""

    OTHER = "the weight of {who} is not `eval` over pdf"
    OTHER_MEAN = "{who}: the mean weight is not that of `eval` over pdf"


@SAMPLED_WEIGHT.asks("samples")
def check_samples(evidence: Evidence, samples: Samples) -> None:
    """Check that both are equal, sample by sample, for one of the two densities."""
    lit = samples.usable & (samples.eval != 0).any(axis=1)
    if not lit.any():
        return
    if evidence.noisy:
        if _is_biased(samples, samples.usable):
            guess = SampledWeight.OTHER_MEAN(EVAL | SAMPLE)
            evidence.breach(SAMPLED_WEIGHT, guess, samples.condition)
        return
    flux, due, _ = samples.hold(sampled_weight)
    by_sampled_pdf = (samples.full("weight").T * samples.sampled_pdf).T
    slacks = samples.eval_slack, samples.pdf_slack
    wrong = [
        _differing(samples, one, due, *slacks) & lit for one in (by_sampled_pdf, flux)
    ]
    lit_alike = samples.condition.wi.ndim == 1
    if lit_alike and beyond_rounding(wrong[1]) and wrong[1].mean() < MAX_SEARCHED:
        few = samples.select(wrong[1])
        closer = closer_slacks(evidence.bsdf, few)
        both = flux[wrong[1]], due[wrong[1]]
        wrong[1][wrong[1]] = _differing(few, *both, *closer)
    if all(beyond_rounding(one) for one in wrong):
        if samples.matrices:
            of = SAMPLED_WEIGHT, samples, by_sampled_pdf, due, wrong[0]
            breach_of_elements(evidence, *of)
            return
        effect = "" if _is_biased(samples, lit) else INTERFACE
        found = ratio_of(flux, due), "weight times pdf over `eval`"
        guess, at = SampledWeight.OTHER(SAMPLE), (samples, wrong[1])
        off = _wrong_light(samples, wrong[1])
        how: dict[str, Any] = {"off": off, "effect": effect}
        evidence.breach_of_ratio(SAMPLED_WEIGHT, guess, *at, *found, **how)
        return
    densities = samples.sampled_pdf, samples.pdf
    bias = min((_bias(samples, x, lit & (x > 0)) for x in densities), key=abs)
    if bias:
        guess = SampledWeight.OTHER_MEAN(EVAL | SAMPLE)
        text = f"the mean weight is {1 + bias:.4g} times that of `eval` over pdf"
        how = {"found": text, "size": abs(bias), "of_flux": True}
        how["off"] = abs(bias) / max(1, 1 + bias) * float(lit.mean())
        how["shown"] = Claim(mean_weight, apart)
        evidence.breach(SAMPLED_WEIGHT, guess, samples.condition, **how)


def _differing(
    samples: Samples, flux: Floats, due: Floats, eval_slack: Floats, pdf_slack: Floats
) -> Flags:
    """Mask of samples for which weight times a density is not the `due` ``eval``."""
    # where a density is badly conditioned, so is the product
    relative = (pdf_slack / np.maximum(samples.pdf, 1e-30))[:, None]
    light = flux[..., 0, 0] if flux.ndim == 4 else flux
    return unequal(flux, due, eval_slack + np.abs(light) * relative)


def _bias(samples: Samples, pdf: Floats, lit: Flags) -> float:
    """Relative surplus of the mean weight over that of ``eval`` over a density.

    0 if chance may explain it, or rounding: what displaces a value goes either way, and
    a mean is off by a small part of the displacements at most.
    """
    few, density = samples.select(lit), pdf[lit][:, None]
    if few.n < MIN_MEAN:
        return 0.0
    due, of_pdf = few.eval / density, few.pdf_slack[:, None] / density
    change = few.eval_slack / density + due * of_pdf
    off, whole = few.weight - due, np.maximum(due.mean(axis=0), UNDERFLOW)
    bias, noise = off.mean(axis=0), MAX_SCORE * off.std(axis=0) / few.n**0.5
    known = np.maximum(change.mean(axis=0) / PART_OF_CHANGE, BSDF_ROUNDING * whole)
    found = np.where(np.abs(bias) > np.maximum(known, noise), bias / whole, 0.0)
    return float(found[np.abs(found).argmax()])


def _wrong_light(samples: Samples, wrong: Flags) -> float:
    """Fraction of the light by which weights and ``eval`` over ``pdf`` differ.

    Of the larger of both sums, as of maps.
    """
    known = samples.usable & (samples.pdf > 0)
    few = samples.select(known)
    drawn, due = few.weight.mean(axis=1), few.eval.mean(axis=1) / few.pdf
    off = np.abs(drawn - due)[wrong[known]].sum()
    return float(off / max(drawn.sum(), due.sum(), UNDERFLOW))


def _is_biased(samples: Samples, lit: Flags) -> bool:
    """Whether mean weights differ from those of ``eval`` over ``pdf``."""
    usable = lit & (samples.pdf > 0) & np.isfinite(samples.weight).all(axis=1)
    few = samples.select(usable)
    due = few.eval / few.pdf[:, None]
    return len(due) < 2 or means_differ(few.weight, due, few.wo)

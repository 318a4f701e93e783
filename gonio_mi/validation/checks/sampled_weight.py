"""Weight times pdf is `eval`."""

from typing import Any

import numpy as np

from ...array_types import Flags, Floats
from ..arrays import Sides, density, drawn, rows, smooth, value
from ..evidence import BIAS, INTERFACE, SAME, SAMPLED, Evidence, Question
from ..judgements import by_sample
from ..mistakes import EVAL, SAMPLE, Claim, Mistake
from ..samples import (
    MAX_SEARCHED,
    Samples,
    beyond_rounding,
    closer_slacks,
    means_differ,
    ratio_of,
    unequal,
)


def sampled_weight(bsdf: Any, ctx: Any, si: Any, u: Any) -> Sides:
    """Weight times pdf is `eval`."""
    bs, weight = drawn(bsdf, ctx, si, u)
    flux = rows(weight) * density(bsdf, ctx, si, bs.wo)
    return flux, value(bsdf, ctx, si, bs.wo), smooth(bs, weight)


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
    slacks = samples.eval_slack, samples.pdf_slack
    wrong = [_differing(samples, one, *slacks) & lit for one in (samples.flux, flux)]
    lit_alike = samples.condition.wi.ndim == 1
    if lit_alike and beyond_rounding(wrong[1]) and wrong[1].mean() < MAX_SEARCHED:
        few = samples.select(wrong[1])
        closer = closer_slacks(evidence.bsdf, few)
        wrong[1][wrong[1]] = _differing(few, flux[wrong[1]], *closer)
    if all(beyond_rounding(one) for one in wrong):
        effect = "" if _is_biased(samples, lit) else INTERFACE
        found = ratio_of(flux, due), "weight times pdf over `eval`"
        guess, at = SampledWeight.OTHER(SAMPLE), (samples, wrong[1])
        evidence.breach_of_ratio(SAMPLED_WEIGHT, guess, *at, *found, effect=effect)


def _differing(
    samples: Samples, flux: Floats, eval_slack: Floats, pdf_slack: Floats
) -> Flags:
    """Mask of samples for which weight times a density is not ``eval``."""
    # where a density is badly conditioned, so is the product
    relative = (pdf_slack / np.maximum(samples.pdf, 1e-30))[:, None]
    return unequal(flux, samples.eval, eval_slack + np.abs(flux) * relative)


def _is_biased(samples: Samples, lit: Flags) -> bool:
    """Whether mean weights differ from those of ``eval`` over ``pdf``."""
    usable = lit & (samples.pdf > 0) & np.isfinite(samples.weight).all(axis=1)
    few = samples.select(usable)
    due = few.eval / few.pdf[:, None]
    return len(due) < 2 or means_differ(few.weight, due, few.wo)

"""Weight times pdf is `eval`."""

import numpy as np

from ...array_types import Flags, Floats
from ..evidence import BIAS, INTERFACE, SAME, SAMPLED, Evidence, Question
from ..mistakes import EVAL, SAMPLE, Mistake
from ..samples import (
    MAX_SEARCHED,
    Samples,
    beyond_rounding,
    closer_slacks,
    means_differ,
    ratio_of,
    unequal,
)

SAMPLED_WEIGHT = Question(
    "sampled_weight",
    __doc__,
    BIAS,
    SAMPLED,
    volumes=SAME,
    identity=True,
    matrices="weight times pdf is `eval`, in all elements",
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
    slacks = samples.eval_slack, samples.pdf_slack
    wrong = [one & lit for one in _unequal(samples, *slacks)]
    lit_alike = samples.condition.wi.ndim == 1
    if lit_alike and beyond_rounding(wrong[1]) and wrong[1].mean() < MAX_SEARCHED:
        few = samples.select(wrong[1])
        wrong[1][wrong[1]] = _unequal(few, *closer_slacks(evidence.bsdf, few))[1]
    if all(beyond_rounding(one) for one in wrong):
        effect = "" if _is_biased(samples, lit) else INTERFACE
        ratio = ratio_of(samples.flux_by_pdf, samples.eval)
        found = ratio, "weight times pdf over `eval`"
        guess, at = SampledWeight.OTHER(SAMPLE), (samples, wrong[1])
        evidence.breach_of_ratio(SAMPLED_WEIGHT, guess, *at, *found, effect=effect)


def _unequal(samples: Samples, eval_slack: Floats, pdf_slack: Floats) -> list[Flags]:
    """Masks of samples for which weight times either density is not ``eval``."""
    # where a density is badly conditioned, so is the product
    relative = (pdf_slack / np.maximum(samples.pdf, 1e-30))[:, None]
    return [
        unequal(x, samples.eval, eval_slack + np.abs(x) * relative)
        for x in (samples.flux, samples.flux_by_pdf)
    ]


def _is_biased(samples: Samples, lit: Flags) -> bool:
    """Whether mean weights differ from those of ``eval`` over ``pdf``."""
    usable = lit & (samples.pdf > 0) & np.isfinite(samples.weight).all(axis=1)
    few = samples.select(usable)
    due = few.eval / few.pdf[:, None]
    return len(due) < 2 or means_differ(few.weight, due, few.wo)

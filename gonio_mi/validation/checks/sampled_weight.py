"""Weight times pdf, against ``eval``."""

from __future__ import annotations

import numpy as np

from ...array_types import Flags
from ..evidence import INTERFACE, Evidence, Ratio
from ..samples import Samples, is_many, ratio_of, unequal

# Standard errors beyond which two means differ.
MAX_SCORE = 5


def check_samples(evidence: Evidence, samples: Samples) -> None:
    """They are equal, sample by sample, with either of both densities."""
    lit = samples.usable & (samples.eval != 0).any(axis=1)
    if not lit.any():
        return
    products = [samples.weight * p[:, None] for p in (samples.sampled_pdf, samples.pdf)]
    # where a density is badly conditioned, so is the product
    relative = (samples.pdf_slack / np.maximum(samples.pdf, 1e-30))[:, None]
    wrong = [
        unequal(x, samples.eval, samples.eval_slack + np.abs(x) * relative) & lit
        for x in products
    ]
    if all(is_many(one) for one in wrong):
        evidence.breach_of_ratio(
            "sampled_weight",
            "sample",
            Ratio(samples, wrong[1], ratio_of(products[1], samples.eval)),
            "weight times pdf over `eval`",
            "the weight of `sample` is not `eval` over pdf",
            effect="" if _is_biased(samples, lit) else INTERFACE,
        )


def _is_biased(samples: Samples, lit: Flags) -> bool:
    """Whether weights of a channel have another mean than ``eval`` over ``pdf``."""
    usable = lit & (samples.pdf > 0) & np.isfinite(samples.weight).all(axis=1)
    off = samples.weight[usable] - samples.eval[usable] / samples.pdf[usable][:, None]
    if len(off) < 2:
        return True
    std_err = off.std(axis=0) / np.sqrt(len(off))
    return bool((np.abs(off.mean(axis=0)) > MAX_SCORE * std_err).any())

"""``eval_pdf_sample`` against the separate functions."""

from __future__ import annotations

import numpy as np

from ..evidence import Evidence
from ..samples import BSDF_ROUNDING, Samples, is_many, unequal
from .eval_pdf import check_joint

__all__ = ["check_samples"]


def check_samples(evidence: Evidence, samples: Samples) -> None:
    """Value and density are those of ``eval`` and ``pdf``, samples of ``sample``."""
    check_joint(evidence, samples, "eval_pdf_sample")
    own, given = samples.joint, samples.given
    wrong = (np.abs(own["wo"] - samples.wo).max(axis=1) > BSDF_ROUNDING) & given
    wrong |= unequal(own["weight"], samples.weight, 0.0)
    wrong |= unequal(own["pdf"], samples.sampled_pdf, 0.0) & given
    if is_many(wrong):
        evidence.breach(
            "eval_pdf_sample",
            "eval_pdf_sample",
            samples.fraction(wrong),
            "`eval_pdf_sample` draws other samples than `sample`",
            samples.condition,
            size=float(wrong.mean()),
            off=float(wrong.mean()),
        )

"""``eval_pdf_sample`` against the separate functions."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ..evidence import INTERFACE, Evidence
from ..samples import BSDF_ROUNDING, Samples, is_many, unequal
from .eval_pdf import check_joint


def check_samples(evidence: Evidence, samples: Samples) -> None:
    """Value and density are those of ``eval`` and ``pdf``, samples of ``sample``."""
    # no integrator calls that of a plugin in Python, which this version cannot reach
    effect = "" if type(evidence.bsdf) is mi.BSDF else INTERFACE
    check_joint(evidence, samples, "eval_pdf_sample", effect)
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
            samples.condition.middle(wrong),
            size=float(wrong.mean()),
            off=float(wrong.mean()),
            effect=effect,
        )

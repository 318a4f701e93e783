"""``eval_pdf`` and ``eval_pdf_sample`` against the separate functions."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ...single_precision import BSDF_ROUNDING
from ..evidence import INTERFACE, Evidence
from ..kinds import Kind
from ..probe import Probe, numbers, spectral, vectors
from ..samples import Samples, beyond_rounding, ratio_of, unequal
from .answers import lattice

# Differences on a lattice that may be rounding of a sharp lobe: of a value, and of the
# largest of all.
MAX_RELATIVE, MAX_OF_PEAK = 0.01, 1e-4


def check_samples(evidence: Evidence, samples: Samples) -> None:
    """Check the joint functions against ``eval``, ``pdf`` and ``sample``."""
    _check_joint(evidence, samples, "eval_pdf")
    # no integrator calls that of a plugin in Python, which this version cannot reach
    effect = "" if type(evidence.bsdf) is mi.BSDF else INTERFACE
    _check_joint(evidence, samples, "eval_pdf_sample", effect)
    own, given = samples.joint, samples.given
    wrong = (np.abs(own["wo"] - samples.wo).max(axis=1) > BSDF_ROUNDING) & given
    wrong |= unequal(own["weight"], samples.weight, 0.0)
    wrong |= unequal(own["pdf"], samples.sampled_pdf, 0.0) & given
    if beyond_rounding(wrong):
        evidence.breach(
            "eval_pdf_sample",
            "eval_pdf_sample",
            samples.fraction(wrong),
            "`eval_pdf_sample` draws other samples than `sample`",
            samples.condition.middle(wrong),
            size=float(wrong.mean()),
            off=float(wrong.mean()),
            effect=effect,
            kind=Kind.OTHER_SAMPLES,
        )


def check_lattice(evidence: Evidence, probe: Probe) -> None:
    """Check ``eval_pdf`` roughly on the whole sphere, where samples may not go."""
    wo = lattice()
    n = len(wo)
    value, pdf = probe.eval_pdf(vectors(wo))
    for alone, joint, due in (
        ("eval", spectral(value, n), probe.values(wo)),
        ("pdf", numbers(pdf, n)[:, None], probe.densities(wo)[:, None]),
    ):
        off, size = np.abs(joint - due), np.maximum(np.abs(joint), np.abs(due))
        limit = np.maximum(MAX_RELATIVE * size, MAX_OF_PEAK * size.max())
        wrong = (off > limit).any(axis=1)
        if beyond_rounding(wrong):
            light = float(4 * np.pi * off.sum(axis=1)[wrong].sum() / n)
            evidence.breach(
                "eval_pdf",
                "eval_pdf",
                f"integral of the difference {light:.3g} over {wrong.mean():.3g} of "
                f"all directions at {probe.condition}",
                f"`eval_pdf` answers otherwise than `{alone}`",
                probe.condition,
                size=float(wrong.mean()),
                off=min(light, 1.0),
                kind=Kind.EVAL_PDF_ANYWHERE,
                about=alone,
            )


def _check_joint(
    evidence: Evidence, samples: Samples, function: str, effect: str = ""
) -> None:
    """Check value and density of one joint function at sampled directions."""
    usable = np.isfinite(samples.wo).all(axis=1) & ~samples.delta
    usable &= np.abs(np.linalg.norm(samples.wo, axis=1) - 1) < BSDF_ROUNDING
    value, pdf = samples.joint[function]
    for alone, joint, due, slack in (
        ("eval", value, samples.eval, samples.eval_slack),
        ("pdf", pdf[:, None], samples.pdf[:, None], samples.pdf_slack[:, None]),
    ):
        evidence.breach_of_ratio(
            function,
            function,
            samples,
            unequal(joint, due, slack) & usable,
            ratio_of(joint, due),
            f"its value over `{alone}`",
            f"`{function}` answers otherwise than `{alone}`",
            effect=effect,
            about=alone,
        )

"""`eval_pdf` answers as `eval` and `pdf`."""

import mitsuba as mi
import numpy as np

from ...array_types import Flags, Floats
from ...single_precision import BSDF_ROUNDING
from ..evidence import BIAS, INTERFACE, SAME, Evidence, Question
from ..mistakes import Function, Guess, Kind, Mistake
from ..probe import Probe, numbers, spectral, vectors
from ..samples import Samples, beyond_rounding, ratio_of, unequal
from .answers import lattice

EVAL_PDF = Question(
    "eval_pdf", __doc__, BIAS, "path, direct, volpathmis, prb", matrices=SAME
)
EVAL_PDF_SAMPLE = Question(
    "eval_pdf_sample",
    "`eval_pdf_sample` answers as the separate functions",
    BIAS,
    "path",
    # a mistake of eval_pdf explains both
    explain=lambda evidence: next(
        (one.guess for one in evidence.of("eval_pdf")),
        evidence.guess("eval_pdf_sample"),
    ),
)


class JointFunctions(Mistake):
    """How a joint function contradicts the separate ones."""

    CHANGED = "{who} changes its arguments in place, which joint functions pass on"
    OTHER_ANSWERS = "{who} answers otherwise than `{alone}`"
    OTHER_SAMPLES = "{who} draws other samples than `sample`"


# Differences on a lattice that may be rounding of a sharp lobe: of a value, and of the
# largest of all.
MAX_RELATIVE, MAX_OF_PEAK = 0.01, 1e-4


@EVAL_PDF.asks("samples")
def check_samples(evidence: Evidence, samples: Samples) -> None:
    """Check the joint functions against ``eval``, ``pdf`` and ``sample``."""
    _check_joint(evidence, samples, EVAL_PDF)
    # no integrator calls that of a plugin in Python, which this version cannot reach
    effect = "" if type(evidence.bsdf) is mi.BSDF else INTERFACE
    _check_joint(evidence, samples, EVAL_PDF_SAMPLE, effect)
    own, given = samples.joint, samples.given
    wrong = (np.abs(own["wo"] - samples.wo).max(axis=1) > BSDF_ROUNDING) & given
    wrong |= unequal(own["weight"], samples.weight, 0.0)
    wrong |= unequal(own["pdf"], samples.sampled_pdf, 0.0) & given
    if beyond_rounding(wrong):
        guess = JointFunctions.OTHER_SAMPLES(Function.EVAL_PDF_SAMPLE)
        how = {"effect": effect, "kind": Kind.OTHER_SAMPLES}
        evidence.breach(EVAL_PDF_SAMPLE, guess, samples, wrong, **how)


def check_lattice(
    evidence: Evidence, probe: Probe, values: Floats, densities: Floats
) -> None:
    """Check ``eval_pdf`` roughly on the whole sphere, where samples may not go.

    There `values` and `densities` are the answers of the separate functions.
    """
    wo = lattice()
    n = len(wo)
    value, pdf = probe.eval_pdf(vectors(wo))
    for alone, joint, due in (
        ("eval", spectral(value, n), values),
        ("pdf", numbers(pdf, n)[:, None], densities[:, None]),
    ):
        off, size = np.abs(joint - due), np.maximum(np.abs(joint), np.abs(due))
        limit = np.maximum(MAX_RELATIVE * size, MAX_OF_PEAK * size.max())
        wrong = (off > limit).any(axis=1)
        chance = alone == "eval" and evidence.by_chance(joint, due, wo)
        if beyond_rounding(wrong) and not chance:
            light = float(4 * np.pi * off.sum(axis=1)[wrong].sum() / n)
            share, kind = float(wrong.mean()), Kind.EVAL_PDF_ANYWHERE
            guess = _guess(probe, Function.EVAL_PDF, alone, wo, joint, wrong)
            text = f"{light:.3g} over {share:.3g} of all directions"
            how = {"off": min(light, 1.0), "size": share, "kind": kind, "about": alone}
            text = f"integral of the difference {text}"
            evidence.breach(EVAL_PDF, guess, probe.condition, found=text, **how)


def _check_joint(
    evidence: Evidence, samples: Samples, question: Question, effect: str = ""
) -> None:
    """Check value and density of one joint function at sampled directions."""
    usable = np.isfinite(samples.wo).all(axis=1) & ~samples.delta
    usable &= np.abs(np.linalg.norm(samples.wo, axis=1) - 1) < BSDF_ROUNDING
    value, pdf = samples.joint[question.name]
    for alone, joint, due, slack in (
        ("eval", value, samples.eval, samples.eval_slack),
        ("pdf", pdf[:, None], samples.pdf[:, None], samples.pdf_slack[:, None]),
    ):
        if alone == "eval" and evidence.by_chance(joint, due, samples.wo):
            continue
        wrong = unequal(joint, due, slack) & usable
        if not beyond_rounding(wrong):
            continue
        probe = Probe(evidence.bsdf, samples.condition)
        asked = Function.named(question.name), alone, samples.wo, joint, wrong
        evidence.breach_of_ratio(
            question,
            _guess(probe, *asked),
            *(samples, wrong, ratio_of(joint, due), f"its value over `{alone}`"),
            effect=effect,
            about=alone,
        )


def _guess(
    probe: Probe,
    function: Function,
    alone: str,
    wo: Floats,
    joint: Floats,
    wrong: Flags,
) -> Guess:
    """What is wrong with a joint function, or with arguments that it passes on."""
    first = "eval" if alone == "pdf" else "pdf"
    answer = probe.in_turn(f"{first} {alone}", vectors(wo))
    n = len(wo)
    passed = numbers(answer, n)[:, None] if alone == "pdf" else spectral(answer, n)
    if beyond_rounding(unequal(passed, joint, 0.0) & wrong):
        return JointFunctions.OTHER_ANSWERS(function, alone=alone)
    return JointFunctions.CHANGED(Function.named(first))

"""`eval_pdf` answers as `eval` and `pdf`."""

from typing import Any

import mitsuba as mi
import numpy as np

from ...array_types import Flags, Floats
from ...single_precision import BSDF_ROUNDING
from ..arrays import Sides, drawn, full, lit, of_eval, of_pdf, rows, smooth, sphere
from ..evidence import BIAS, INTERFACE, SAME, Evidence, Question
from ..judgements import by_sample
from ..mistakes import Claim, Function, Guess, Mistake
from ..probe import Probe, full as all_elements, numbers, spectral, vectors
from ..samples import Samples, beyond_rounding, ratio_of, unequal
from .answers import lattice


def joint(bsdf: Any, ctx: Any, si: Any, u: Any, part: int, alone: Any) -> Sides:
    """`eval_pdf` answers as `eval` and `pdf`."""
    bs, weight = drawn(bsdf, ctx, si, u)
    both = bsdf.eval_pdf(ctx, si, bs.wo, True)
    due = full(alone(bsdf, ctx, si, bs.wo, u))
    return full(both[part]), due, smooth(bs, weight)


def joint_anywhere(
    bsdf: Any, ctx: Any, si: Any, u: Any, part: int, alone: Any
) -> Sides:
    """`eval_pdf` answers as `eval` and `pdf`, in all directions."""
    wo = sphere(u.y, u.z)
    both = rows(bsdf.eval_pdf(ctx, si, wo, True)[part])
    due = rows(alone(bsdf, ctx, si, wo, u))
    return both, due, np.any(both + due > 0, axis=0)


def joint_sample(bsdf: Any, ctx: Any, si: Any, u: Any, part: int, alone: Any) -> Sides:
    """`eval_pdf_sample` answers as `eval` and `pdf`."""
    bs, weight = drawn(bsdf, ctx, si, u)
    both = bsdf.eval_pdf_sample(ctx, si, bs.wo, u.x, mi.Point2f(u.y, u.z))
    due = rows(alone(bsdf, ctx, si, bs.wo, u))
    return rows(both[part]), due, smooth(bs, weight)


def same_samples(bsdf: Any, ctx: Any, si: Any, u: Any) -> Sides:
    """`eval_pdf_sample` draws the samples of `sample`."""
    bs, weight = drawn(bsdf, ctx, si, u)
    *_, own = bsdf.eval_pdf_sample(ctx, si, bs.wo, u.x, mi.Point2f(u.y, u.z))
    return rows(own), rows(weight), lit(weight)


EVAL_PDF = Question(
    "eval_pdf",
    __doc__,
    BIAS,
    "path, direct, volpathmis, prb",
    matrices=SAME,
    shown=Claim(joint, by_sample, (0, of_eval)),
)
EVAL_PDF_SAMPLE = Question(
    "eval_pdf_sample",
    "`eval_pdf_sample` answers as the separate functions",
    BIAS,
    "path",
    shown=Claim(joint_sample, by_sample, (0, of_eval)),
)


class JointFunctions(Mistake):
    """How a joint function contradicts the separate ones."""

    CHANGED = "{who} changes its arguments in place, which joint functions pass on"
    OTHER_ANSWERS = "{who} answers otherwise than `{alone}`"
    OTHER_SAMPLES = "{who} draws other samples than `sample`"


# Which answer of `eval_pdf` it is that another function has alone.
PARTS = {"eval": (0, of_eval), "pdf": (1, of_pdf)}

# Differences on a lattice that may be rounding of a sharp lobe: of a value, and of the
# largest of all.
MAX_RELATIVE, MAX_OF_PEAK = 0.01, 1e-4


@EVAL_PDF.asks("samples")
def check_samples(evidence: Evidence, samples: Samples) -> None:
    """Check the joint functions against ``eval``, ``pdf`` and ``sample``."""
    _check_joint(evidence, samples, EVAL_PDF)
    if samples.matrices:
        return
    # no integrator calls that of a plugin in Python, which this version cannot reach
    effect = "" if type(evidence.bsdf) is mi.BSDF else INTERFACE
    _check_joint(evidence, samples, EVAL_PDF_SAMPLE, effect)
    own, given = samples.joint, samples.given
    wrong = (np.abs(own["wo"] - samples.wo).max(axis=1) > BSDF_ROUNDING) & given
    wrong |= unequal(*samples.hold(same_samples)[:2], 0.0)
    wrong |= unequal(own["pdf"], samples.sampled_pdf, 0.0) & given
    if beyond_rounding(wrong):
        guess = JointFunctions.OTHER_SAMPLES(Function.EVAL_PDF_SAMPLE)
        how = {"effect": effect, "shown": Claim(same_samples, by_sample)}
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
    for alone, both, due in (
        ("eval", spectral(value, n), values),
        ("pdf", numbers(pdf, n)[:, None], densities[:, None]),
    ):
        off, size = np.abs(both - due), np.maximum(np.abs(both), np.abs(due))
        limit = np.maximum(MAX_RELATIVE * size, MAX_OF_PEAK * size.max())
        wrong = (off > limit).any(axis=1)
        chance = alone == "eval" and evidence.by_chance(both, due, wo)
        if beyond_rounding(wrong) and not chance:
            light = float(4 * np.pi * off.sum(axis=1)[wrong].sum() / n)
            share, shown = float(wrong.mean()), Claim(joint_anywhere, by_sample)
            guess = _guess(probe, Function.EVAL_PDF, alone, wo, both, wrong)
            text = f"{light:.3g} over {share:.3g} of all directions"
            how = {
                "off": min(light, 1.0),
                "size": share,
                "shown": shown.of(*PARTS[alone]),
            }
            text = f"integral of the difference {text}"
            evidence.breach(EVAL_PDF, guess, probe.condition, found=text, **how)


def _check_joint(
    evidence: Evidence, samples: Samples, question: Question, effect: str = ""
) -> None:
    """Check value and density of one joint function at sampled directions."""
    usable = np.isfinite(samples.wo).all(axis=1) & ~samples.delta
    usable &= np.abs(np.linalg.norm(samples.wo, axis=1) - 1) < BSDF_ROUNDING
    stated = joint if question is EVAL_PDF else joint_sample
    for alone, slack in (
        ("eval", samples.eval_slack),
        ("pdf", samples.pdf_slack[:, None]),
    ):
        own, due, _ = samples.hold(stated, *PARTS[alone])
        if alone == "eval" and evidence.by_chance(own, due, samples.wo):
            continue
        wrong = unequal(own, due, slack) & usable
        if not beyond_rounding(wrong):
            continue
        probe = Probe(evidence.bsdf, samples.condition)
        asked = Function.named(question.name), alone, samples.wo, own, wrong
        evidence.breach_of_ratio(
            question,
            _guess(probe, *asked),
            *(samples, wrong, ratio_of(own, due), f"its value over `{alone}`"),
            effect=effect,
            shown=Claim(stated, by_sample, PARTS[alone]),
        )


def _guess(
    probe: Probe,
    function: Function,
    alone: str,
    wo: Floats,
    both: Floats,
    wrong: Flags,
) -> Guess:
    """What is wrong with a joint function, or with arguments that it passes on."""
    first = "eval" if alone == "pdf" else "pdf"
    answer = probe.in_turn(f"{first} {alone}", vectors(wo))
    n = len(wo)
    passed = numbers(answer, n)[:, None] if alone == "pdf" else all_elements(answer, n)
    if beyond_rounding(unequal(passed, both, 0.0) & wrong):
        return JointFunctions.OTHER_ANSWERS(function, alone=alone)
    return JointFunctions.CHANGED(Function.named(first))

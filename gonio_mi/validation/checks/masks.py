"""Inactive rays carry no light, active ones the same as without a mask."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from ..arrays import (
    Sides,
    drawn,
    of_eval,
    of_eval_pdf,
    of_joint_pdf,
    of_pdf,
    of_weight,
    rows,
)
from ..conditions import Condition
from ..evidence import INTERFACE, Evidence, Question
from ..judgements import by_sample
from ..mistakes import EVAL, EVAL_PDF, PDF, SAMPLE, Claim, Mistake
from ..samples import samples_of, unequal


def masks(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any) -> Sides:
    """Every other ray is inactive: it gets 0, and the others the same as without."""
    bs, _ = drawn(bsdf, ctx, si, u)
    plain = rows(what(bsdf, ctx, si, bs.wo, u))
    active = np.arange(plain.shape[-1]) % 2 == 0
    masked = rows(what(bsdf, ctx, si, bs.wo, u, mi.Bool(active)))
    return masked, np.where(active, plain, 0), True


MASKS = Question(
    "masks",
    __doc__,
    INTERFACE,
    volumes="active rays get the same as without a mask",
    rank=2,
    shown=Claim(masks, by_sample, (of_weight,)),
)


class Masks(Mistake):
    """Mistakes in masks."""

    IGNORED = "{who} ignores `active`: inactive rays get a value"
    OF_OTHERS = "{who} answers active rays differently when others are not"


# What is asked of each function.
ASKED = (
    (SAMPLE, of_weight),
    (EVAL, of_eval),
    (PDF, of_pdf),
    (EVAL_PDF, of_eval_pdf),
    (EVAL_PDF, of_joint_pdf),
)

# Of phase functions that answer inactive rays.
OF_VOLUMES = (
    "remark, no effect on images: inactive rays get a value, as of all of Mitsuba's "
    "own phase functions"
)


@MASKS.asks("bsdf")
def check_bsdf(evidence: Evidence) -> None:
    """Check answers where every other ray is inactive.

    A density for an inactive ray gets a remark only, for nobody uses it.
    """
    condition, n = Condition(40.0, 25.0), 2**10
    samples = samples_of(evidence.bsdf, condition, n, (evidence.seed, 41))
    active = np.arange(n) % 2 == 0
    for function, what in ASKED:
        masked, due, _ = samples.hold(masks, what)
        usable = active & np.isfinite(due.sum(axis=1))
        changed = unequal(masked, due, 0.0) & usable
        if evidence.noisy and what in (of_eval, of_eval_pdf):
            changed[:] = False  # by chance
        awake = ~active & (masked != 0).any(axis=1)
        if what in (of_pdf, of_joint_pdf):
            if function is PDF and awake.any():
                text = "`pdf` gives inactive rays a value, which nobody uses"
                evidence.remark("masks", text)
            awake[:] = False
        for wrong, mistake in ((awake, Masks.IGNORED), (changed, Masks.OF_OTHERS)):
            if wrong.any() and evidence.of_volumes and mistake is Masks.IGNORED:
                evidence.remarks["masks"] = [OF_VOLUMES]  # of `pdf` too
            elif wrong.any():
                text, size = f"{wrong.sum()} of {n // 2} rays", float(wrong.mean())
                how = {"found": text, "size": size}
                how["shown"] = Claim(masks, by_sample, (what,))
                evidence.breach(MASKS, mistake(function), condition, **how)

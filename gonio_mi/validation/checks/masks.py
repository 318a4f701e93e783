"""Inactive rays carry no light, active ones the same as without a mask."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..conditions import Condition
from ..evidence import INTERFACE, Evidence, Question
from ..mistakes import EVAL, PDF, SAMPLE, Function, Kind, Mistake
from ..probe import Probe, numbers, spectral, vectors
from ..samples import samples_of, unequal

MASKS = Question(
    "masks",
    __doc__,
    INTERFACE,
    volumes="active rays get the same as without a mask",
    rank=2,
)


class Masks(Mistake):
    """Mistakes in masks."""

    IGNORED = "{who} ignores `active`: inactive rays get a value"
    OF_OTHERS = "{who} answers active rays differently when others are not"


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
    probe = Probe(evidence.bsdf, condition)
    mask = dr.arange(mi.UInt32, n) % 2 == 0
    active = mask.numpy()
    wo = vectors(samples.wo)
    joint = probe.eval_pdf(wo, mask)
    _, weight = probe.sample(*samples.random, mask)
    answers = [
        (SAMPLE, weight, samples.weight),
        (EVAL, probe.eval(wo, mask), samples.eval),
        (PDF, probe.pdf(wo, mask), samples.pdf),
        (Function.EVAL_PDF, joint[0], samples.joint["eval_pdf"][0]),
        (Function.EVAL_PDF, joint[1], samples.joint["eval_pdf"][1]),
    ]
    if numbers(answers[2][1], n)[~active].any():
        evidence.remark("masks", "`pdf` gives inactive rays a value, which nobody uses")
    for function, masked, plain in answers:
        flat = np.ndim(plain) == 1
        masked = numbers(masked, n) if flat else spectral(masked, n)
        usable = active & np.isfinite(plain if flat else plain.sum(axis=1))
        changed = unequal(masked.astype(float), plain, 0.0) & usable
        if evidence.noisy and function is not SAMPLE and not flat:
            changed[:] = False  # by chance
        light = np.zeros(n) if flat else np.abs(masked).sum(axis=1)
        awake = ~active & (light != 0)
        for wrong, mistake, kind in (
            (awake, Masks.IGNORED, Kind.MASKS),
            (changed, Masks.OF_OTHERS, Kind.MASKS_OF_OTHERS),
        ):
            if wrong.any() and evidence.of_volumes and mistake is Masks.IGNORED:
                evidence.remarks["masks"] = [OF_VOLUMES]  # of `pdf` too
            elif wrong.any():
                text, size = f"{wrong.sum()} of {n // 2} rays", float(wrong.mean())
                how = {"found": text, "size": size, "kind": kind}
                evidence.breach(MASKS, mistake(function), condition, **how)

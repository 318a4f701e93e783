"""Masks: inactive rays get 0, active ones the same as without a mask."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ..conditions import Condition
from ..evidence import Evidence
from ..kinds import Kind
from ..probe import Probe, numbers, spectral, vectors
from ..samples import samples_of, unequal


def check_bsdf(evidence: Evidence) -> None:
    """Check answers where every other ray is inactive.

    A density for an inactive ray gets a remark only, for nobody uses it.
    """
    condition, n = Condition(40.0, 25.0), 2**10
    samples = samples_of(evidence.bsdf, condition, n, (evidence.seed, 41))
    probe = Probe(evidence.bsdf, condition)
    active = np.arange(n) % 2 == 0
    mask = mi.Bool(active)
    wo = vectors(samples.wo)
    joint = probe.eval_pdf(wo, mask)
    _, weight = probe.sample(*samples.random, mask)
    answers = [
        ("sample", weight, samples.weight),
        ("eval", probe.eval(wo, mask), samples.eval),
        ("pdf", probe.pdf(wo, mask), samples.pdf),
        ("eval_pdf", joint[0], samples.joint["eval_pdf"][0]),
        ("eval_pdf", joint[1], samples.joint["eval_pdf"][1]),
    ]
    if numbers(answers[2][1], n)[~active].any():
        evidence.remark("masks", "`pdf` gives inactive rays a value, which nobody uses")
    for function, masked, plain in answers:
        flat = np.ndim(plain) == 1
        masked = numbers(masked, n) if flat else spectral(masked, n)
        usable = active & np.isfinite(plain if flat else plain.sum(axis=1))
        changed = unequal(masked.astype(float), plain, 0.0) & usable
        light = np.zeros(n) if flat else np.abs(masked).sum(axis=1)
        awake = ~active & (light != 0)
        active_too = "answers active rays differently when others are not"
        for wrong, what, kind in (
            (awake, "ignores `active`: inactive rays get a value", Kind.MASKS),
            (changed, active_too, Kind.MASKS_OF_OTHERS),
        ):
            if wrong.any():
                evidence.breach(
                    "masks",
                    function,
                    f"{wrong.sum()} of {n // 2} rays at {condition}",
                    f"`{function}` {what}",
                    condition,
                    kind=kind,
                    size=float(wrong.mean()),
                )

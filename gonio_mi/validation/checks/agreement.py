"""Checks that functions agree: for samples, over a sweep of incidence, and again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..conditions import Effort, Sweep
from ..evidence import PHASE, Evidence
from ..probe import Probe
from ..samples import Samples, samples_of
from . import (
    answers,
    cost,
    directions,
    eval_pdf,
    sampled_pdf,
    sampled_weight,
    sampling,
    weights,
)


def check_identities(evidence: Evidence, samples: Samples) -> None:
    """Check that the functions agree about the same directions."""
    for check in (answers, directions, weights, sampled_pdf, sampled_weight):
        check.check_samples(evidence, samples)
    if evidence.properties is not PHASE:
        eval_pdf.check_samples(evidence, samples)


def check_sweep(evidence: Evidence, plan: Effort, sides: Sequence[str]) -> None:
    """Check agreement and sampled directions over a sweep of incident directions."""
    key = (evidence.seed, 4)
    sweep = Sweep(side=sides[0], both=len(sides) > 1, n=plan.checked)
    samples = samples_of(evidence.bsdf, sweep, sweep.n, key)
    evidence.sweeps.append(samples)
    check_identities(evidence, samples)
    sampling.check_sweep(evidence, replace(sweep, n=plan.swept), key)


def check_again(evidence: Evidence, plan: Effort, sides: Sequence[str]) -> None:
    """Check a sweep, then that the first samples get the same answers after it.

    Answers may depend neither on the order of rays nor on the surface's rotation.
    """
    first = evidence.samples[0]
    probe = Probe(evidence.bsdf, first.condition)
    pdf, value = probe.densities(first.wo), probe.values(first.wo)
    check_sweep(evidence, plan, sides)
    key = (evidence.seed, 1, 0)  # with which those were drawn
    again = cost.check_compiled(evidence, first.condition, plan.checked, key)
    answers.check_memory(evidence, first, (value, pdf), again)
    if not evidence.of("answers"):
        answers.check_order(evidence, evidence.sweeps[0])
    answers.check_frames(evidence)

"""Checks that functions agree: for samples, over a sweep of incidence, and again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mitsuba as mi
import numpy as np

from ..conditions import Effort, Sweep
from ..evidence import Evidence
from ..probe import Probe, numbers, spectral
from ..samples import Samples, beyond_rounding, samples_of, unequal
from . import answers, cost, sampling


def check_identities(evidence: Evidence, samples: Samples) -> None:
    """Check that the functions agree about the same directions, in both modes.

    In radiance mode only if it is not importance mode over eta^2.
    """
    evidence.ask("samples", samples)
    condition = samples.condition
    whole = condition.mode == "importance" and condition.component is None
    if whole and _modes_disagree(evidence.bsdf, samples):
        radiance, key = replace(condition, mode="radiance"), (evidence.seed, 8)
        other = samples_of(evidence.bsdf, radiance, samples.n, key)
        evidence.in_radiance_mode.append(other)
        evidence.ask("samples", other)


def _modes_disagree(bsdf: mi.BSDF, samples: Samples) -> bool:
    """Whether answers about samples differ between the modes by more than eta^2."""
    probe = Probe(bsdf, replace(samples.condition, mode="radiance"))
    bs, weight = probe.sample(*samples.random)
    n = samples.n
    light = spectral(weight, n)
    given = samples.given | (light != 0).any(axis=1)
    eta2 = np.where(samples.reflected, 1.0, samples.eta**2)[:, None]
    slack = samples.eval_slack * (1 + eta2)
    differs = unequal(light * eta2, samples.weight, 0.0)
    differs |= unequal(spectral(bs.wo, n), samples.wo, 0.0)
    differs |= unequal(numbers(bs.pdf, n), samples.sampled_pdf, 0.0)
    differs |= unequal(eta2 * samples.other_mode, samples.eval, slack)
    differs |= unequal(probe.densities(samples.wo), samples.pdf, samples.pdf_slack)
    return beyond_rounding(differs & given)


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

"""Checks that functions agree: for samples, over a sweep of incidence, and again."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..conditions import FIELDS, Effort, Sweep
from ..evidence import BIAS, MAX_P, Evidence
from ..judgements import by_sample
from ..mistakes import Claim
from ..probe import Probe, numbers, spectral
from ..samples import Samples, beyond_rounding, samples_of, unequal
from . import answers, cost

# What a sweep tells of properties that hold.
TOLD = ("undecided", "downgraded", "remarks")

# Rays of a preview, and of a large wavefront, of which so many differ.
FEW, MANY, SAME = 300, 2**22 + 2**10, 2**10


def check_identities(evidence: Evidence, samples: Samples) -> None:
    """Check that the functions agree about the same directions, in both modes.

    In radiance mode only if it is not importance mode over eta^2.
    """
    evidence.ask("samples", samples)
    condition = samples.condition
    whole = condition.mode == "importance" and condition.component is None
    whole = whole and not samples.matrices  # which are asked in both modes
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
    """Check agreement and sampled directions over a sweep of incident directions.

    Each sample has its own surroundings, too. What fails is asked again without these,
    and where that tells another, with each of their fields alone.
    """
    sweep = Sweep(side=sides[0], both=len(sides) > 1, n=plan.lanes, fields=FIELDS)
    found = _swept(evidence, sweep, plan)
    if evidence.samples and _failing(found):
        usual = _swept(evidence, replace(sweep, fields=()), plan)
        new = _failing(found) - _failing(usual)
        for field in FIELDS if new else ():
            alone = _swept(evidence, replace(sweep, fields=(field,)), plan)
            if names := _failing(alone) - _failing(usual):
                answers.add_field(alone, field, names)
                found = alone
                break
        found = found if new else usual
        if "sampled_weight" in new:
            # what changes with a field is no noise, even if its mean is 0
            found.change(found.of("sampled_weight"), effect=BIAS)
    for name in ("breaches", "tests", "sweeps", "in_radiance_mode"):
        getattr(evidence, name).extend(getattr(found, name))
    for name in TOLD:
        getattr(evidence, name).update(getattr(found, name))


def _swept(evidence: Evidence, sweep: Sweep, plan: Effort) -> Evidence:
    """What a sweep alone finds."""
    key = (evidence.seed, 4)
    own = {name: deepcopy(getattr(evidence, name)) for name in TOLD}
    found = replace(
        evidence, breaches=[], tests=[], sweeps=[], in_radiance_mode=[], **own
    )
    samples = samples_of(evidence.bsdf, sweep, sweep.n, key)
    found.sweeps.append(samples)
    check_identities(found, samples)
    found.ask("sweep", replace(sweep, n=plan.swept), key)
    return found


def _failing(found: Evidence) -> set[str]:
    """Properties that are certainly lacking, whatever the effect."""
    return {breach.name for breach in found.breaches} | {
        test.name for test in found.tests if test.p < MAX_P
    }


def check_again(evidence: Evidence, plan: Effort, sides: Sequence[str]) -> None:
    """Check a sweep, then that the first samples get the same answers after it.

    Answers may depend neither on the order and number of rays nor on the surface's
    rotation.
    """
    first, mistakes = evidence.samples[0], answers.Answers
    check_sweep(evidence, plan, sides)
    key = (evidence.seed, 1, 0)  # with which those were drawn
    cost.check_compiled(evidence, first.condition, plan.checked, key)
    check_memory(evidence, exact=True)
    if not any(breach.effect == BIAS for breach in evidence.of("answers")):
        swept, number = evidence.sweeps[0], Claim(answers.together, by_sample)
        backwards = swept.n - 1 - dr.arange(mi.UInt32, swept.n)
        order = mistakes.OF_ORDER, Claim(answers.backwards, by_sample)
        answers.check_same(evidence, swept, *order, backwards)
        # many take a quarter of a second
        numbers = (FEW,) if plan is Effort.named("quick") else (FEW, MANY)
        for n in numbers:
            i = dr.arange(mi.UInt32, n) % SAME
            answers.check_same(evidence, swept, mistakes.OF_NUMBER, number.of(n), i)
    answers.check_frames(evidence)


def check_memory(evidence: Evidence, exact: bool = False) -> None:
    """Check that answers about the first samples do not depend on earlier calls.

    They may be `exact` only until parameters are changed: these are literals of
    kernels before, and rounded otherwise.
    """
    if not evidence.of("answers"):
        how = answers.Answers.OF_CALLS, Claim(answers.again, by_sample)
        answers.check_same(evidence, evidence.samples[0], *how, exact=exact)

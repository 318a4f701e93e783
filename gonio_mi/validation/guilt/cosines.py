"""Wrong cosines of ``eval``, of all of it or of one lobe, where it is not reciprocal.

A right lobe is ``f cos_o``, where f is the same with wi and wo exchanged; one whose
``eval cos_i^k`` is the same exchanged, within rounding, has another power of a cosine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mitsuba as mi
import numpy as np

from ...array_types import Flags, Floats
from ...collector.directions import direction
from ...single_precision import BSDF_ROUNDING
from ...specimen.bsdf_trial import PluginFault
from ..conditions import Condition
from ..mistakes import EVAL, Guess, Mistake
from ..probe import Probe, changed, number_parameters
from ..samples import SLACK, Samples, beyond_rounding, unequal
from .case import Case


class Cosine(Mistake):
    """Wrong cosines of a `part`, or what would look so to all that was asked."""

    LACKS = "{who} lacks the factor cos(theta_o), or division by cos(theta_i){part}"
    TWICE = """{who} has an extra factor cos(theta_o), or an extra division by
        cos(theta_i){part}"""
    OF_WI = "{who} has cos(theta_i) in place of cos(theta_o){part}"
    OF_A_LOBE = """{before}; the same asymmetry would result from one of several lobes
        that {words}; validate each lobe alone (ctx.component, or set the other
        reflectances to 0)"""


# Mistake by the power k of which ``eval cos(theta_i)^k`` is the same with wi and wo
# exchanged, apart from eta^2; 1 is right.
COSINES = {0: Cosine.LACKS, 2: Cosine.TWICE, -1: Cosine.OF_WI}

# Fraction of the samples that must contradict reciprocity somewhere: an identity that
# few of them tell from it says nothing.
MIN_CONTRADICTED = 0.2

# Cosine of wo next to the horizon, azimuths there, angles of incidence in degrees at
# which even narrow lobes reach it, and the fraction of a value that must be left when
# wo falls to it.
HORIZON, N_AZIMUTHS, GRAZING, MIN_LEFT = 1e-3, 64, (60.0, 70.0, 80.0), 0.9

# Largest difference of exponents of a single law of the cosines, which no sum of two
# lobes follows; and the least logarithm of a ratio of cosines that tells exponents.
MAX_EXPONENT_RANGE, MIN_LOG_RATIO = 0.01, 0.1


def of_the_whole(case: Case) -> Guess | None:
    """All of ``eval``."""
    return _wrong_cosine(_asymmetric(case), "")


def of_a_component(case: Case) -> Guess | None:
    """One component on its own, which declares no other law."""
    bsdf, samples = case.evidence.bsdf, case.evidence.samples
    for i in range(bsdf.component_count()):
        own = [one for one in samples if one.condition.component == i]
        declared = int(bsdf.flags(i)) & int(mi.BSDFFlags.NonSymmetric)
        guess = _wrong_cosine(own, f", in its component {i}")
        if guess and not declared:
            return guess
    return None


def of_a_parameter(case: Case) -> Guess | None:
    """The part of ``eval`` that a parameter changes."""
    bsdf, whole = case.evidence.bsdf, _asymmetric(case)
    try:
        for name, value in number_parameters(bsdf)[1].items():
            if not np.any(np.array(value)):
                continue
            with changed(bsdf, {name: type(value)(0.5 * value)}):
                parts = [_part(bsdf, samples) for samples in whole]
            text = f", in the part of it that the parameter {name} changes"
            if guess := _wrong_cosine(parts, text):
                return guess
    except PluginFault:
        pass  # a property of its own
    return None


def at_the_horizon(case: Case) -> Guess | None:
    """One lobe that cannot be asked alone, and stays lit as wo falls to the horizon."""
    bsdf, whole = case.evidence.bsdf, _asymmetric(case)
    lit = [
        Condition(theta, 25.0, side)
        for side in {samples.condition.side for samples in whole}
        for theta in GRAZING
    ]
    for power in (0, -1) if lit else ():
        if all(_is_sum(samples, power) for samples in whole) and all(
            _stays_lit(bsdf, condition, power) for condition in lit
        ):
            part = "it does not fall to 0 as wo falls to the horizon"
            return COSINES[power](EVAL, part=f", in one lobe of several: {part}")
    return None


def of_a_lobe(case: Case) -> Guess | None:
    """A law of the model, or one lobe that cannot be asked alone."""
    whole = _asymmetric(case)
    for power in COSINES:
        if all(_is_sum(one, power) for one in whole) and not _is_one_law(whole):
            words = COSINES[power].sentence.format(who="", part="").strip()
            before = max(case.asymmetries, key=lambda one: one.size).guess
            return Cosine.OF_A_LOBE(EVAL, before=str(before), words=words)
    return None


def _asymmetric(case: Case) -> list[Samples]:
    """Samples of the whole from sides on which it is not reciprocal."""
    whole = [s for s in case.evidence.whole if s.condition.mode == "importance"]
    # a face of its own may be right
    wrong = {one.condition.side for one in whole if beyond_rounding(_unexplained(one))}
    return [one for one in whole if one.condition.side in wrong]


def _part(bsdf: mi.BSDF, samples: Samples) -> Samples:
    """Samples with the values by which a change of parameters reduces ``eval``."""
    probe = Probe(bsdf, samples.condition)
    there = probe.values(samples.wo)
    back = _reversed(probe, samples.wo)

    def _slack(slack: Floats, value: Floats) -> Floats:
        # of two values, each with its rounding
        return 2 * (slack + BSDF_ROUNDING / SLACK * np.abs(value))

    return replace(
        samples,
        eval=samples.eval - there,
        reverse=samples.reverse - back,
        eval_slack=_slack(samples.eval_slack, samples.eval),
        reverse_slack=_slack(samples.reverse_slack, samples.reverse),
    )


def _reversed(probe: Probe, wo: Floats) -> Floats:
    """``eval`` with wi and wo exchanged."""
    return probe.values(np.broadcast_to(probe.condition.wi, wo.shape), wo)


def _stays_lit(bsdf: mi.BSDF, condition: Condition, power: int) -> bool:
    """Whether a lobe of that power remains as wo falls to the horizon.

    One azimuth is enough, for a narrow lobe. A right lobe, with a finite f, falls with
    the cosine of wo.
    """
    phi = 2 * np.pi * np.arange(N_AZIMUTHS) / N_AZIMUTHS + np.radians(condition.phi_i)
    low, high = (
        direction(np.arccos(cosine), phi) * np.sign([1, 1, condition.wi[2]])
        for cosine in (HORIZON, 2 * HORIZON)
    )
    wo, probe = np.concatenate([low, high]), Probe(bsdf, condition)
    first, second = probe.values(wo).sum(axis=1).reshape(2, N_AZIMUTHS)
    back = _reversed(probe, wo)[:N_AZIMUTHS].sum(axis=1)
    cos_i, cos_o = abs(condition.wi[2]), HORIZON
    determinant = cos_o * cos_i**power - cos_i * cos_o**power
    wrong = (cos_o * back - cos_i * first) / determinant * cos_o**power
    left = np.minimum(wrong, 2 * first - second)
    return bool(((first > 0) & (left > MIN_LEFT * first)).any())


def _wrong_cosine(ways: Sequence[Samples], part: str) -> Guess | None:
    """Mistake of a power that explains all samples, if the right one does not."""
    contradicted = [_unexplained(samples).mean() for samples in ways]
    if max(contradicted, default=0.0) < MIN_CONTRADICTED:
        return None
    for power in COSINES:
        if not any(beyond_rounding(_unexplained(samples, power)) for samples in ways):
            return COSINES[power](EVAL, part=part)
    return None


def _unexplained(samples: Samples, power: int = 1) -> Flags:
    """Mask of samples whose ``eval cos_i^power`` changes if wi and wo are exchanged."""
    there, back, slack, smooth = _both_ways(samples, power)
    # a value that is not finite is unequal to all
    finite = np.isfinite(there).all(axis=1) & np.isfinite(back).all(axis=1)
    return smooth & (unequal(there, back, slack) | ~finite)


def _both_ways(samples: Samples, power: int) -> tuple[Floats, Floats, Floats, Flags]:
    """Return ``eval cos_i^power`` there and back, their slack, and smooth samples."""
    cos_i, cos_o, smooth = _cosines(samples)
    eta2 = np.where(samples.reflected, 1.0, samples.eta**2)[:, None]
    there, back = cos_i**power, eta2 * cos_o**power
    slack = samples.eval_slack * there + samples.reverse_slack * back
    return samples.eval * there, samples.reverse * back, slack, smooth


def _cosines(samples: Samples) -> tuple[float, Floats, Flags]:
    """Cosine of wi, those of wo of shape ``(n, 1)``, and which samples are smooth."""
    cos_i, cos_o = float(abs(samples.condition.wi[2])), np.abs(samples.wo[:, 2])
    smooth = samples.smooth & (cos_o > 1e-4)
    return cos_i, np.where(smooth, cos_o, 1.0)[:, None], smooth


def _is_sum(samples: Samples, power: int) -> bool:
    """Whether the sum of a lobe of that power and a right one explains all values.

    Values both ways are two equations for the two lobes, neither of which may be
    negative.
    """
    cos_i, cos_o, smooth = _cosines(samples)
    up = cos_o * cos_i**power > cos_i * cos_o**power
    wrong = np.zeros(samples.n, dtype=bool)
    for other, rising in ((power, up), (1, ~up)):
        there, back, slack, _ = _both_ways(samples, other)
        extreme = np.where(rising, np.maximum(there, back), np.minimum(there, back))
        wrong |= unequal(there, extreme, slack) | ~np.isfinite(there + back).all(axis=1)
    return not beyond_rounding(wrong & smooth)


def _is_one_law(ways: Sequence[Samples]) -> bool:
    """Whether a single power of the cosines, a whole number or not, explains all."""
    exponents = []
    for samples in ways:
        cos_i, cos_o, smooth = _cosines(samples)
        there, back, _, _ = _both_ways(samples, 0)
        there, back, ratio = there.sum(axis=1), back.sum(axis=1), cos_o[:, 0] / cos_i
        known = smooth & (there > 0) & (back > 0)
        known &= np.abs(np.log(ratio)) > MIN_LOG_RATIO
        exponents.append(np.log(there[known] / back[known]) / np.log(ratio[known]))
    low, high = np.quantile(np.concatenate(exponents), [0.02, 0.98])
    return bool(high - low < MAX_EXPONENT_RANGE)

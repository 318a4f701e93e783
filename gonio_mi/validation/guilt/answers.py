"""Answers about samples that contradict each other, or gain light: which is wrong.

Weight times pdf is one account of the BSDF, ``eval`` another. Where they differ, each
may be wrong, unless one of them gains flux that the other does not, or is reciprocal
where the other is not, or depends on the lobe that was picked.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import mitsuba as mi
import numpy as np

from ...array_types import Floats
from ..checks.answers import Answers, asked_again
from ..checks.energy import Energy
from ..conditions import Sweep
from ..maps import FourMaps
from ..mistakes import EVAL, PDF, SAMPLE, Guess
from ..probe import Probe, is_delta, numbers, spectral, uniform
from ..samples import Samples, agree
from .case import Case, Diagnosis
from .ratios import Factor, Ratio, is_one

# Pairs of directions that are exchanged, samples of the way back, the cosine of the
# angle within which such a sample is near to that way, and how many there must be.
N_PAIRS = 24
N_BACK = 2**16
MIN_COSINE = np.cos(np.radians(3.0))
MIN_NEARBY = 12

# Logarithms of ratios that are as good as 0, and such that are not; the fraction of the
# pairs that must be the one for a reciprocal account, the other for one that is not.
MAX_LOG_SAME, MIN_LOG_OTHER = 0.03, 0.1
MIN_SAME, MIN_OTHER = 0.9, 0.15

# Flux of a discrete lobe beyond which it gains light.
MAX_FLUX = 1 + 1e-4

# Sum of squared scores that counts of directions may hide.
MAX_UNSEEN = 100

# Colours that may be exchanged, by the order of channels that takes it back.
COLOURS = {
    "red and blue": [2, 1, 0],
    "red and green": [1, 0, 2],
    "green and blue": [0, 2, 1],
}


def _fluxes(maps: Sequence[FourMaps]) -> Floats:
    """By map, what ``eval``, discrete lobes and all weights scatter at most."""
    each = [(m.smooth_flux, m.totals.delta_mean, m.totals.mean) for m in maps]
    return np.array([[x.max() for x in one] for one in each]).reshape(-1, 3)


def discrete_lobe(case: Case) -> Guess | None:
    """A discrete lobe of other weight than that of its component, which gains none."""
    own = [b.guess for b in case.evidence.of("components")]
    own = [guess for guess in own if guess.functions is SAMPLE]
    most = _fluxes(case.maps)[:, 1].max(initial=0)
    return own[0] if own and 0 < most <= MAX_FLUX else None


def gained_light(case: Case) -> Guess:
    """``eval`` or the weights of discrete lobes gain or lose light."""
    smooth, discrete, _ = _fluxes(case.maps).T
    function = SAMPLE if discrete.max(initial=0) > MAX_FLUX else EVAL
    albedo = max(smooth + discrete, default=1.0)
    # a phase function absorbs nothing
    albedo = min(smooth + discrete) if albedo < 1 else albedo
    return Energy.NOT_CONSERVED(function, found=f"albedo {albedo:.4g}")


def slightly_off(case: Case) -> Guess | None:
    """One of both pdfs is wrong, by less than counts of directions tell."""
    each = []
    for samples in (*case.evidence.whole, *case.evidence.sweeps):
        own = samples.usable & (samples.pdf > 0)
        ratio = samples.sampled_pdf[own] / samples.pdf[own]
        each.append(np.mean((ratio - 1) ** 2) if own.any() else 0.0)
    off = float(max(each, default=0.0)) ** 0.5
    n = max((maps.totals.n for maps in case.evidence.maps), default=0)
    hidden = n * off**2 < MAX_UNSEEN
    return Diagnosis.SLIGHTLY(SAMPLE | PDF, off=off) if hidden else None


def returned_pdf(case: Case) -> Guess | None:
    """The pdf that `sample` returns, where its weights are ``eval`` over ``pdf``."""
    for one in case.densities.each:
        own = one.samples
        if not agree(own.flux, own.eval, own.eval_slack, one.wrong):
            return case.densities.blame(SAMPLE)
    return None


def wrong_mixture(case: Case) -> Guess | None:
    """``pdf`` is that of one component, or their sum, and not their mixture."""
    each, samples = case.apart, case.evidence.whole[0]
    if each is None or each.pdf.any(axis=1).sum() < 2:
        return None  # no component can be asked alone, or one is all

    def is_whole(density: Floats) -> bool:
        return agree(density, samples.pdf, samples.pdf_slack, samples.smooth)

    own = [i for i, density in enumerate(each.pdf) if is_whole(density)]
    if len(own) == 1:
        return Diagnosis.ONE_COMPONENT(PDF, component=own[0])
    whole = not own and is_whole(each.pdf.sum(axis=0))
    return Diagnosis.PLAIN_SUM(PDF) if whole else None


def changed_answers(case: Case) -> Guess | None:
    """What answers otherwise than where weights and ``eval`` still agreed."""
    first = case.evidence.whole[0]
    probe = Probe(case.evidence.bsdf, first.condition)
    return next(map(Answers.OF_CALLS, asked_again(first, probe, exact=True)), None)


def exchanged_colours(case: Case) -> Guess | None:
    """Two colours that weights and ``eval`` exchange."""
    samples, ok = case.light.each[0].samples, case.light.each[0].mask

    def is_right(order: list[int]) -> bool:
        value, slack = samples.eval[:, order], samples.eval_slack[:, order]
        return agree(samples.flux_by_pdf, value, slack, ok)

    if samples.eval.shape[1] != 3 or is_right([0, 1, 2]):
        return None
    right = [words for words, order in COLOURS.items() if is_right(order)]
    return Factor.COLOURS(EVAL | SAMPLE, colours=right[0]) if right else None


def lobe_alone(case: Case) -> Guess | None:
    """Each weight is that of the picked component as if it were alone."""
    bsdf, samples = case.evidence.bsdf, case.evidence.samples[0]
    if bsdf.component_count() < 2 or samples.condition.component is not None:
        return None
    ratios = []
    for i in range(bsdf.component_count()):
        own = samples.smooth & (samples.component == i)
        if own.any():
            probe = Probe(bsdf, replace(samples.condition, component=i))
            value = probe.values(samples.wo)[own].sum(axis=1)
            over = samples.weight[own].sum(axis=1) * probe.densities(samples.wo)[own]
            ratios.append(over / np.maximum(value, 1e-30))
    if len(ratios) < 2 or not is_one(np.concatenate(ratios)):
        return None
    return Factor.OF_LOBE_ALONE(SAMPLE)


def whoever_gains(case: Case) -> Guess | None:
    """The one of both that gains light, where the other does not."""
    whole = [m for m in case.maps if m.condition.mode == "importance"]
    flux, discrete, mean = _fluxes(whole).max(axis=0, initial=0)
    if flux + discrete > 1.001 > mean:
        return case.light.blame(EVAL)
    return case.light.blame(SAMPLE) if mean > 1.001 > flux + discrete else None


def whoever_is_asymmetric(case: Case) -> Guess | None:
    """The one of both that is not reciprocal, where the other is.

    Weights are known only for samples. So light is sent back along some samples, and
    the directions that come near to the incident one are compared.
    """
    usable = [
        one
        for one in case.light.each
        if one.samples.condition.mode == "importance"
        if not isinstance(one.samples.condition, Sweep)
    ]
    # neither steep nor grazing, where all is symmetric or nothing is met
    usable.sort(key=lambda one: abs(one.samples.condition.theta_i - 45))
    pairs: list[tuple[float, float, float]] = []
    for ratio in usable[:4]:
        if len(pairs) < N_PAIRS:
            pairs += _pairs_of(case.evidence.bsdf, ratio)
    if len(pairs) < N_PAIRS // 2:
        return None
    by_eval, by_weights, slack = np.abs(np.array(pairs)).T
    either = (SAMPLE, by_eval, by_weights), (EVAL, by_weights, by_eval)
    for guilty, right, wrong in either:
        same = np.mean(right < MAX_LOG_SAME + slack)
        other = np.mean(wrong > MIN_LOG_OTHER + slack)
        if same > MIN_SAME and other > MIN_OTHER:
            return case.light.blame(guilty)
    return None


def _pairs_of(bsdf: mi.BSDF, ratio: Ratio) -> Iterator[tuple[float, float, float]]:
    """Logarithms for some samples: of ``eval`` and weights both ways, and their slack.

    0 for an account that is reciprocal.
    """
    own, index = ratio.samples, np.flatnonzero(ratio.mask)
    # of sums over channels, as those of the way back
    logs = np.log(own.flux_by_pdf[index].sum(axis=1) / own.eval[index].sum(axis=1))
    wrong = own.reflected[index] & (np.abs(logs) > MAX_LOG_SAME)
    for k in np.flatnonzero(wrong)[:N_PAIRS]:
        back = _way_back(bsdf, own, int(index[k]))
        if back is not None:
            of_eval, log_ratio, unsure = back
            yield of_eval, of_eval + float(logs[k]) - log_ratio, unsure


def _way_back(
    bsdf: mi.BSDF, samples: Samples, k: int
) -> tuple[float, float, float] | None:
    """Logarithms for a sample: f there over f back, the ratio of weights back, slack.

    That ratio is taken as linear in the direction nearby; the residual is the slack.
    """
    wi, wo = samples.condition.wi, samples.wo[k]
    there = samples.eval[k].sum() / abs(wo[2])
    back = samples.reverse[k].sum() / abs(wi[2])
    if not (there > 0 and back > 0 and abs(wo[2]) > 0.1):
        return None
    probe = Probe(bsdf, samples.condition.lit_from(wo))
    bs, sampled = probe.sample(*uniform(N_BACK, (k, 61)))
    towards, weight = spectral(bs.wo, N_BACK), spectral(sampled, N_BACK).sum(axis=1)
    value = probe.values(towards).sum(axis=1)
    over = weight * probe.densities(towards)
    near = (towards @ wi > MIN_COSINE) & ~numbers(is_delta(bs), N_BACK)
    near &= (value > 0) & (over > 0)
    if np.count_nonzero(near) < MIN_NEARBY:
        return None
    logs = np.log(over[near] / value[near])
    off = np.column_stack([np.ones(len(logs)), (towards[near] - wi)[:, :2]])
    plane = np.linalg.lstsq(off, logs, rcond=None)[0]
    slack = 2 * np.sqrt(np.mean((logs - off @ plane) ** 2))
    return float(np.log(there / back)), float(plane[0]), float(slack)

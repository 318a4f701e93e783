"""Light that differs between the weight of ``sample`` and ``eval``, or is gained.

Weight times pdf is one account of the BSDF, ``eval`` another. Where they differ, each
may be wrong, unless one of them gains flux that the other does not, or is reciprocal
where the other is not, or depends on the lobe that was picked.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import mitsuba as mi
import numpy as np

from ..checks.answers import Answers, asked_again
from ..checks.energy import Energy
from ..conditions import Sweep
from ..evidence import NOISE
from ..mistakes import EVAL, SAMPLE, Guess
from ..probe import Probe, is_delta, numbers, spectral, uniform
from ..samples import Samples, agree
from .case import Case
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

# Colours that may be exchanged, by the order of channels that takes it back.
COLOURS = {
    "red and blue": [2, 1, 0],
    "red and green": [1, 0, 2],
    "green and blue": [0, 2, 1],
}


def of_discrete_lobe(case: Case) -> Guess | None:
    """A discrete lobe of other weight than that of its component, which gains none."""
    own = [b.guess for b in case.evidence.of("components")]
    own = [guess for guess in own if guess.functions is SAMPLE]
    most = max(case.discrete, default=0.0)
    return own[0] if own and 0 < most <= 1 + 1e-4 else None


def gained(case: Case) -> Guess:
    """``eval`` or the weights of discrete lobes gain or lose light."""
    totals = [m.smooth_flux.max() + x for m, x in zip(case.maps, case.discrete)]
    gains = max(case.discrete, default=0.0) > 1 + 1e-4
    function, most = SAMPLE if gains else EVAL, max(totals, default=1.0)
    # a phase function absorbs nothing
    albedo = min(totals) if most < 1 else most
    return Energy.NOT_CONSERVED(function, found=f"albedo {albedo:.4g}")


def rejected_by_chance(case: Case) -> Guess:
    """Weights that make up for them."""
    noisy = [b for b in case.evidence.of("sampled_weight") if b.effect == NOISE]
    return noisy[0].guess


def changed_answers(case: Case) -> Guess | None:
    """What answers otherwise than where weights and ``eval`` still agreed."""
    first = case.evidence.whole[0]
    probe = Probe(case.evidence.bsdf, first.condition)
    return next(map(Answers.OF_CALLS, asked_again(first, probe, exact=True)), None)


def of_a_component(case: Case) -> Guess:
    """Weights of single components."""
    evidence = case.evidence
    found = evidence.of("components") or evidence.of("sampled_weight")
    return max(found, key=lambda one: one.size).guess


def other_sums(case: Case) -> Guess | None:
    """Weights that no sample tells to be wrong."""
    return None if case.light.each else Factor.OTHER_SUMS(SAMPLE)


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


def of_lobe_alone(case: Case) -> Guess | None:
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
    flux = max((m.smooth_flux.max() for m in whole), default=0.0)
    mean = max((m.totals.mean.max() for m in whole), default=0.0)
    discrete = max((m.totals.delta_mean.max() for m in whole), default=0.0)
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


def of_either(case: Case) -> Guess:
    """Nothing tells which of both is wrong."""
    return case.light.blame_either()


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

    That ratio is a linear function of the direction near by; what is left is slack.
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

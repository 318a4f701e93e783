"""The weight of `sample` against `eval`: which is wrong, if a third fact tells.

Weight times pdf is one account of the BSDF, ``eval`` another. Where they differ, either
may be wrong, unless one of them gains light that the other does not, or is reciprocal
where the other is not, or depends on the lobe that was picked.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from .conditions import LitFrom, Sweep
from .evidence import BIAS, Evidence
from .factors import Ratio, explain, explain_neutrally, inverse, ratios_of
from .probe import Probe, is_delta, numbers, spectral, uniform
from .samples import Samples, is_many, unequal

__all__ = ["explain_weights"]

# Guilty where nothing tells.
EITHER = "eval or sample"

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


def explain_weights(evidence: Evidence, failed: Collection[str]) -> tuple[str, str]:
    """Function and mistake, where weight times pdf is not ``eval``.

    Parameters
    ----------
    evidence : Evidence
        In which directions are drawn with the density of ``pdf``, or that could not be
        decided.
    failed : collection of str
        Names of properties.
    """
    whole = evidence.of("sampled_weight")
    if whole and all("component" in b.statistic for b in whole):
        # only single components disagree
        worst = max(evidence.of("components") or whole, key=lambda b: b.size)
        return worst.function, worst.mistake
    ratios = ratios_of(evidence, "sample")
    if not ratios:
        return "sample", (
            "`sample`: the weights do not sum up to `eval`, where directions agree "
            "with `pdf`"
        )
    swapped = _exchanged_colours(ratios)
    if swapped:
        return EITHER, (
            f"`eval` or the weight of `sample`: {swapped} are exchanged in one of them"
        )
    if _is_of_lobe_alone(evidence):
        return "sample", (
            "`sample` weight lacks division by the probability of the lobe: it is "
            "value over pdf of the picked lobe alone"
        )
    guilty = _by_energy(evidence) or _by_answers(evidence, failed)
    guilty = guilty or _by_reciprocity(evidence.bsdf, ratios)
    if guilty:
        ratios = inverse(ratios) if guilty == "eval" else ratios
        return guilty, explain(ratios, guilty)
    text = explain_neutrally(ratios)
    return EITHER, f"`eval` or the weight of `sample`: {text}"


def _exchanged_colours(ratios: Sequence[Ratio]) -> str:
    """Colours of which weights have one and ``eval`` the other; empty if none."""
    samples, ok = ratios[0].samples, ratios[0].mask
    weight, value = samples.weight * samples.pdf[:, None], samples.eval
    slack = samples.eval_slack
    if value.shape[1] != 3:
        return ""
    for order, words in (
        ([2, 1, 0], "red and blue"),
        ([1, 0, 2], "red and green"),
        ([0, 2, 1], "green and blue"),
    ):
        same, other = (
            unequal(weight, value[:, one], slack[:, one]) & ok
            for one in ([0, 1, 2], order)
        )
        if is_many(same) and not is_many(other):
            return words
    return ""


def _by_energy(evidence: Evidence) -> str:
    """Which of both gains light, if it is one of them; else empty."""
    whole = [m for m in evidence.maps if m.condition.component is None]
    whole = [m for m in whole if m.condition.mode == "importance"]
    flux = max((m.smooth_flux.max() for m in whole), default=0.0)
    mean = max((m.totals.mean.max() for m in whole), default=0.0)
    discrete = max((m.totals.delta_mean.max() for m in whole), default=0.0)
    if flux + discrete > 1.001 > mean:
        return "eval"
    return "sample" if mean > 1.001 > flux + discrete else ""


def _by_answers(evidence: Evidence, failed: Collection[str]) -> str:
    """Which of both has values that none should have, if it is one; else empty."""
    own = [b for b in evidence.of("answers") if b.effect == BIAS]
    if "answers" not in failed or not own:
        return ""
    worst = max(own, key=lambda b: b.size).function
    return worst if worst in ("eval", "sample") else ""


def _by_reciprocity(bsdf: mi.BSDF, ratios: Sequence[Ratio]) -> str:
    """Which of both is not reciprocal where the other is; else empty.

    Weights are known where samples are: of some of them, light is sent back, and what
    of that comes near to the way of incidence is compared.
    """
    usable = [
        one
        for one in ratios
        if one.samples.condition.mode == "importance"
        and not isinstance(one.samples.condition, Sweep)
    ]
    # neither steep nor grazing, where all is symmetric or nothing is met
    usable.sort(key=lambda one: abs(one.samples.condition.theta_i - 45))
    pairs: list[tuple[float, float, float]] = []
    for ratio in usable[:4]:
        logs, index = np.log(ratio.values), np.flatnonzero(ratio.mask)
        wrong = ratio.samples.reflected[index] & (np.abs(logs) > MAX_LOG_SAME)
        for k in np.flatnonzero(wrong)[:N_PAIRS]:
            back = _way_back(bsdf, ratio.samples, int(index[k]))
            if back is not None:
                of_eval, log_ratio, unsure = back
                pairs.append((of_eval, of_eval + float(logs[k]) - log_ratio, unsure))
        if len(pairs) >= N_PAIRS:
            break
    if len(pairs) < N_PAIRS // 2:
        return ""
    by_eval, by_weights, slack = np.abs(np.array(pairs)).T
    for guilty, right, wrong in (
        ("sample", by_eval, by_weights),
        ("eval", by_weights, by_eval),
    ):
        same = np.mean(right < MAX_LOG_SAME + slack)
        other = np.mean(wrong > MIN_LOG_OTHER + slack)
        if same > MIN_SAME and other > MIN_OTHER:
            return guilty
    return ""


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
    lit: Any = LitFrom(samples.condition, wo)
    probe = Probe(bsdf, lit)
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


def _is_of_lobe_alone(evidence: Evidence) -> bool:
    """Whether weights are those of a single component, as if there were no other."""
    n, samples = evidence.bsdf.component_count(), evidence.samples[0]
    if n < 2 or samples.condition.component is not None:
        return False
    ratios = []
    for i in range(n):
        own = samples.smooth & (samples.component == i)
        if own.any():
            probe = Probe(evidence.bsdf, replace(samples.condition, component=i))
            value = probe.values(samples.wo)[own].sum(axis=1)
            over = samples.weight[own].sum(axis=1) * probe.densities(samples.wo)[own]
            ratios.append(over / np.maximum(value, 1e-30))
    if len(ratios) < 2:
        return False
    low, high = np.quantile(np.concatenate(ratios), [0.02, 0.98])
    return low > 0.998 and high < 1.002

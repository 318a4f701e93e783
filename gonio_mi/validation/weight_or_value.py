"""The weight of `sample` against `eval`: whose fault it is, if a fact apart tells.

Weight times pdf is one account of the BSDF, ``eval`` another. Where they differ, either
may be wrong, unless one of them gains light that the other does not, or is reciprocal
where the other is not, or depends on the lobe that was picked.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from .collecting import Drawn
from .conditions import LitFrom
from .drawing import uniform
from .evidence import Evidence
from .probe import Probe, numbers, spectral
from .ratios import Cases, explain_neutrally, explain_ratio, ratios_of

__all__ = ["BOTH", "explain_weights"]

# Where nothing tells.
BOTH = "eval or sample"

WHAT = "weight times pdf, over `eval`,"

# Pairs of directions that are exchanged, samples of the way back, the cosine of the
# angle within which such a sample is near to that way, and how many there must be.
PAIRS = 24
SAMPLES = 2**16
NEARBY = np.cos(np.radians(3.0))
ENOUGH = 12

# Logarithms of ratios that are as good as 0, and such that are not; the part of the
# pairs that must be the one for a reciprocal account, the other for one that is not.
SAME, OTHER = 0.03, 0.1
MOST, MANY = 0.9, 0.15


def explain_weights(
    evidence: Evidence, failed: Collection[str], bsdf: mi.BSDF
) -> tuple[str, str]:
    """Function and mistake, where weight times pdf is not ``eval``.

    Parameters
    ----------
    evidence : Evidence
        In which directions are drawn as ``pdf`` says, or that could not be decided.
    failed : collection of str
        Names of properties.
    bsdf : mi.BSDF
        To be asked again.
    """
    whole = [b for b in evidence.breaches if b.property == "sampled_weight"]
    if whole and all("component" in b.statistic for b in whole):
        # only single components disagree
        first = [b for b in evidence.breaches if b.property == "components"] or whole
        worst = max(first, key=lambda b: b.size)
        return worst.function, worst.mistake
    cases = ratios_of(evidence, "sampled_weight")
    if not cases:
        return "sample", (
            "`sample`: the weights do not sum up to `eval`, where directions agree "
            "with `pdf`"
        )
    if _is_of_lobe_alone(evidence, bsdf):
        return "sample", (
            "`sample` weight lacks division by the probability of the lobe: it is "
            "value over pdf of the picked lobe alone"
        )
    guilty = (
        _of_energy(evidence) or _of_answers(evidence, failed) or _of_ways(bsdf, cases)
    )
    if guilty == "eval":
        cases = [(1 / ratio, drawn, mask) for ratio, drawn, mask in cases]
        return "eval", explain_ratio(cases, "eval", "value, over weight times pdf,")
    if guilty == "sample":
        text = explain_ratio(cases, "sample", WHAT)
        return "sample", re.sub("^`sample` (?!weight)", "`sample` weight ", text)
    text = explain_neutrally(cases, WHAT)
    return BOTH, f"`eval` or the weight of `sample`: {text}"


def _of_energy(evidence: Evidence) -> str:
    """Which of both gains light, if it is one of them; else empty."""
    whole = [m for m in evidence.maps if m.condition.component is None]
    whole = [m for m in whole if m.condition.mode == "importance"]
    flux = max((m.smooth_flux.max() for m in whole), default=0.0)
    mean = max((m.totals.mean.max() for m in whole), default=0.0)
    discrete = max((m.totals.delta_mean.max() for m in whole), default=0.0)
    if flux + discrete > 1.001 > mean:
        return "eval"
    return "sample" if mean > 1.001 > flux + discrete else ""


def _of_answers(evidence: Evidence, failed: Collection[str]) -> str:
    """Which of both has values that none should have, if it is one; else empty."""
    own = [b for b in evidence.breaches if b.property == "answers" and not b.effect]
    if "answers" not in failed or not own:
        return ""
    worst = max(own, key=lambda b: b.size).function
    return worst if worst in ("eval", "sample") else ""


def _of_ways(bsdf: mi.BSDF, cases: Cases) -> str:
    """Which of both is not reciprocal where the other is; else empty.

    Weights are known where samples are: of some of them, light is sent back, and what
    of that comes near to the way of incidence is compared.
    """
    usable = [
        (ratio, drawn, np.flatnonzero(mask))
        for ratio, drawn, mask in cases
        if drawn.condition.mode == "importance"
    ]
    # neither steep nor grazing, where all is symmetric or nothing is met
    usable.sort(key=lambda case: abs(case[1].condition.theta_i - 45))
    values: list[tuple[float, float, float]] = []
    for ratio, drawn, index in usable[:4]:
        wrong = drawn.reflected[index] & (np.abs(np.log(ratio)) > SAME)
        chosen = np.flatnonzero(wrong)[:PAIRS]
        for k in chosen:
            back = _way_back(bsdf, drawn, int(index[k]))
            if back is not None:
                of_eval, log_ratio, unsure = back
                of_weights = of_eval + float(np.log(ratio[k])) - log_ratio
                values.append((of_eval, of_weights, unsure))
        if len(values) >= PAIRS:
            break
    if len(values) < PAIRS // 2:
        return ""
    by_eval, by_weights, slack = np.abs(np.array(values)).T
    same, other = SAME + slack, OTHER + slack
    if np.mean(by_eval < same) > MOST and np.mean(by_weights > other) > MANY:
        return "sample"
    if np.mean(by_weights < same) > MOST and np.mean(by_eval > other) > MANY:
        return "eval"
    return ""


def _way_back(bsdf: mi.BSDF, drawn: Drawn, k: int) -> tuple[float, float, float] | None:
    """Logarithms for a sample: f there over f back, the ratio of weights back, slack.

    That ratio is a linear function of the direction near by; what is left is slack.
    """
    wi, wo = drawn.condition.wi, drawn.wo[k]
    there = drawn.eval[k].sum() / abs(wo[2])
    back = drawn.reverse[k].sum() / abs(wi[2])
    if not (there > 0 and back > 0 and abs(wo[2]) > 0.1):
        return None
    lit: Any = LitFrom(drawn.condition, wo)
    probe = Probe(bsdf, lit)
    one = probe.sample(*uniform(SAMPLES, (k, 61)))
    directions = mi.Vector3f(one.bs.wo)
    value = spectral(probe.eval(directions), SAMPLES).sum(axis=1)
    weight = spectral(one.weight, SAMPLES).sum(axis=1)
    over = weight * numbers(probe.pdf(directions), SAMPLES)
    towards = spectral(directions, SAMPLES)
    near = (towards @ wi > NEARBY) & ~numbers(one.delta, SAMPLES)
    near &= (value > 0) & (over > 0)
    if np.count_nonzero(near) < ENOUGH:
        return None
    logs = np.log(over[near] / value[near])
    off = np.column_stack([np.ones(len(logs)), (towards[near] - wi)[:, :2]])
    plane = np.linalg.lstsq(off, logs, rcond=None)[0]
    slack = 2 * np.sqrt(np.mean((logs - off @ plane) ** 2))
    return float(np.log(there / back)), float(plane[0]), float(slack)


def _is_of_lobe_alone(evidence: Evidence, bsdf: mi.BSDF) -> bool:
    """Whether weights are those of a single component, as if there were no other."""
    n = bsdf.component_count()
    drawn = evidence.drawn[0]
    if n < 2 or drawn.condition.component is not None:
        return False
    wo = mi.Vector3f(drawn.wo.T)
    ratios = []
    for i in range(n):
        own = drawn.smooth & (drawn.component == i)
        if own.any():
            probe = Probe(bsdf, replace(drawn.condition, component=i))
            value = spectral(probe.eval(wo), drawn.n)[own].sum(axis=1)
            pdf = numbers(probe.pdf(wo), drawn.n)[own]
            weight = drawn.weight[own].sum(axis=1)
            ratios.append(weight * pdf / np.maximum(value, 1e-30))
    if len(ratios) < 2:
        return False
    low, high = np.quantile(np.concatenate(ratios), [0.02, 0.98])
    return low > 0.998 and high < 1.002

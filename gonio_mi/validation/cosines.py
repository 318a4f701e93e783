"""Wrong cosines of ``eval``, of all of it or of one lobe, where it is not reciprocal.

A right lobe is ``f cos_o``, where f is the same with wi and wo exchanged; one whose
``eval cos_i^k`` is the same exchanged, within rounding, has another power of a cosine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats
from ..collector.directions import direction
from .collecting import Drawn
from .conditions import Condition
from .equality import BSDF_ROUNDING, SLACK, is_many, unequal
from .evidence import BIAS, Breach, Evidence
from .parameters import changed, traversed
from .probe import PluginFault, Probe, spectral

__all__ = ["check_cosines"]

# What ``eval`` is by the power k of which ``eval cos(theta_i)^k`` is the same with wi
# and wo exchanged, but for eta^2; 1 is right.
COSINES = {
    0: "`eval` lacks the cosine of wo, or division by that of wi",
    2: "`eval` has the cosine of wo twice, or is divided by that of wi once too often",
    -1: "`eval` has the cosine of wi where that of wo is due",
}

# Part of the samples that must contradict reciprocity somewhere: an identity that few
# of them tell from it says nothing.
TELLING = 0.2

# Cosine of wo next to the horizon, azimuths there, angles of incidence in degrees at
# which even narrow lobes reach it, and the part of a value that must be left when wo
# falls to it.
HORIZON, AZIMUTHS, GRAZING, LEFT = 1e-3, 64, (60.0, 70.0, 80.0), 0.9

# Difference of exponents that a single law of the cosines, which no sum of two lobes
# follows, may have; and the least logarithm of a ratio of cosines that tells them.
ONE_LAW, APART = 0.01, 0.1

MIXED = (
    "a lobe among others that {mistake} would look so, too: ask for each lobe alone, "
    "by ctx.component or with the reflectance of the others at 0"
)


def check_cosines(evidence: Evidence, bsdf: mi.BSDF) -> None:
    """Whether a power of the cosines explains all that is not reciprocal.

    If it does for all samples from all directions, within rounding, it is a mistake in
    ``eval`` and no law of a model: of the whole, of a component that is asked alone, or
    of what of ``eval`` a parameter changes. Where a lobe cannot be asked alone, it is
    so if all is a sum, nowhere negative, of a right lobe and a wrong one, which stays
    lit as wo falls to the horizon. One that means it so (Phong's, of 1975, has no
    cosine) can declare NonSymmetric.
    """
    own = [b for b in evidence.breaches if b.property == "reciprocity"]
    own = [b for b in own if b.effect is None]
    whole = [drawn for drawn in evidence.drawn if drawn.condition.component is None]
    whole = [drawn for drawn in whole if drawn.condition.mode == "importance"]
    # a face of its own may be right
    wrong = {d.condition.side for d in whole if is_many(_unexplained(d), d.n)}
    whole = [drawn for drawn in whole if drawn.condition.side in wrong]
    power = _power(whole) if len(own) > 1 else None
    if power is not None:
        _blame(evidence, own, COSINES[power])
        return
    apart = _of_components(evidence, bsdf)
    if own and not apart:
        apart = _of_parameters(bsdf, whole) or _of_horizon(bsdf, whole)
    if apart:
        worst = max(
            own or [b for b in evidence.breaches if b.property == "reciprocity"],
            key=lambda b: b.size,
        )
        _blame(evidence, [worst], apart)
    elif own and not _components_tell(evidence, bsdf):
        _doubt(evidence, own, whole)


def _blame(evidence: Evidence, own: Sequence[Breach], mistake: str) -> None:
    """Let breaches bias images, by a mistake."""
    evidence.breaches[:] = [
        replace(b, effect=BIAS, mistake=mistake, size=1 + b.size) if b in own else b
        for b in evidence.breaches
    ]


def _doubt(evidence: Evidence, own: Sequence[Breach], whole: Sequence[Drawn]) -> None:
    """Say which wrong cosine of a lobe among others would look like these breaches."""
    for power in COSINES:
        if all(_is_sum(drawn, power) for drawn in whole) and not _is_one_law(whole):
            text = MIXED.format(mistake=COSINES[power].removeprefix("`eval` "))
            evidence.breaches[:] = [
                replace(b, mistake=f"{b.mistake}; {text}") if b in own else b
                for b in evidence.breaches
            ]
            return


def _components_tell(evidence: Evidence, bsdf: mi.BSDF) -> bool:
    """Whether components were asked one by one, and are all that there is."""
    deaf = (b.property == "components" for b in evidence.breaches)
    return bsdf.component_count() > 1 and not any(deaf)


def _of_components(evidence: Evidence, bsdf: mi.BSDF) -> str:
    """Mistake of one component, asked alone; empty if none has one."""
    if not _components_tell(evidence, bsdf):
        return ""
    for i in range(bsdf.component_count()):
        own = [d for d in evidence.drawn if d.condition.component == i]
        declared = int(bsdf.flags(i)) & int(mi.BSDFFlags.NonSymmetric)
        power = None if declared else _power(own)
        if power is not None:
            return f"{COSINES[power]}, in its component {i}"
    return ""


def _of_parameters(bsdf: mi.BSDF, whole: Sequence[Drawn]) -> str:
    """Mistake of what of ``eval`` a parameter changes; empty if none has one."""
    try:
        params = traversed(bsdf)
        for name in params.keys():  # noqa: SIM118
            value = params[name]
            number = isinstance(value, (float, mi.Float, mi.Color3f))
            if not number or not np.any(np.array(value)):
                continue
            with changed(bsdf, {name: type(value)(0.5 * value)}):
                parts = [_part(bsdf, drawn) for drawn in whole]
            power = _power(parts)
            if power is not None:
                return f"{COSINES[power]}, in what of it the parameter {name} changes"
    except PluginFault:
        pass  # a property of its own
    return ""


def _part(bsdf: mi.BSDF, drawn: Drawn) -> Drawn:
    """Samples with the values that a change of parameters takes away."""
    probe = Probe(bsdf, drawn.condition)
    wo = mi.Vector3f(np.ascontiguousarray(drawn.wo.T))
    wi = mi.Vector3f(drawn.condition.wi.tolist())
    there = spectral(probe.eval(wo), drawn.n)
    back = spectral(probe.eval(wi, wi=wo), drawn.n)

    def _slack(slack: Floats, value: Floats) -> Floats:
        # of two values, each with its rounding
        return 2 * (slack + BSDF_ROUNDING / SLACK * np.abs(value))

    return replace(
        drawn,
        eval=drawn.eval - there,
        reverse=drawn.reverse - back,
        eval_slack=_slack(drawn.eval_slack, drawn.eval),
        reverse_slack=_slack(drawn.reverse_slack, drawn.reverse),
    )


def _of_horizon(bsdf: mi.BSDF, whole: Sequence[Drawn]) -> str:
    """Mistake of one lobe that cannot be asked alone; empty if it is not certain."""
    sides = {drawn.condition.side for drawn in whole}
    for power in (0, -1):
        if all(_is_sum(drawn, power) for drawn in whole):
            lit = [
                _stays_lit(bsdf, Condition(t, 25.0, s), power)
                for s in sides
                for t in GRAZING
            ]
            if lit and all(lit):
                return (
                    f"{COSINES[power]}, in one lobe of several: it does not fall to 0 "
                    "as wo falls to the horizon"
                )
    return ""


def _stays_lit(bsdf: mi.BSDF, condition: Condition, power: int) -> bool:
    """Whether a lobe of that power is what is left as wo falls to the horizon.

    It is at some azimuth: a narrow lobe has but one. A right one, with a finite f,
    falls as the cosine of wo.
    """
    phi = 2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS + np.radians(condition.phi_i)
    low, high = (
        direction(np.arccos(cosine), phi) * np.sign([1, 1, condition.wi[2]])
        for cosine in (HORIZON, 2 * HORIZON)
    )
    wo = mi.Vector3f(np.concatenate([low, high]).T)
    probe, n = Probe(bsdf, condition), 2 * AZIMUTHS
    there = spectral(probe.eval(wo), n).sum(axis=1)
    back = spectral(probe.eval(mi.Vector3f(condition.wi.tolist()), wi=wo), n)
    first, second = there.reshape(2, AZIMUTHS)
    back = back[:AZIMUTHS].sum(axis=1)
    cos_i, cos_o = abs(condition.wi[2]), HORIZON
    determinant = cos_o * cos_i**power - cos_i * cos_o**power
    wrong = (cos_o * back - cos_i * first) / determinant * cos_o**power
    left = np.minimum(wrong, 2 * first - second)
    return bool(((first > 0) & (left > LEFT * first)).any())


def _power(ways: Sequence[Drawn]) -> int | None:
    """Power of the cosine that explains all samples, if the right one does not."""
    if max((_unexplained(drawn).mean() for drawn in ways), default=0.0) < TELLING:
        return None
    for power in COSINES:
        if not any(is_many(_unexplained(drawn, power), drawn.n) for drawn in ways):
            return power
    return None


def _unexplained(drawn: Drawn, power: int = 1) -> Flags:
    """Samples where ``eval cos_i^power`` is another with wi and wo exchanged."""
    there, back, slack, smooth = _both_ways(drawn, power)
    # what is no number is unequal to all
    finite = np.isfinite(there).all(axis=1) & np.isfinite(back).all(axis=1)
    return smooth & (unequal(there, back, slack) | ~finite)


def _both_ways(drawn: Drawn, power: int) -> tuple[Floats, Floats, Floats, Flags]:
    """Return ``eval cos_i^power`` there and back, their slack, and what is smooth."""
    cos_i, cos_o, smooth = _cosines(drawn)
    eta2 = np.where(drawn.reflected, 1.0, drawn.eta**2)[:, None]
    there, back = cos_i**power, eta2 * cos_o**power
    slack = drawn.eval_slack * there + drawn.reverse_slack * back
    return drawn.eval * there, drawn.reverse * back, slack, smooth


def _cosines(drawn: Drawn) -> tuple[float, Floats, Flags]:
    """Cosine of wi, those of wo of shape ``(n, 1)``, and which samples are smooth."""
    cos_i, cos_o = float(abs(drawn.condition.wi[2])), np.abs(drawn.wo[:, 2])
    smooth = drawn.smooth & (cos_o > 1e-4)
    return cos_i, np.where(smooth, cos_o, 1.0)[:, None], smooth


def _is_sum(drawn: Drawn, power: int) -> bool:
    """Whether a lobe of that power and a right one, neither negative, explain all.

    They are what two equations have: one for each way.
    """
    cos_i, cos_o, smooth = _cosines(drawn)
    up = cos_o * cos_i**power > cos_i * cos_o**power
    wrong = np.zeros(drawn.n, dtype=bool)
    for other, rising in ((power, up), (1, ~up)):
        there, back, slack, _ = _both_ways(drawn, other)
        extreme = np.where(rising, np.maximum(there, back), np.minimum(there, back))
        wrong |= unequal(there, extreme, slack) | ~np.isfinite(there + back).all(axis=1)
    return not is_many(wrong & smooth, drawn.n)


def _is_one_law(ways: Sequence[Drawn]) -> bool:
    """Whether a single power of the cosines, a whole number or not, explains all."""
    exponents = []
    for drawn in ways:
        cos_i, cos_o, smooth = _cosines(drawn)
        there, back, _, _ = _both_ways(drawn, 0)
        there, back, ratio = there.sum(axis=1), back.sum(axis=1), cos_o[:, 0] / cos_i
        known = smooth & (there > 0) & (back > 0) & (np.abs(np.log(ratio)) > APART)
        exponents.append(np.log(there[known] / back[known]) / np.log(ratio[known]))
    low, high = np.quantile(np.concatenate(exponents), [0.02, 0.98])
    return bool(high - low < ONE_LAW)

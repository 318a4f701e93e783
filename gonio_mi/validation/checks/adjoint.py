"""Radiance and importance mode are adjoint to each other."""

from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from ...array_types import Flags
from ..arrays import Sides, drawn, lit, opposite, rows
from ..evidence import BIAS, BREAKS, FROM_LIGHTS, Evidence, Question
from ..judgements import by_sample
from ..mistakes import EVAL, SAMPLE, Claim, Guess, Mistake
from ..samples import beyond_rounding, samples_of, unequal
from .delta import Lobe
from .reciprocity import BothWays, exchanged, is_constant, ratio_text


def both_modes(bsdf: Any, ctx: Any, si: Any, u: Any) -> Sides:
    """The other transport mode has the same light on the way back."""
    return exchanged(bsdf, ctx, si, u, opposite(ctx))


def lobe_in_both_modes(bsdf: Any, ctx: Any, si: Any, u: Any) -> Sides:
    """Weights of a discrete lobe are those of the other mode, with eta^2."""
    _, weight = drawn(bsdf, ctx, si, u)
    other, radiance = drawn(bsdf, opposite(ctx), si, u)
    eta = np.where(rows(other.wo.z * si.wi.z) < 0, rows(other.eta), 1)
    return rows(weight), rows(radiance) * eta**2, lit(weight)


ADJOINT = Question(
    "adjoint",
    __doc__,
    BREAKS,
    # if importance mode is right and radiance mode is not
    {BREAKS: FROM_LIGHTS, BIAS: "path and all that trace rays from the sensor"},
    matrices="radiance and importance mode are adjoint, in all elements",
    rank=2,
    shown=Claim(both_modes, by_sample),
)


class Adjoint(Mistake):
    """What is wrong between the modes."""

    OF_A_WAVELENGTH = """{who} at {nm:g} nm transmits {ways:.4g} times what it does the
        other way, and {modes:.4g} times what it does in radiance mode, where both are
        eta^2 of that wavelength"""
    LACKS_ETA2 = "{who} lacks 1/eta^2 in radiance mode"
    ALIKE = """{who} is the same in both modes: 1/eta^2 is missing in radiance mode, or
        there in importance mode"""
    FACTOR_OF_RADIANCE = """{who} of radiance mode is {factor:.4g} times the expected
        one for wi on the {side}"""
    NOT_SWAPPED = """{who} of radiance mode is not that of importance mode with wi and
        wo swapped"""
    WEIGHT_LACKS_ETA2 = "{who} weight lacks 1/eta^2 in radiance mode"
    ETA_UPSIDE_DOWN = """{who} gives the eta of the other side, or its weight in
        radiance mode is multiplied by eta^2, which divides it"""
    OTHER_WEIGHT = "{who} weight in radiance mode is {ratio:.4g} times the other one"


def check_ways(evidence: Evidence, ways: BothWays) -> None:
    """``f(wi, wo)`` of one mode is ``f(wo, wi)`` of the other (Veach 1997, 5.2).

    A model that is not reciprocal is so in either mode: where the ratio of the modes is
    eta^2, there is nothing to add. Where importance mode is reciprocal, that ratio is
    eta^2 from either side.
    """
    samples, eta2, times = ways.samples, ways.eta2, 1 + ways.eta2
    slack = ways.slack * times
    here = unequal(samples.eval, eta2 * samples.other_mode, samples.eval_slack * times)
    there = unequal(eta2 * ways.backward, ways.adjoint, slack)
    reciprocal = ~unequal(ways.forward, eta2 * ways.backward, slack)
    wrong = unequal(ways.forward, ways.adjoint, slack)
    wrong &= ways.smooth & (here | (reciprocal & there))
    if beyond_rounding(wrong):
        of_others = _guess_of_wavelengths(ways, wrong)
        of_radiance = reciprocal[wrong].mean() > 0.5 and not of_others
        guess = of_others or _guess(ways, wrong, of_radiance)
        text = ratio_text(ways.forward, ways.adjoint, wrong, samples)
        how = {"off": None, "effect": BIAS if of_radiance else BREAKS}
        evidence.breach(ADJOINT, guess, samples, wrong, statistic=text, **how)


def _guess_of_wavelengths(ways: BothWays, wrong: Flags) -> Guess | None:
    """Mistake of other wavelengths than the first in transmission; None if it is not.

    Their indices are not known, nor which of the modes is wrong.
    """
    samples = ways.samples
    first = unequal(ways.forward[:, 0], ways.adjoint[:, 0], ways.slack[:, 0])
    others = not beyond_rounding(first & wrong) and not samples.reflected[wrong].any()
    if not (mi.is_spectral and others):
        return None
    by_way, by_mode = (
        np.median(here[wrong] / np.maximum(other[wrong], 1e-30), axis=0)
        for here, other in (
            (ways.forward, ways.backward),
            (samples.eval, samples.other_mode),
        )
    )
    k = int(np.abs(by_way - by_mode).argmax())
    nm = samples.condition.nm[k]
    return Adjoint.OF_A_WAVELENGTH(EVAL, nm=nm, ways=by_way[k], modes=by_mode[k])


def _guess(ways: BothWays, wrong: Flags, of_radiance: bool) -> Guess:
    """Likely mistake between the modes; `of_radiance` if importance mode is right."""
    if not ways.samples.reflected[wrong].any():
        # adjoint light comes from the other side, where 1/eta^2 is eta^2 from here
        ratio = ways.ratio(ways.adjoint, wrong)
        eta2 = np.median(ways.samples.eta[wrong]) ** 2
        if is_constant(ratio):
            middle = np.median(ratio)
            if of_radiance and abs(middle / eta2 - 1) < 1e-3:
                return Adjoint.LACKS_ETA2(EVAL)
            if abs(middle * eta2 - 1) < 1e-3 or abs(middle / eta2 - 1) < 1e-3:
                return Adjoint.ALIKE(EVAL)
            if of_radiance:
                side = {"front": "back", "back": "front"}[ways.samples.condition.side]
                return Adjoint.FACTOR_OF_RADIANCE(EVAL, factor=1 / middle, side=side)
    return Adjoint.NOT_SWAPPED(EVAL)


def check_lobe(
    evidence: Evidence, lobe: Lobe, key: tuple[int, ...], returns: bool
) -> None:
    """Radiance that crosses an interface is divided by eta^2.

    If light `returns` as it went in importance mode, it is radiance mode that is wrong.
    """
    samples = lobe.samples
    if samples.condition.mode != "importance":
        return
    radiance = replace(samples.condition, mode="radiance")
    same = samples_of(evidence.bsdf, radiance, samples.n, key, False)
    both = lobe.own & same.given & (same.type == samples.type)
    reflected = samples.reflected | ((samples.type & int(mi.BSDFFlags.Null)) != 0)
    eta2 = np.where(reflected, 1.0, samples.eta**2)[:, None]
    wrong = unequal(same.weight * eta2, samples.weight, 0.0) & both
    if beyond_rounding(wrong):
        ratio = np.median(same.weight[wrong] / samples.weight[wrong])
        due = 1 / np.median(eta2[wrong])
        mistake = Adjoint.OTHER_WEIGHT
        if returns and abs(ratio - 1) < 1e-3:
            mistake = Adjoint.WEIGHT_LACKS_ETA2
        elif abs(ratio * due - 1) < 1e-3:
            mistake = Adjoint.ETA_UPSIDE_DOWN
        guess, at = mistake(SAMPLE, ratio=ratio), samples.condition
        text = f"radiance over importance is {ratio:.4g} where 1/eta^2 = {due:.4g}"
        shown = Claim(lobe_in_both_modes, by_sample)
        how = {"effect": BIAS if returns else BREAKS, "shown": shown}
        evidence.breach(ADJOINT, guess, at, found=text, **how)

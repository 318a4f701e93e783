"""Radiance and importance mode are adjoint to each other."""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi
import numpy as np

from ...array_types import Flags
from ..evidence import BIAS, BREAKS, Evidence
from ..kinds import Kind
from ..samples import beyond_rounding, samples_of, unequal
from .delta import Lobe
from .reciprocity import BothWays, is_constant, ratio_text


def check_ways(evidence: Evidence, ways: BothWays) -> None:
    """``f(wi, wo)`` of one mode is ``f(wo, wi)`` of the other (Veach 1997, 5.2).

    A model that is not reciprocal is so in either mode: where the ratio of the modes is
    eta^2, there is nothing to add. Where importance mode is reciprocal, that ratio is
    eta^2 from either side.
    """
    samples, eta2 = ways.samples, ways.eta2
    slack = ways.slack * (1 + eta2)
    here = unequal(
        samples.eval, eta2 * samples.other_mode, samples.eval_slack * (1 + eta2)
    )
    there = unequal(eta2 * ways.backward, ways.adjoint, slack)
    reciprocal = ~unequal(ways.forward, eta2 * ways.backward, slack)
    wrong = unequal(ways.forward, ways.adjoint, slack)
    wrong &= ways.smooth & (here | (reciprocal & there))
    if beyond_rounding(wrong):
        of_others = _mistake_of_wavelengths(ways, wrong)
        of_radiance = reciprocal[wrong].mean() > 0.5 and not of_others
        evidence.breach(
            "adjoint",
            "eval",
            ratio_text(ways.forward, ways.adjoint, wrong, samples),
            of_others or _mistake(ways, wrong, of_radiance),
            samples.condition,
            size=float(wrong.mean()),
            effect=BIAS if of_radiance else BREAKS,
        )


def _mistake_of_wavelengths(ways: BothWays, wrong: Flags) -> str:
    """Mistake of other wavelengths than the first in transmission; empty if it is not.

    Their indices are not known, nor which of the modes is wrong.
    """
    samples = ways.samples
    first = unequal(ways.forward[:, 0], ways.adjoint[:, 0], ways.slack[:, 0])
    if (
        not mi.is_spectral
        or beyond_rounding(first & wrong)
        or samples.reflected[wrong].any()
    ):
        return ""
    by_way, by_mode = (
        np.median(here[wrong] / np.maximum(other[wrong], 1e-30), axis=0)
        for here, other in (
            (ways.forward, ways.backward),
            (samples.eval, samples.other_mode),
        )
    )
    k = int(np.abs(by_way - by_mode).argmax())
    return (
        f"`eval` at {samples.condition.nm[k]:g} nm transmits {by_way[k]:.4g} times "
        f"what it does the other way, and {by_mode[k]:.4g} times what it does in "
        "radiance mode, where both are eta^2 of that wavelength"
    )


def _mistake(ways: BothWays, wrong: Flags, of_radiance: bool) -> str:
    """Likely mistake between the modes; `of_radiance` if importance mode is right."""
    if not ways.samples.reflected[wrong].any():
        # adjoint light comes from the other side, where 1/eta^2 is eta^2 from here
        ratio = ways.ratio(ways.adjoint, wrong)
        eta2 = np.median(ways.samples.eta[wrong]) ** 2
        if is_constant(ratio):
            middle = np.median(ratio)
            if of_radiance and abs(middle / eta2 - 1) < 1e-3:
                return "`eval` lacks 1/eta^2 in radiance mode"
            if abs(middle * eta2 - 1) < 1e-3 or abs(middle / eta2 - 1) < 1e-3:
                return (
                    "`eval` is the same in both modes: 1/eta^2 is missing in radiance "
                    "mode, or there in importance mode"
                )
            if of_radiance:
                lit = ways.samples.condition.side
                return (
                    f"`eval` of radiance mode is {1 / middle:.4g} times what is due "
                    f"for wi on the {'back' if lit == 'front' else 'front'}"
                )
            return f"`eval` of the modes has the ratio {middle:.4g}, where 1 is due"
    return (
        "`eval` of radiance mode is not that of importance mode with wi and wo swapped"
    )


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
    same = samples_of(evidence.bsdf, radiance, samples.n, key)
    both = lobe.own & same.given & (same.type == samples.type)
    reflected = samples.reflected | ((samples.type & int(mi.BSDFFlags.Null)) != 0)
    eta2 = np.where(reflected, 1.0, samples.eta**2)[:, None]
    wrong = unequal(same.weight * eta2, samples.weight, 0.0) & both
    if beyond_rounding(wrong):
        ratio = np.median(same.weight[wrong] / samples.weight[wrong])
        due = 1 / np.median(eta2[wrong])
        if returns and abs(ratio - 1) < 1e-3:
            mistake = "`sample` weight lacks 1/eta^2 in radiance mode"
        elif abs(ratio * due - 1) < 1e-3:
            mistake = (
                "`sample` gives the eta of the other side, or its weight in radiance "
                "mode is multiplied by eta^2, which divides it"
            )
        else:
            mistake = (
                f"`sample` weight in radiance mode is {ratio:.4g} times the other one"
            )
        evidence.breach(
            "adjoint",
            "sample",
            f"radiance over importance is {ratio:.4g} where 1/eta^2 = {due:.4g} "
            f"at {samples.condition}",
            mistake,
            samples.condition,
            effect=BIAS if returns else BREAKS,
            kind=Kind.ADJOINT_OF_A_LOBE,
        )

"""Sampled directions are unit vectors on the side of their type."""

from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from ...single_precision import BSDF_ROUNDING
from ..arrays import Sides, drawn, lit, lit_from, rows, smooth, value
from ..evidence import BIAS, INTERFACE, NOISE, SAMPLED, Evidence, Question
from ..judgements import by_sample, same
from ..mistakes import SAMPLE, Claim, Mistake
from ..samples import Samples, beyond_rounding, unequal
from .reciprocity import MAX_OFF, BothWays, is_constant


def sides(bsdf: Any, ctx: Any, si: Any, u: Any) -> tuple[int, int]:
    """As many samples leave on the other side as have a transmitting type."""
    bs, weight = drawn(bsdf, ctx, si, u)
    through = np.array(bs.sampled_type) & int(mi.BSDFFlags.Transmission) != 0
    below = np.array(bs.wo.z * si.wi.z) < 0
    return int(np.sum(through & lit(weight))), int(np.sum(below & lit(weight)))


def length(bsdf: Any, ctx: Any, si: Any, u: Any) -> Sides:
    """Directions have the length 1."""
    bs, weight = drawn(bsdf, ctx, si, u)
    return np.linalg.norm(rows(bs.wo), axis=0), 1, lit(weight)


def index_of_reflection(bsdf: Any, ctx: Any, si: Any, u: Any) -> Sides:
    """The eta of a reflection is 1."""
    bs, weight = drawn(bsdf, ctx, si, u)
    return rows(bs.eta), 1, lit(weight) & (np.array(bs.wo.z * si.wi.z) > 0)


def index(bsdf: Any, ctx: Any, si: Any, u: Any) -> Sides:
    """The square of eta is the ratio of light that passes each way."""
    bs, weight = drawn(bsdf, ctx, si, u)
    there = value(bsdf, ctx, si, bs.wo).mean(axis=0) / np.abs(bs.wo.z)
    back = value(bsdf, ctx, lit_from(si, bs.wo), si.wi).mean(axis=0) / np.abs(si.wi.z)
    through = (np.array(bs.wo.z * si.wi.z) < 0) & (np.abs(bs.wo.z) > 1e-3)
    return rows(bs.eta) ** 2, there / back, through & smooth(bs, weight)


DIRECTIONS = Question(
    "directions",
    __doc__,
    BIAS,
    SAMPLED,
    volumes="sampled directions are unit vectors",
    rank=0,
    shown=Claim(length, by_sample),
)


class Directions(Mistake):
    """Mistakes in a record of `sample`."""

    LENGTH = "{who}: directions are not of length 1"
    THROUGH = "{who}: a sample of a reflecting type leaves on the other side"
    THROUGH_AGREED = """{who}: a sample of a reflecting type leaves on the other side,
        as `eval` has it: a type or a side is declared wrongly"""
    BACK = "{who}: a sample of a transmitting type leaves on the side of incidence"
    BACK_AGREED = """{who}: a sample of a transmitting type leaves on the side of
        incidence, as `eval` has it: a type or a side is declared wrongly"""
    NEITHER = "{who}: sampled_type names neither reflection nor transmission"
    ETA_OF_REFLECTION = "{who}: eta is not 1 for a reflection"
    ETA_NOT_POSITIVE = "{who}: eta is not positive"
    ETA_OF_OTHER_SIDE = """{who}: eta of a transmitted direction is that of the other
        side"""
    ETA = "{who}: eta of a transmitted direction is wrong"


@DIRECTIONS.asks("samples")
def check_samples(evidence: Evidence, samples: Samples) -> None:
    """Check length, side, type and index of refraction of each sample."""
    given = samples.given & np.isfinite(samples.wo).all(axis=1)
    if not given.any():
        return
    lengths, due, _ = samples.hold(length)
    flags = mi.BSDFFlags
    reflects = (samples.type & int(flags.Reflection)) != 0
    transmits = (samples.type & int(flags.Transmission)) != 0
    # on the horizon no side is wrong
    beside = np.abs(samples.wo[:, 2]) < BSDF_ROUNDING
    beside |= np.abs(samples.wi[:, 2]) < BSDF_ROUNDING
    one_way = reflects & ~transmits & ~samples.reflected & ~beside
    other_way = transmits & ~reflects & samples.reflected & ~beside
    # `eval` is weight times pdf: integrators only ask whether a type is discrete
    agreed = ~unequal(samples.flux, samples.eval, samples.eval_slack)
    agreed &= (samples.eval > 0).any(axis=1)
    bent = reflects & ~(np.abs(samples.eta - 1) < BSDF_ROUNDING) & ~transmits
    too_long = (np.abs(lengths - due) > BSDF_ROUNDING)[:, 0]
    side, eta = Claim(sides, same), Claim(index_of_reflection, by_sample)
    for wrong, mistake, effect, shown in (
        (too_long, Directions.LENGTH, "", None),
        (one_way & ~agreed, Directions.THROUGH, "", side),
        (one_way & agreed, Directions.THROUGH_AGREED, INTERFACE, side),
        (other_way & ~agreed, Directions.BACK, "", side),
        (other_way & agreed, Directions.BACK_AGREED, INTERFACE, side),
        (~reflects & ~transmits, Directions.NEITHER, INTERFACE, side),
        # only Russian roulette uses it
        (bent, Directions.ETA_OF_REFLECTION, NOISE, eta),
        (~(samples.eta > 0), Directions.ETA_NOT_POSITIVE, "", eta),
    ):
        wrong = wrong & given
        if beyond_rounding(wrong):
            guess, how = mistake(SAMPLE), {"effect": effect, "shown": shown}
            evidence.breach(DIRECTIONS, guess, samples, wrong, **how)


def check_eta(evidence: Evidence, ways: BothWays) -> BothWays:
    """Check that eta of a transmitted sample is that between the transport modes.

    Returns
    -------
    BothWays
        With the index that the modes imply, if the sample's differs.
    """
    samples = ways.samples
    through = ways.smooth & ~samples.reflected
    # of several wavelengths eta is that of the first
    first = slice(1 if mi.is_spectral else None)
    others = [x[:, first].sum(axis=1) for x in (ways.backward, samples.other_mode)]
    through &= (others[0] > 0) & (others[1] > 0)
    if not beyond_rounding(through) or evidence.of("sampled_weight"):
        return ways
    by_way, by_mode = (
        here[through, first].sum(axis=1) / other[through]
        for here, other in zip((ways.forward, samples.eval), others)
    )
    if not (is_constant(by_way) and is_constant(by_mode)):
        return ways
    due, other = float(np.median(by_way)), float(np.median(by_mode))
    reported = float(np.median(samples.eta[through] ** 2))
    if abs(other / due - 1) > MAX_OFF or abs(reported / due - 1) < MAX_OFF:
        return ways
    inverse = abs(reported * due - 1) < MAX_OFF
    mistake = Directions.ETA_OF_OTHER_SIDE if inverse else Directions.ETA
    # only Russian roulette uses it
    how = {"off": None, "effect": NOISE, "shown": Claim(index, by_sample)}
    text = f"{reported**0.5:.4g} where the transport modes of `eval` have "
    text += f"{due**0.5:.4g},"
    evidence.breach(DIRECTIONS, mistake(SAMPLE), samples, through, found=text, **how)
    return replace(ways, eta2=np.where(samples.reflected[:, None], 1.0, due))

"""Discrete lobes have one direction, weight and probability."""

from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np
from scipy import special

from ...array_types import Flags, Floats
from ...single_precision import BSDF_ROUNDING
from ..arrays import Sides, discrete, drawn, rows
from ..evidence import BIAS, MODEL, SAMPLED, Evidence, Question
from ..judgements import apart, by_sample, equal
from ..mistakes import SAMPLE, Claim, Function, Mistake
from ..probe import Probe
from ..samples import Samples, beyond_rounding


def first_lobe(bs: Any) -> Any:
    """Whether samples have the direction of the first discrete one."""
    own = discrete(bs) & (rows(bs.pdf)[0] > 0)
    wo = np.array(bs.wo) + np.zeros(own.shape)
    return own & np.all(np.abs(wo - wo[:, own.argmax(), None]) < 1e-3, axis=0)


def probability(bsdf: Any, ctx: Any, si: Any, u: Any) -> tuple[float, float, float]:
    """The pdf of a discrete lobe is the probability with which it is drawn."""
    bs, _ = drawn(bsdf, ctx, si, u)
    own = first_lobe(bs)
    pdf = np.broadcast_to(rows(bs.pdf)[0], own.shape)[own.argmax()]
    return np.mean(own), pdf, np.std(own) / own.size**0.5


def mirrored(bsdf: Any, ctx: Any, si: Any, u: Any) -> Sides:
    """A discrete lobe has the direction of a mirror."""
    bs, _ = drawn(bsdf, ctx, si, u)
    return rows(bs.wo.x), rows(mi.reflect(si.wi).x), first_lobe(bs)


def one_weight(bsdf: Any, ctx: Any, si: Any, u: Any) -> tuple[float, float]:
    """A discrete lobe has one weight."""
    bs, weight = drawn(bsdf, ctx, si, u)
    weights = rows(weight).mean(axis=0)[first_lobe(bs)]
    return weights.min(), weights.max()


def null_transmission(bsdf: Any, ctx: Any, si: Any, u: Any) -> tuple[float, float]:
    """`eval_null_transmission` is the flux that samples have straight on."""
    bs, weight = drawn(bsdf, ctx, si, u)
    straight = np.array(bs.sampled_type) & int(mi.BSDFFlags.Null) != 0
    flux = (rows(weight) * rows(bs.pdf)).mean(axis=0)[straight]
    return np.mean(flux), np.mean(rows(bsdf.eval_null_transmission(si, True)))


DELTA = Question(
    "delta", __doc__, BIAS, SAMPLED, rank=0, shown=Claim(probability, apart)
)


class Delta(Mistake):
    """Mistakes in discrete lobes."""

    MANY_DIRECTIONS = """{who} gives many directions to a lobe whose sampled_type is
        discrete, where `eval` is not 0 either: light is counted twice"""
    MANY_WEIGHTS = "{who} gives one discrete lobe different weights"
    DIRECTION = "the direction of a discrete lobe of {who} is not {law}"
    PROBABILITY = "{who}: the pdf of a discrete lobe is not its probability"
    OTHER_THAN_SAMPLED = "{who} is not weight times pdf of the null lobe of `sample`"


# Directions that are the same differ by that at the horizon, where single precision
# finds a cosine from a sine.
DIRECTION_ROUNDING = 2 * 2.0**-11.5

# Known error of a probability: rounding of 1 minus a number, and the steps of sample1.
PROBABILITY_ROUNDING = 2.0**-22

# Samples that would meet a lobe of which none is drawn by chance, with exp(-MISSED).
MISSED = 32

# Directions of one component and type, as of the orders of a grating.
MAX_DIRECTIONS = 32


@dataclass(frozen=True)
class Lobe:
    """A discrete lobe: its samples, `own` of all, and their direction and type.

    Of several directions of one component and type, each is a lobe, and none is
    `alone`.
    """

    samples: Samples
    own: Flags
    wo: Floats
    kind: int
    alone: bool


def lobes_of(evidence: Evidence, samples: Samples) -> list[Lobe]:
    """Discrete lobes that have one direction and one weight, for further checks.

    Their directions, weights and probabilities are checked here.
    """
    delta = samples.given & samples.delta & np.isfinite(samples.wo).all(axis=1)
    pairs = set(zip(samples.component[delta], samples.type[delta]))
    lobes = []
    for component, kind in sorted(pairs):
        own = delta & (samples.component == component) & (samples.type == kind)
        if beyond_rounding(own):
            found = _split(evidence, samples, own, int(kind))
            lobes += [lobe for lobe in found if _check_lobe(evidence, lobe)]
    return lobes


def _split(evidence: Evidence, samples: Samples, own: Flags, kind: int) -> list[Lobe]:
    """Lobes of one component and type, by their directions.

    A few directions may be those of a grating; more are a breach.
    """
    wo = np.median(samples.wo[own], axis=0)
    spread = np.abs(samples.wo[own] - wo).max()
    if spread <= DIRECTION_ROUNDING:
        return [Lobe(samples, own, wo, kind, alone=True)]
    lobes: list[Lobe] = []
    rest = own
    while rest.any() and len(lobes) < MAX_DIRECTIONS:
        off = np.abs(samples.wo - samples.wo[rest.argmax()]).max(axis=1)
        part = rest & (off < 2 * DIRECTION_ROUNDING)
        wo = np.median(samples.wo[part], axis=0)
        lobes.append(Lobe(samples, part, wo, kind, alone=False))
        rest = rest & ~part
    if not beyond_rounding(rest):
        return [lobe for lobe in lobes if beyond_rounding(lobe.own)]
    text = f"directions differ by up to {spread:.3g}"
    lit: Flags = (np.nan_to_num(samples.eval[own], nan=1.0) != 0).any(axis=1)
    if beyond_rounding(lit):
        guess = Delta.MANY_DIRECTIONS(SAMPLE)
        evidence.breach(DELTA, guess, samples.condition, found=text, size=spread)
    else:
        # each sample meets a mirror of its own, which no other function knows
        text = f"one discrete lobe draws its {text} at {samples.condition}"
        evidence.remark("delta", text)
    return []


def _check_lobe(evidence: Evidence, lobe: Lobe) -> bool:
    """Check direction, probability and weights; return whether one weight is all."""
    samples = lobe.samples
    weight = samples.weight[lobe.own]
    if lobe.alone:
        _check_direction(evidence, lobe)
    _check_probability(evidence, lobe)
    if np.ptp(weight, axis=0).max() > BSDF_ROUNDING * np.abs(weight).max():
        text = f"weights from {weight.min():.4g} to {weight.max():.4g}"
        guess, how = Delta.MANY_WEIGHTS(SAMPLE), Claim(one_weight, equal)
        evidence.breach(DELTA, guess, samples.condition, found=text, shown=how)
        return False
    return True


def _check_direction(evidence: Evidence, lobe: Lobe) -> None:
    """Check that the direction is mirrored, refracted by eta, or straight on."""
    wi, wo, flags = lobe.samples.condition.wi, lobe.wo, mi.BSDFFlags
    if lobe.kind & int(flags.Null):
        off, law = np.abs(wo + wi).max(), "straight on"
    elif lobe.kind & int(flags.DeltaReflection):
        off, law = np.abs(wo - wi * [-1, -1, 1]).max(), "that of a mirror"
    else:
        eta = float(np.median(lobe.samples.eta[lobe.own]))
        off = np.abs(wi[:2] + eta * wo[:2]).max()
        law = "that of Snell's law for its eta"
    if off > DIRECTION_ROUNDING:
        guess, at = Delta.DIRECTION(SAMPLE, law=law), lobe.samples.condition
        how = {"size": off, "effect": MODEL, "shown": Claim(mirrored, by_sample)}
        text = f"the direction is off by {off:.3g}"
        evidence.breach(DELTA, guess, at, found=text, **how)


def _check_probability(evidence: Evidence, lobe: Lobe) -> None:
    """Test that the pdf of a discrete sample is the probability of its lobe."""
    p = float(np.median(lobe.samples.sampled_pdf[lobe.own]))
    k, n = int(lobe.own.sum()), lobe.samples.n
    # the probability within its error that suits best
    low, high = max(p - PROBABILITY_ROUNDING, 0.0), min(p + PROBABILITY_ROUNDING, 1.0)
    due = float(np.clip(k / n, low, high))
    if not 0 <= p <= 1 + BSDF_ROUNDING:
        tail = 0.0
    else:
        at_most = 1.0 if k >= n else special.bdtr(k, n, due)
        at_least = 1.0 if k <= 0 else special.bdtrc(k - 1, n, due)
        tail = min(1.0, 2 * min(at_most, at_least))
    text = f"a discrete lobe of pdf {p:.5g} is drawn {k / n:.5g} of the time"
    guess = Delta.PROBABILITY(SAMPLE)
    evidence.test(DELTA, tail, text, lobe.samples.condition, guess=guess)


def check_null(evidence: Evidence, samples: Samples) -> None:
    """Check that ``eval_null_transmission`` is the flux that passes undeviated."""
    if samples.condition.component is not None:
        return
    null = samples.given & ((samples.type & int(mi.BSDFFlags.Null)) != 0)
    function = Function.EVAL_NULL_TRANSMISSION
    reported = Probe(evidence.bsdf, samples.condition).of_surface(str(function))
    sampled, slack = np.zeros_like(reported), MISSED / samples.n
    if null.any():
        sampled, slack = samples.flux[null].mean(axis=0), BSDF_ROUNDING
    if np.abs(sampled - reported).max() > slack:
        guess, at = Delta.OTHER_THAN_SAMPLED(function), samples.condition
        text = f"says {reported.max():.4g}, sampled is {sampled.max():.4g}"
        shown = Claim(null_transmission, equal)
        evidence.breach(DELTA, guess, at, found=text, shown=shown)

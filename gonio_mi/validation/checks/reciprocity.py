"""Source and detector can be exchanged, with a factor eta^2."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import mitsuba as mi
import numpy as np

from ...array_types import Flags, Floats
from ...single_precision import BSDF_ROUNDING
from ..arrays import (
    Sides,
    drawn,
    lit_from,
    opposite,
    rows,
    smooth,
)
from ..densities import Means
from ..evidence import ALL, BIAS, BREAKS, FROM_LIGHTS, MODEL, Evidence, Question
from ..judgements import apart, by_sample
from ..mistakes import EVAL, SAMPLE, Claim, Guess, Mistake
from ..probe import Probe, numbers, spectral
from ..samples import Samples, beyond_rounding, samples_of, unequal
from .delta import DIRECTION_ROUNDING, Lobe, first_lobe


def exchanged(bsdf: Any, ctx: Any, si: Any, u: Any, other: Any) -> Sides:
    """`eval` over the cosine, and on the way back in another context."""
    bs, weight = drawn(bsdf, ctx, si, u)
    cos_i, cos_o = (np.fmax(np.abs(rows(w.z)), 1e-30) for w in (si.wi, bs.wo))
    back = rows(bsdf.eval(other, lit_from(si, bs.wo), si.wi, True)) / cos_i
    counts = smooth(bs, weight) & (cos_o[0] > 1e-3)
    return rows(bsdf.eval(ctx, si, bs.wo, True)) / cos_o, back, counts


def both_ways(bsdf: Any, ctx: Any, si: Any, u: Any) -> Sides:
    """`eval` over the cosine is the same both ways, eta^2 apart in transmission."""
    there, back, counts = exchanged(bsdf, ctx, si, u, ctx)
    bs, _ = drawn(bsdf, ctx, si, u)
    eta = np.where(rows(bs.wo.z * si.wi.z) < 0, rows(bs.eta), 1)
    return there, back * eta**2, counts


def lobe_both_ways(bsdf: Any, ctx: Any, si: Any, u: Any) -> Means:
    """A discrete lobe has as much light as on its way back."""
    bs, weight = drawn(bsdf, ctx, si, u)
    own, wo = first_lobe(bs), np.array(bs.wo) + np.zeros(np.shape(u))
    x, way = rows(weight).mean(axis=0) * own, mi.Vector3f(wo[:, [own.argmax()]])
    bs, weight = drawn(bsdf, ctx, lit_from(si, way + 0 * u), u)
    same = np.all(np.abs(np.array(bs.wo) - np.array(si.wi)) < 1e-3, axis=0)
    y = rows(weight).mean(axis=0) * same
    return np.mean(x), np.mean(y), np.std(x - y) / len(own) ** 0.5


RECIPROCITY = Question(
    "reciprocity",
    __doc__,
    MODEL,
    {BIAS: ALL, BREAKS: FROM_LIGHTS},
    volumes="Helmholtz reciprocity",
    matrices="Helmholtz reciprocity, in all elements",
    rank=2,
    shown=Claim(both_ways, by_sample),
)


class Reciprocity(Mistake):
    """What is wrong if light goes the other way."""

    ONE_WAY = "{who} lets light go one way only"
    ASYMMETRIC = "{who} is not symmetric in wi and wo, in a Fresnel term perhaps"
    FACTOR = """{who} transmits {factor:.4g} times what it does the other way, where
        eta^2 is expected"""
    IN_TRANSMISSION = """{who} is not symmetric in wi and wo, apart from eta^2, in
        transmission"""
    OF_A_LOBE = "{who} gives a discrete lobe another share than its reverse"
    ETA2_OF_A_LOBE = """{who} gives a discrete lobe another share than its reverse in
        importance mode: 1/eta^2 belongs to radiance mode only"""


# Rounding of a squared cosine that is found from sines: of four products.
SQUARE_ROUNDING = 2.0**-22

# Relative difference of two squared indices that are the same.
MAX_OFF = 1e-3


@dataclass(frozen=True)
class BothWays:
    """``f = eval / |cos theta_o|`` in importance mode, and with wi and wo exchanged.

    Attributes
    ----------
    samples : Samples
    smooth : ndarray
        Where all are finite.
    forward, backward, adjoint, slack : ndarray, shape (n, channels)
        f there, back, and back in radiance mode.
    eta2 : ndarray, shape (n, 1) or (n, channels)
        Square of the sample's relative index of refraction; 1 for a reflection.
    """

    samples: Samples
    smooth: Flags
    forward: Floats
    backward: Floats
    adjoint: Floats
    slack: Floats
    eta2: Floats

    def ratio(self, other: Floats, mask: Flags) -> Floats:
        """Ratio of `forward` to another array, for some samples."""
        below = np.maximum(other[mask].sum(axis=1), 1e-30)
        return self.forward[mask].sum(axis=1) / below


def ways_of(samples: Samples) -> BothWays | None:
    """Values both ways; None if there are none, or in radiance mode."""
    if samples.condition.mode != "importance":
        return None
    cos_i, cos_o = abs(samples.condition.wi[2]), np.abs(samples.wo[:, 2])
    smooth = samples.smooth & (cos_o > 1e-4)
    for answer in (samples.eval, samples.reverse, samples.reverse_other_mode):
        smooth = smooth & np.isfinite(answer).all(axis=1)
    if not smooth.any():
        return None
    cos_o = np.where(smooth, cos_o, 1.0)[:, None]
    ctx = samples.condition.context
    forward, backward, _ = samples.hold(exchanged, ctx)
    return BothWays(
        samples,
        smooth,
        forward,
        backward,
        samples.hold(exchanged, opposite(ctx))[1],
        samples.eval_slack / cos_o + samples.reverse_slack / cos_i,
        # reflection has no index, whatever a plugin says
        np.where(samples.reflected, 1.0, samples.eta**2)[:, None],
    )


def dispersed(ways: BothWays) -> BothWays:
    """Values with an index of each wavelength, as light passes each way.

    ``bs.eta`` is that of the first. Where the ratio of both ways is constant for
    another, it may be the square of its own index: nothing else tells that.
    """
    through = ways.smooth & ~ways.samples.reflected
    eta2 = np.broadcast_to(ways.eta2, ways.forward.shape).copy()
    for channel in range(eta2.shape[1] if mi.is_spectral else 0):
        there, back = ways.forward[:, channel], ways.backward[:, channel]
        lit = through & (there > 0) & (back > 0)
        constant = beyond_rounding(lit) and is_constant(there[lit] / back[lit])
        own = np.median(there[lit] / back[lit]) if constant else 0.0
        if channel > 0 and constant:
            eta2[through, channel] = own
        elif channel == 0:
            known = constant and abs(own / np.median(eta2[lit, 0]) - 1) < MAX_OFF
            if not known:
                return ways  # nothing to compare, or wrong for `bs.eta`
    return replace(ways, eta2=eta2)


def check_ways(evidence: Evidence, ways: BothWays) -> None:
    """Check that ``f(wi, wo)`` is ``eta^2 f(wo, wi)`` (Veach 1997, section 5.2)."""
    samples, due = ways.samples, ways.eta2 * ways.backward
    slack = ways.slack * (1 + ways.eta2)
    wrong = unequal(ways.forward, due, slack) & ways.smooth
    if beyond_rounding(wrong):
        text = ratio_text(ways.forward, due, wrong, samples)
        if np.all(_declared_asymmetric(evidence.bsdf, ways)[wrong]):
            evidence.declared["reciprocity"] = f"{text}, declared as NonSymmetric"
        else:
            how = {"statistic": text, "off": None}
            evidence.breach(RECIPROCITY, _guess(ways, wrong), samples, wrong, **how)


def _declared_asymmetric(bsdf: mi.BSDF, ways: BothWays) -> Flags:
    """Mask of samples on whose side a NonSymmetric component explains asymmetry.

    In transmission with another eta than 1 the flag stands for eta^2 alone.
    """
    flags, only = mi.BSDFFlags, ways.samples.condition.component
    reflects, transmits = (
        _is_nonsymmetric(bsdf, int(side), only)
        for side in (flags.Reflection, flags.Transmission)
    )
    straight = np.abs(ways.eta2[:, 0] - 1) < BSDF_ROUNDING
    return np.where(ways.samples.reflected, reflects, transmits & straight)


def _is_nonsymmetric(bsdf: mi.BSDF, kinds: int, only: int | None) -> bool:
    """Whether a component with lobes of some `kinds`, or `only` one, is declared so."""
    wanted = range(bsdf.component_count()) if only is None else [only]
    own = [int(bsdf.flags(i)) for i in wanted] or [int(bsdf.flags())]
    return any(f & int(mi.BSDFFlags.NonSymmetric) and f & kinds for f in own)


def _guess(ways: BothWays, wrong: Flags) -> Guess:
    """Likely mistake in ``eval``, judged by the ratio of f one way to the other."""
    if not ways.backward[wrong].any():
        return Reciprocity.ONE_WAY(EVAL)
    if ways.samples.reflected[wrong].all():
        return Reciprocity.ASYMMETRIC(EVAL)
    ratio = ways.ratio(ways.backward, wrong)
    if is_constant(ratio):
        return Reciprocity.FACTOR(EVAL, factor=np.median(ratio))
    return Reciprocity.IN_TRANSMISSION(EVAL)


def ratio_text(a: Floats, b: Floats, wrong: Flags, samples: Samples) -> str:
    """Sentence on the ratio of f one way to f the other way."""
    a, b = a[wrong].sum(axis=1), b[wrong].sum(axis=1)
    # also of negative values, which are wrong already
    both = (a != 0) & (b != 0)
    one_way = wrong.copy()
    one_way[wrong] = (a != 0) != (b != 0)
    if one_way.sum() > 0.5 * wrong.sum() or not both.any():
        return f"light goes one way only for {samples.fraction(one_way)}"
    low, high = np.quantile(a[both] / b[both], [0.05, 0.95])
    place = samples.fraction(wrong)
    return f"f(wi, wo) over f(wo, wi) is {low:.4g} to {high:.4g} for {place}"


def is_constant(ratio: Floats) -> bool:
    """Whether nearly all values of a ratio are one."""
    low, high = np.quantile(ratio, [0.02, 0.98])
    return high - low < 0.01 * abs(high)


def check_lobe(evidence: Evidence, lobe: Lobe, key: tuple[int, ...]) -> bool:
    """Check that light sent back along a discrete lobe returns with the same share.

    Return whether it does; True also where no light can be sent back.
    """
    samples = lobe.samples
    if samples.condition.mode != "importance" or abs(lobe.wo[2]) < 1e-3:
        return True
    reverse = samples.condition.lit_from(lobe.wo)
    back = samples_of(evidence.bsdf, reverse, samples.n, (*key, 7), False)
    returned = back.given & (back.type == lobe.kind)
    off = np.abs(back.wo - samples.condition.wi).max(axis=1)
    returned &= off < DIRECTION_ROUNDING
    there, again = (
        x.flux[mask].mean(axis=0) if mask.any() else np.zeros(samples.weight.shape[1])
        for x, mask in ((samples, lobe.own), (back, returned))
    )
    known = BSDF_ROUNDING + _sensitivity(evidence.bsdf, lobe)
    if not np.abs(there - again).max() > known:
        return True
    text = (
        f"a discrete lobe has {there.max():.4g} of the light, {again.max():.4g} on the "
        f"way back, at {samples.condition}"
    )
    mistake, effect = Reciprocity.OF_A_LOBE, MODEL  # as of a smooth lobe
    eta2 = float(np.median(samples.eta[lobe.own])) ** 2
    refracts = bool(lobe.kind & int(mi.BSDFFlags.DeltaTransmission))
    if refracts and abs(eta2 - 1) > BSDF_ROUNDING:
        mistake, effect = Reciprocity.ETA2_OF_A_LOBE, BREAKS
    elif _is_nonsymmetric(evidence.bsdf, lobe.kind, samples.condition.component):
        evidence.declared["reciprocity"] = f"{text}, declared as NonSymmetric"
        return False
    how = {"effect": effect, "shown": Claim(lobe_both_ways, apart)}
    where = samples.condition
    evidence.breach(RECIPROCITY, mistake(SAMPLE), where, statistic=text, **how)
    return False


def _sensitivity(bsdf: mi.BSDF, lobe: Lobe) -> float:
    """Largest change of the share on the way back if rounding tilts the direction."""
    wo, n = lobe.wo, lobe.samples.n
    cosine = abs(wo[2])
    tilt = min(SQUARE_ROUNDING / (2 * cosine), np.sqrt(SQUARE_ROUNDING))
    shares = []
    for change in (-2 * tilt, -tilt, 0.0, tilt, 2 * tilt):
        z = max(cosine + change, tilt / 2) * np.sign(wo[2])
        tilted = lobe.samples.condition.lit_from(np.array([wo[0], wo[1], z]))
        bs, weight = Probe(bsdf, tilted).sample(*lobe.samples.random)
        share = spectral(weight, n) * numbers(bs.pdf, n)[:, None]
        same = numbers(bs.sampled_type, n) == lobe.kind
        shares.append(share[same].mean(axis=0) if same.any() else 0 * share[0])
    return np.max(np.abs(np.array(shares) - shares[2]))

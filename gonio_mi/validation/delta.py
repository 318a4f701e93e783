"""Discrete lobes: one direction each, one weight, and the probability that they say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np
from scipy import special

from ..array_types import Flags, Floats
from .collecting import Drawn, collect
from .conditions import Condition, LitFrom
from .equality import BSDF_ROUNDING, is_many, unequal
from .evidence import BIAS, BREAKS, MODEL, Evidence
from .probe import Probe, numbers, spectral

__all__ = ["check_delta", "check_null"]

# Error of a cosine that single precision finds from a sine, at the horizon; there,
# directions that are the same differ by that.
HORIZON = 2.0**-11.5
SAME = 2 * HORIZON

# Rounding of a squared cosine that is found from sines: of four products.
SQUARE = 2.0**-22

# Known error of a probability: rounding of 1 minus a number, and the steps of sample1.
STEP = 2.0**-22


def check_delta(
    evidence: Evidence, drawn: Drawn, bsdf: mi.BSDF, key: tuple[int, ...]
) -> None:
    """Direction, weight, probability and reversal of each discrete lobe."""
    lobes = drawn.given & drawn.delta & np.isfinite(drawn.wo).all(axis=1)
    if not lobes.any():
        return
    for component, kind in sorted(set(zip(drawn.component[lobes], drawn.type[lobes]))):
        own = lobes & (drawn.component == component) & (drawn.type == kind)
        if is_many(own, drawn.n):
            _check_lobe(evidence, drawn, own, int(kind), bsdf, key)


def _check_lobe(
    evidence: Evidence,
    drawn: Drawn,
    own: Flags,
    kind: int,
    bsdf: mi.BSDF,
    key: tuple[int, ...],
) -> None:
    wo, weight = drawn.wo[own], drawn.weight[own]
    where = f"at {drawn.condition}"
    middle = np.median(wo, axis=0)
    spread = np.abs(wo - middle).max()
    if spread > SAME:
        evidence.breach(
            "delta",
            "sample",
            f"directions differ by up to {spread:.3g} {where}",
            "`sample` gives many directions to a lobe whose sampled_type is discrete",
            size=spread,
        )
        return
    _check_direction(evidence, drawn, own, middle, kind)
    _check_probability(evidence, drawn, own)
    if np.ptp(weight, axis=0).max() > BSDF_ROUNDING * np.abs(weight).max():
        evidence.breach(
            "delta",
            "sample",
            f"weights from {weight.min():.4g} to {weight.max():.4g} {where}",
            "`sample` gives one discrete lobe different weights",
        )
        return
    known = len(evidence.breaches)
    _check_reversal(evidence, drawn, own, middle, bsdf, key)
    returns = len(evidence.breaches) == known
    _check_modes(evidence, drawn, own, bsdf, key, returns)


def _check_direction(
    evidence: Evidence, drawn: Drawn, own: Flags, wo: Floats, kind: int
) -> None:
    """Mirrored, refracted by eta or straight, about one normal of the surface."""
    wi, flags = drawn.condition.wi, mi.BSDFFlags
    if kind & int(flags.Null):
        off, law = np.abs(wo + wi).max(), "straight on"
    elif kind & int(flags.DeltaReflection):
        off, law = np.abs(wo - wi * [-1, -1, 1]).max(), "that of a mirror"
    else:
        eta = float(np.median(drawn.eta[own]))
        off, law = (
            np.abs(wi[:2] + eta * wo[:2]).max(),
            "that of Snell's law for its eta",
        )
    if off > SAME:
        evidence.breach(
            "delta",
            "sample",
            f"the direction is off by {off:.3g} at {drawn.condition}",
            f"the direction of a discrete lobe of `sample` is not {law}",
            size=off,
            effect=MODEL,
        )


def _check_probability(evidence: Evidence, drawn: Drawn, own: Flags) -> None:
    """The pdf of a discrete sample is the probability of its lobe."""
    p = float(np.median(drawn.sampled_pdf[own]))
    k, n = int(own.sum()), drawn.n
    # the probability within its error that suits best
    due = float(np.clip(k / n, max(p - STEP, 0.0), min(p + STEP, 1.0)))
    if not 0 <= p <= 1 + BSDF_ROUNDING:
        tail = 0.0
    else:
        at_most = 1.0 if k >= n else special.bdtr(k, n, due)
        at_least = 1.0 if k <= 0 else special.bdtrc(k - 1, n, due)
        tail = min(1.0, 2 * min(at_most, at_least))
    evidence.test(
        "delta",
        tail,
        f"a discrete lobe of pdf {p:.5g} is drawn {k / n:.5g} of the time",
        drawn.condition,
    )


def _check_reversal(
    evidence: Evidence,
    drawn: Drawn,
    own: Flags,
    wo: Floats,
    bsdf: mi.BSDF,
    key: tuple[int, ...],
) -> None:
    """Light sent back along a discrete lobe returns with the same share."""
    wi = drawn.condition.wi
    if drawn.condition.mode != "importance" or abs(wo[2]) < 1e-3:
        return
    reverse: Any = LitFrom(drawn.condition, wo)
    back = collect(bsdf, reverse, drawn.n, (*key, 7))
    returned = back.given & (back.type == drawn.type[own][0])
    returned &= np.abs(back.wo - wi).max(axis=1) < SAME
    shares = [
        (x.weight[mask] * x.sampled_pdf[mask][:, None]).mean(axis=0)
        if mask.any()
        else np.zeros(drawn.weight.shape[1])
        for x, mask in ((drawn, own), (back, returned))
    ]
    known = BSDF_ROUNDING + _sensitivity(drawn.condition, own, drawn, wo, bsdf)
    if np.abs(shares[0] - shares[1]).max() > known:
        evidence.breach(
            "reciprocity",
            "sample",
            f"a discrete lobe has {shares[0].max():.4g} of the light, "
            f"{shares[1].max():.4g} on the way back, at {drawn.condition}",
            "`sample` gives a discrete lobe another share than its reverse in "
            "importance mode: 1/eta^2 belongs to radiance mode only",
            effect=BREAKS,
        )


def _sensitivity(
    condition: Condition, own: Flags, drawn: Drawn, wo: Floats, bsdf: mi.BSDF
) -> float:
    """Change of the share of the way back where rounding tilts its direction."""
    cosine = abs(wo[2])
    tilt = min(SQUARE / (2 * cosine), np.sqrt(SQUARE))
    kind, n = drawn.type[own][0], drawn.n
    random = mi.Float(drawn.sample1), mi.Point2f(drawn.sample2.T)
    shares = []
    for change in (-2 * tilt, -tilt, 0.0, tilt, 2 * tilt):
        z = max(cosine + change, tilt / 2) * np.sign(wo[2])
        reverse: Any = LitFrom(condition, np.array([wo[0], wo[1], z]))
        probe = Probe(bsdf, reverse)
        one = probe.sample(*random)
        share = spectral(one.weight, n) * numbers(one.bs.pdf, n)[:, None]
        same = numbers(one.bs.sampled_type, n) == kind
        shares.append(share[same].mean(axis=0) if same.any() else 0 * share[0])
    return np.max(np.abs(np.array(shares) - shares[2]))


def _check_modes(
    evidence: Evidence,
    drawn: Drawn,
    own: Flags,
    bsdf: mi.BSDF,
    key: tuple[int, ...],
    returns: bool,
) -> None:
    """Radiance that crosses an interface is divided by eta^2.

    If light `returns` as it went in importance mode, it is radiance mode that is wrong.
    """
    if drawn.condition.mode != "importance":
        return
    same = collect(bsdf, replace(drawn.condition, mode="radiance"), drawn.n, key)
    both = own & same.given & (same.type == drawn.type)
    reflected = drawn.reflected | ((drawn.type & int(mi.BSDFFlags.Null)) != 0)
    eta2 = np.where(reflected, 1.0, drawn.eta**2)[:, None]
    wrong = unequal(same.weight * eta2, drawn.weight, 0.0) & both
    if is_many(wrong, drawn.n):
        ratio = np.median(same.weight[wrong] / drawn.weight[wrong])
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
            f"at {drawn.condition}",
            mistake,
            effect=BIAS if returns else BREAKS,
        )


def check_null(evidence: Evidence, drawn: Drawn, probe: Probe) -> None:
    """``eval_null_transmission`` is what passes undeviated."""
    if drawn.condition.component is not None:
        return
    null = drawn.given & ((drawn.type & int(mi.BSDFFlags.Null)) != 0)
    if not null.any():
        return
    passed = (drawn.weight[null] * drawn.sampled_pdf[null][:, None]).mean(axis=0)
    said = np.ravel(np.array(probe.null_transmission(), dtype=float))
    if np.abs(passed - said).max() > BSDF_ROUNDING:
        evidence.breach(
            "delta",
            "eval_null_transmission",
            f"says {said.max():.4g}, sampled is {passed.max():.4g} "
            f"at {drawn.condition}",
            "`eval_null_transmission` is not the share that `sample` lets pass",
        )

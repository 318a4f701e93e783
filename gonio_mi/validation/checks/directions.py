"""Sampled directions: unit vectors, on the side and of the type of their record."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ...array_types import Flags
from ..evidence import INTERFACE, NOISE, Evidence
from ..samples import BSDF_ROUNDING, Samples, is_many, unequal

__all__ = ["check_samples"]

# Why a type is wrong, if all else agrees.
AGREED = "as `eval` has it: a type or a side is declared wrongly"


def check_samples(evidence: Evidence, samples: Samples) -> None:
    """Length, side, type and index of refraction of each sample."""
    given = samples.given & np.isfinite(samples.wo).all(axis=1)
    if not given.any():
        return
    length = np.linalg.norm(samples.wo, axis=1)
    flags = mi.BSDFFlags
    reflects = (samples.type & int(flags.Reflection)) != 0
    transmits = (samples.type & int(flags.Transmission)) != 0
    # on the horizon no side is wrong
    beside = np.abs(samples.wo[:, 2]) < BSDF_ROUNDING
    beside |= abs(samples.condition.wi[2]) < BSDF_ROUNDING
    one_way = reflects & ~transmits & ~samples.reflected & ~beside
    other_way = transmits & ~reflects & samples.reflected & ~beside
    agreed = _agreed(samples)
    through = "a sample of a reflecting type leaves on the other side"
    back = "a sample of a transmitting type leaves on the side of incidence"
    neither = "sampled_type names neither reflection nor transmission"
    bent = reflects & ~(np.abs(samples.eta - 1) < BSDF_ROUNDING) & ~transmits
    for wrong, mistake, effect in (
        (np.abs(length - 1) > BSDF_ROUNDING, "directions are not of length 1", ""),
        (one_way & ~agreed, through, ""),
        (one_way & agreed, f"{through}, {AGREED}", INTERFACE),
        (other_way & ~agreed, back, ""),
        (other_way & agreed, f"{back}, {AGREED}", INTERFACE),
        (~reflects & ~transmits, neither, INTERFACE),
        # only Russian roulette uses it
        (bent, "eta is not 1 for a reflection", NOISE),
        (~(samples.eta > 0), "eta is not positive", ""),
    ):
        wrong = wrong & given
        if is_many(wrong):
            evidence.breach(
                "directions",
                "sample",
                samples.fraction(wrong),
                f"`sample`: {mistake}",
                samples.condition,
                size=float(wrong.mean()),
                effect=effect,
            )


def _agreed(samples: Samples) -> Flags:
    """Samples for which ``eval`` is weight times pdf, and not 0.

    Then their type is a name only: integrators ask it for discrete lobes.
    """
    product = samples.weight * samples.sampled_pdf[:, None]
    lit = (samples.eval > 0).any(axis=1)
    return lit & ~unequal(product, samples.eval, samples.eval_slack)

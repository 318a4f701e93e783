"""Jumps where special cases are: at normal incidence, and before the horizon."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..collector.directions import direction
from .collecting import Drawn
from .conditions import PHI, Condition
from .drawing import uniform
from .equality import ULPS
from .evidence import Evidence
from .probe import Probe, numbers, spectral

__all__ = ["check_cutoffs", "check_normal"]

# Tilt from the normal, in radians, and the part of all values that may change by it: a
# lobe ten times as wide changes by so much.
TILT = 2.0**-16
JUMP = 0.1

# Cosines of directions that come near to the horizon, to within 0.06 degrees.
COSINES = 2.0 ** np.arange(-2, -10.5, -0.5)

# Azimuths and samples that are looked at for each of them.
AROUND = 16
EACH = 2**6


def check_normal(evidence: Evidence, bsdf: mi.BSDF, drawn: Drawn) -> None:
    """``eval`` and ``pdf`` at normal incidence are those of incidence nearby.

    Parameters
    ----------
    drawn : Drawn
        Samples at normal incidence.
    """
    usable = drawn.smooth & np.isfinite(drawn.eval).all(axis=1)
    if drawn.condition.theta_i != 0 or not usable.any():
        return
    wo = mi.Vector3f(np.ascontiguousarray(drawn.wo.T))
    probe = Probe(bsdf, drawn.condition)
    face = np.sign(drawn.condition.wi[2])
    for function, ask, here, slack in (
        ("eval", probe.eval, drawn.eval, drawn.eval_slack),
        ("pdf", probe.pdf, drawn.pdf, drawn.pdf_slack),
    ):
        # what rounding of 4 ulp changes, a tilt of so many times as much does too
        steep = slack[usable].sum() * TILT / ULPS
        whole = here[usable].sum()
        changes = [
            np.abs(_tilted(ask, wo, phi, face, here) - here)[usable].sum()
            for phi in np.radians(PHI)
        ]
        # near normal incidence, and nowhere else, all azimuths are one direction
        jump = min(changes) / whole if whole > 0 else 0.0
        if jump > JUMP and min(changes) > 4 * steep:
            evidence.breach(
                "continuity",
                function,
                f"`{function}` changes by {jump:.3g} of itself within "
                f"{np.degrees(TILT):.1g} degrees of normal incidence, "
                f"{drawn.condition.side}",
                f"`{function}` jumps at normal incidence",
                size=float(jump),
            )


def _tilted(
    ask: Callable[..., Any], wo: mi.Vector3f, phi: float, face: float, like: Floats
) -> Floats:
    """Answers for incident light beside the normal, of the shape of `like`."""
    wi = direction(np.array(TILT), np.array(phi)) * [1, 1, face]
    value = ask(wo, wi=mi.Vector3f(wi.tolist()))
    return numbers(value, len(like)) if like.ndim == 1 else spectral(value, len(like))


def check_cutoffs(
    evidence: Evidence, bsdf: mi.BSDF, condition: Condition, key: tuple[int, ...]
) -> None:
    """No direction is black because it is near the horizon.

    Light comes from there, and goes where ``sample`` sends it; and it comes from where
    that is, and goes there. All azimuths count, so that a tilted normal hides no more
    than one side.
    """
    n = AROUND * EACH
    azimuths = np.repeat(2 * np.pi * (np.arange(AROUND) + 0.3) / AROUND, EACH)
    face = np.sign(condition.wi[2])
    probe = Probe(bsdf, condition)
    sample1, sample2 = uniform(n, key)
    lit: dict[str, list[bool]] = {"wi": [], "wo": []}
    for cosine in COSINES:
        ring = direction(np.full(n, np.arccos(cosine)), azimuths) * [1, 1, face]
        near = mi.Vector3f(np.ascontiguousarray(ring.T, dtype=np.float32))
        one = probe.sample(sample1, sample2, wi=near)
        far = mi.Vector3f(one.bs.wo)
        there = [spectral(x, n) for x in (one.weight, probe.eval(far, wi=near))]
        lit["wi"].append(any((x > 0).any() for x in there))
        lit["wo"].append(bool((spectral(probe.eval(near, wi=far), n) > 0).any()))
    for name, ones in lit.items():
        _report(evidence, name, ones, condition)


def _report(
    evidence: Evidence, name: str, lit: list[bool], condition: Condition
) -> None:
    """A breach if what is lit is so only above some angle."""
    if not any(lit) or lit[-1]:
        return
    last = COSINES[np.flatnonzero(lit)[-1]]
    theta = np.degrees(np.arccos(last))
    evidence.breach(
        "continuity",
        "eval",
        f"black for theta_{name[1]} beyond {theta:.4g} degrees, {condition.side}",
        f"`eval` is black where {name} is near the horizon, and lit above",
        size=float(last),
    )

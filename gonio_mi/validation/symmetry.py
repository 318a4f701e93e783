"""Reciprocity, and the adjoint relation between the transport modes."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats
from .collecting import Drawn
from .equality import BSDF_ROUNDING, is_many, unequal
from .evidence import Evidence

__all__ = ["check_symmetry"]


def check_symmetry(evidence: Evidence, drawn: Drawn, bsdf: mi.BSDF) -> None:
    """Compare ``eval`` with source and detector exchanged.

    With ``f = eval / |cos theta_o|`` in importance mode, it is that ``f(wi, wo)`` is
    ``eta^2 f(wo, wi)``, where eta is the sample's relative index of refraction
    (1 for a reflection), and that ``f(wi, wo)`` of one mode is ``f(wo, wi)`` of the
    other (Veach 1997, section 5.2).
    """
    if drawn.condition.mode != "importance":
        return
    cos_i, cos_o = abs(drawn.condition.wi[2]), np.abs(drawn.wo[:, 2])
    smooth = drawn.smooth & (cos_o > 1e-4)
    for value in (drawn.eval, drawn.reverse, drawn.reverse_other_mode):
        smooth = smooth & np.isfinite(value).all(axis=1)
    if not smooth.any():
        return
    cos_o = np.where(smooth, cos_o, 1.0)[:, None]
    forward, backward = drawn.eval / cos_o, drawn.reverse / cos_i
    adjoint = drawn.reverse_other_mode / cos_i
    slack = drawn.eval_slack / cos_o + drawn.reverse_slack / cos_i
    # reflection has no index, whatever a plugin says
    eta2 = np.where(drawn.reflected, 1.0, drawn.eta**2)[:, None]
    wrong = unequal(forward, eta2 * backward, slack * (1 + eta2)) & smooth
    if is_many(wrong, drawn.n):
        text = _ratio(forward, eta2 * backward, wrong, drawn)
        if np.all(_declared(drawn, bsdf, eta2)[wrong]):
            evidence.declared["reciprocity"] = f"{text}, declared as NonSymmetric"
        else:
            evidence.breach(
                "reciprocity",
                "eval",
                text,
                _not_reciprocal(forward, backward, drawn, wrong),
                size=float(wrong.mean()),
            )
    # a model that is not reciprocal is so in either mode: their ratio tells them apart
    ratio = unequal(drawn.eval, eta2 * drawn.other_mode, drawn.eval_slack * (1 + eta2))
    wrong = unequal(forward, adjoint, slack * (1 + eta2)) & smooth & ratio
    if is_many(wrong, drawn.n):
        evidence.breach(
            "adjoint",
            "eval",
            _ratio(forward, adjoint, wrong, drawn),
            _not_adjoint(forward, adjoint, drawn, wrong),
            size=float(wrong.mean()),
        )


def _declared(drawn: Drawn, bsdf: mi.BSDF, eta2: Floats) -> Flags:
    """Samples for whose side a component is NonSymmetric, not just for its eta^2."""
    flags, n = mi.BSDFFlags, bsdf.component_count()
    wanted = range(n) if (only := drawn.condition.component) is None else [only]
    own = [int(bsdf.flags(i)) for i in wanted] or [int(bsdf.flags())]
    reflects, transmits = (
        any(f & int(flags.NonSymmetric) and f & int(side) for f in own)
        for side in (flags.Reflection, flags.Transmission)
    )
    straight = np.abs(eta2[:, 0] - 1) < BSDF_ROUNDING
    return np.where(drawn.reflected, reflects, transmits & straight)


def _ratio(a: Floats, b: Floats, wrong: Flags, drawn: Drawn) -> str:
    a, b = a[wrong].sum(axis=1), b[wrong].sum(axis=1)
    # also of negative values, which are wrong already
    both = (a != 0) & (b != 0)
    one_way = np.mean((a != 0) != (b != 0))
    if one_way > 0.5 or not both.any():
        return (
            f"light goes one way only for {100 * one_way:.3g} % of the samples at "
            + str(drawn.condition)
        )
    low, high = np.quantile(a[both] / b[both], [0.05, 0.95])
    return (
        f"f(wi, wo) over f(wo, wi) is {low:.4g} to {high:.4g} for "
        f"{100 * wrong.mean():.3g} % of the samples at {drawn.condition}"
    )


def _not_reciprocal(
    forward: Floats, backward: Floats, drawn: Drawn, wrong: Flags
) -> str:
    """Likely mistake in ``eval``, by the ratio of both directions."""
    if not backward[wrong].any():
        return "`eval` lets light go one way only"
    ratio = forward[wrong].sum(axis=1) / np.maximum(backward[wrong].sum(axis=1), 1e-30)
    if drawn.reflected[wrong].all():
        return "`eval` is not symmetric in wi and wo, in a Fresnel term perhaps"
    if _is_constant(ratio):
        return (
            f"`eval` transmits {np.median(ratio):.4g} times what it does the other "
            "way, where eta^2 is due"
        )
    return "`eval` is not symmetric in wi and wo, but for eta^2, in transmission"


def _not_adjoint(forward: Floats, adjoint: Floats, drawn: Drawn, wrong: Flags) -> str:
    """Likely mistake between the modes."""
    transmitted = ~drawn.reflected[wrong]
    if transmitted.all():
        ratio = forward[wrong].sum(axis=1) / np.maximum(
            adjoint[wrong].sum(axis=1), 1e-30
        )
        eta2 = np.median(drawn.eta[wrong]) ** 2
        if _is_constant(ratio):
            middle = np.median(ratio)
            if abs(middle * eta2 - 1) < 1e-3 or abs(middle / eta2 - 1) < 1e-3:
                return (
                    "`eval` is the same in both modes: 1/eta^2 is missing in radiance "
                    "mode, or there in importance mode"
                )
            return f"`eval` of the modes has the ratio {middle:.4g}, where 1 is due"
    return (
        "`eval` of radiance mode is not that of importance mode with wi and wo swapped"
    )


def _is_constant(ratio: Floats) -> bool:
    low, high = np.quantile(ratio, [0.02, 0.98])
    return high - low < 0.01 * abs(high)

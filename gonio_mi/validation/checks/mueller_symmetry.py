"""Reciprocity, and adjointness of the transport modes, of all elements."""

from __future__ import annotations

import numpy as np

from ...array_types import Floats
from ...collector.stokes import EXCHANGE
from ..evidence import Evidence, Question
from ..mistakes import Mistake
from ..mueller import Matrices, is_depolarised, off, per_light
from ..samples import beyond_rounding
from .adjoint import ADJOINT
from .reciprocity import RECIPROCITY


class Symmetry(Mistake):
    """What is wrong with matrices the other way, or in radiance mode."""

    NOT_RECIPROCAL = """{who} is not reciprocal in its polarisation: M(wi, wo) is not Q
        M(wo, wi)^T Q"""
    OTHER_WAY = """{who} does not answer for light that goes from wo to wi in radiance
        mode (ctx.mode)"""
    DEPOLARISES = """{who} depolarises, other than in importance mode, in radiance mode
        (ctx.mode)"""
    POLARISES = """{who} polarises, other than in importance mode, in radiance mode
        (ctx.mode)"""


# Difference of elements over the first one that is no rounding, beside its slack.
ROUNDING = 2e-3


def check_reciprocity(
    evidence: Evidence, there: Matrices, back: Matrices, slack: Floats
) -> None:
    """Check ``M(wi, wo) = Q M(wo, wi)^T Q``, where Q changes the sign of U.

    Matrices are divided by their first elements, which the unpolarised variant judges.
    """
    reverse = per_light(back.in_plane())
    due = EXCHANGE @ np.swapaxes(reverse, -1, -2) @ EXCHANGE
    _compare(evidence, RECIPROCITY, there, back, due, slack)


def check_adjoint(
    evidence: Evidence, radiance: Matrices, back: Matrices, slack: Floats
) -> None:
    """Check that radiance mode answers from wo to wi as importance mode does."""
    _compare(evidence, ADJOINT, radiance, back, per_light(back.in_plane()), slack)


def _compare(
    evidence: Evidence,
    question: Question,
    one: Matrices,
    back: Matrices,
    due: Floats,
    slack: Floats,
) -> None:
    """Check matrices over their first element where there is light both ways."""
    m = per_light(one.in_plane())
    both = one.lit & back.lit & one.finite & back.finite
    size = np.where(both, np.nan_to_num(off(m, due)), 0.0)
    wrong = size > ROUNDING + slack
    if not beyond_rounding(wrong):
        return
    mistake = Symmetry.NOT_RECIPROCAL
    if question is ADJOINT:
        mistake = Symmetry.OTHER_WAY
        if is_depolarised(m[wrong]):
            mistake = Symmetry.DEPOLARISES
        elif is_depolarised(due[wrong]):
            mistake = Symmetry.POLARISES
    text = f"elements over the first are off by up to {size[wrong].max():.3g}"
    evidence.breach(question, mistake(one.function), one.by(size), wrong, found=text)

"""Reciprocity, and adjointness of the transport modes, of all elements."""

from __future__ import annotations

import numpy as np

from ...array_types import Flags, Floats
from ...collector.stokes import EXCHANGE
from ..evidence import Evidence
from ..mueller import Matrices, condition_of, is_depolarised, off, per_light
from ..samples import beyond_rounding

# Difference of elements over the first one that is no rounding, beside its slack.
ROUNDING = 2e-3


def check_reciprocity(
    evidence: Evidence, there: Matrices, back: Matrices, slack: Floats
) -> None:
    """Check ``M(wi, wo) = Q M(wo, wi)^T Q``, where Q changes the sign of U.

    Matrices are divided by their first elements, which the unpolarised variant judges.
    """
    m, reverse = per_light(there.in_plane()), per_light(back.in_plane())
    due = EXCHANGE @ np.swapaxes(reverse, -1, -2) @ EXCHANGE
    wrong, size = _wrong(there, back, off(m, due), slack)
    if beyond_rounding(wrong):
        mistake = (
            "is not reciprocal in its polarisation: M(wi, wo) is not Q M(wo, wi)^T Q"
        )
        _breach(evidence, "reciprocity", there, wrong, size, mistake)


def check_adjoint(
    evidence: Evidence, radiance: Matrices, back: Matrices, slack: Floats
) -> None:
    """Check that radiance mode answers from wo to wi as importance mode does."""
    m, due = per_light(radiance.in_plane()), per_light(back.in_plane())
    wrong, size = _wrong(radiance, back, off(m, due), slack)
    if not beyond_rounding(wrong):
        return
    mistake = "does not answer for light that goes from wo to wi"
    if is_depolarised(m[wrong]):
        mistake = "depolarises, other than in importance mode,"
    elif is_depolarised(due[wrong]):
        mistake = "polarises, other than in importance mode,"
    mistake = f"{mistake} in radiance mode (ctx.mode)"
    _breach(evidence, "adjoint", radiance, wrong, size, mistake)


def _wrong(
    one: Matrices, other: Matrices, size: Floats, slack: Floats
) -> tuple[Flags, Floats]:
    """Mask of pairs with light both ways that differ, and by how much they do."""
    both = one.lit & other.lit & one.finite & other.finite
    size = np.where(both, np.nan_to_num(size), 0.0)
    return size > ROUNDING + slack, size


def _breach(
    evidence: Evidence,
    name: str,
    matrices: Matrices,
    wrong: Flags,
    size: Floats,
    mistake: str,
) -> None:
    """Add a breach for pairs that are `wrong` by `size`, which names the worst."""
    worst = int(np.argmax(np.where(wrong, size, 0)))
    condition = condition_of(matrices, (worst,))
    evidence.breach(
        name,
        matrices.function,
        f"elements over the first are off by up to {size[worst]:.3g} at {condition}, "
        f"for {100 * wrong.mean():.3g} % of the directions{matrices.place(wrong)}",
        f"`{matrices.function}` {mistake}",
        condition,
        size=float(wrong.mean()),
        off=float(wrong.mean()),
    )

"""Integrals of a specimen's flux fractions, and what was sampled beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ..array_types import Floats
from .tally import Fate, Tally

__all__ = ["Integrals", "holds_integrals", "sent_text", "without_chance"]


def holds_integrals(tallies: Sequence[Tally]) -> bool:
    """Whether integrals stand for rays, but for those of delta components."""
    return any(isinstance(tally, Integrals) for tally in tallies)


def without_chance(tallies: Sequence[Tally]) -> bool:
    """Whether all values are integrals, beside which no ray was sent.

    Their standard errors are then the largest errors that they are estimated to have,
    and so are the limits of their intervals, at any level.
    """
    return holds_integrals(tallies) and not any(one.ledger.emitted for one in tallies)


def sent_text(tallies: Sequence[Tally]) -> str:
    """How many rays were sent, or what stands for them: ``10 000 rays``."""
    rays = f"{sum(tally.ledger.emitted for tally in tallies):,} rays".replace(",", " ")
    if not holds_integrals(tallies):
        return rays
    return "integrals" if rays == "0 rays" else f"integrals and {rays}"


@dataclass(frozen=True, eq=False, repr=False)
class Integrals(Tally):
    """Integrals in the unit of a tally: their part is the same in each of its batches.

    Rays are for delta components only. Where there are none, there is one batch
    without a ray, whose incident flux is `scale`: the unit that the integrals are in.

    Attributes
    ----------
    errors : ndarray of float64, shape (n_hemispheres, n_theta, n_phi, channels)
        What the integrals in the sums of each batch may be wrong by, in their unit.
    """

    arrays: ClassVar[tuple[str, ...]] = (*Tally.arrays, "errors")
    of_channels: ClassVar[tuple[str, ...]] = (*Tally.of_channels, "errors")
    joinable: ClassVar[bool] = False

    errors: Floats = field(kw_only=True)

    @classmethod
    def beside(cls, sampled: Tally, flux: Floats, errors: Floats) -> Integrals:
        """Integrals, with what was sampled of delta components.

        Parameters
        ----------
        sampled : Tally
            Without batches if nothing was.
        flux, errors : ndarray, shape (n_hemispheres, n_theta, n_phi, channels)
            Flux fractions, and what they may be wrong by.
        """
        if not sampled.n_batches:
            return cls(
                hits=sampled.hits,
                sums=flux[None] * sampled.scale,
                incident=np.full((1, sampled.channels), float(sampled.scale)),
                fates=np.zeros((1, len(Fate)), np.uint64),
                scale=sampled.scale,
                errors=errors * sampled.scale,
            )
        per_batch = sampled.incident[:, None, None, None, :]
        return cls(
            hits=sampled.hits,
            sums=sampled.sums + flux * per_batch,
            incident=sampled.incident,
            fates=sampled.fates,
            scale=sampled.scale,
            direct=sampled.direct,
            errors=errors * per_batch.max(axis=0),
        )

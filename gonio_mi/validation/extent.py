"""How much of what is drawn is not where it is due, in parts of all."""

from __future__ import annotations

import numpy as np

from ..array_types import Floats
from .maps import FourMaps, Scores

__all__ = ["misplaced", "surplus"]

# Standard errors that are left to chance.
CHANCE = 3.0


def misplaced(maps: FourMaps, name: str) -> float:
    """Part of all that is too much or too little, or in other patches than is due.

    What chance explains is taken off.

    Parameters
    ----------
    maps : FourMaps
    name : {"sampling", "weights"}
        Of the samples, against ``pdf``; or of the light, against ``eval``.
    """
    scores, drawn, due = _compared(maps, name)
    whole = max(drawn.sum(), due.sum())
    if not whole > 0:
        return 0.0
    total = abs(drawn.sum() - due.sum()) * _certain(np.array(scores.total))
    elsewhere = 0.0
    if scores.first.size:
        off = np.abs(np.add.reduceat(drawn - due, scores.first))
        elsewhere = float(np.sum(off * _certain(scores.z))) / 2
    return float(max(total, elsewhere) / whole)


def surplus(maps: FourMaps, name: str) -> float:
    """Relative surplus of what is drawn over what is due, times the cosine of wi."""
    _, drawn, due = _compared(maps, name)
    whole = max(drawn.sum(), due.sum())
    return float(abs(maps.condition.wi[2]) * (drawn - due).sum() / max(whole, 1e-30))


def _compared(maps: FourMaps, name: str) -> tuple[Scores, Floats, Floats]:
    """Scores, and what was drawn and is due by patch."""
    n = maps.totals.n
    if name == "sampling":
        return maps.count_scores, maps.totals.counts / n, maps.pdf
    return maps.weight_scores, maps.totals.sums / n, maps.weights


def _certain(z: Floats) -> Floats:
    """Part of a difference of this score that chance does not explain."""
    return np.maximum(1 - CHANCE / np.maximum(np.abs(np.nan_to_num(z)), CHANCE), 0)

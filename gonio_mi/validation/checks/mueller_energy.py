"""No more flux leaves than arrives, whatever the polarisation of the light."""

from __future__ import annotations

import numpy as np
from scipy import stats

from ...array_types import Numbers
from ..evidence import Evidence
from ..mueller import Lobes, condition_of

# Flux that rounding may add to all that arrives.
ROUNDING = 1e-4


def check_gain(evidence: Evidence, lobes: Lobes) -> None:
    """Mean flux of the incident polarisation that is scattered best.

    Lobes of shape (directions, samples). Half of the samples tell which polarisation
    that is, the other half how much of it leaves.
    """
    weights = lobes.weights
    rows = np.where(lobes.given[..., None, None], weights.in_plane()[..., 0, :], 0.0)
    half = rows.shape[1] // 2
    for i in range(len(rows)):
        gains = [
            _gain(rows[i, :half, c], rows[i, half:, c]) for c in range(rows.shape[2])
        ]
        mean, std_err, state = max(gains, key=lambda one: one[0])
        condition = condition_of(weights, (i, 0))
        z = (mean - 1 - ROUNDING) / max(std_err, ROUNDING / 4)
        text = f"{mean:.4g} of the flux of {_named(state)} leaves"
        evidence.test(
            "energy", float(stats.norm.sf(z)), text, condition, max(0.0, mean - 1)
        )


def _gain(first: Numbers, second: Numbers) -> tuple[float, float, Numbers]:
    """Mean, its standard error, and the polarisation, of rows of two halves."""
    state = first.mean(axis=0)[1:]
    length = np.linalg.norm(state)
    state = state / length if length > 0 else np.zeros(3)
    flux = second @ np.array([1.0, *state])
    return float(flux.mean()), float(flux.std() / np.sqrt(len(flux))), state


def _named(state: Numbers) -> str:
    """Polarisation in words."""
    if not state.any():
        return "unpolarised light"
    if abs(state[0]) > 0.99:
        return f"{'s' if state[0] > 0 else 'p'}-polarised light"
    if abs(state[2]) > 0.99:
        return f"{'right' if state[2] > 0 else 'left'} circularly polarised light"
    return f"light of (Q, U, V) = ({', '.join(f'{x:.2f}' for x in state)})"

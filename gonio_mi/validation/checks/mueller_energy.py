"""No more flux leaves than arrives, whatever the polarisation of the light."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
from scipy import special

from ...array_types import Flags, Floats, Numbers
from ..evidence import Evidence
from ..mistakes import EVAL, SAMPLE, Mistake
from ..mueller import Lobes
from .energy import ENERGY


class Energy(Mistake):
    """What is wrong with the flux that leaves."""

    GAINS = "{who} gains light: {found}"


# Flux that rounding may add to all that arrives.
ROUNDING = 1e-4

# Difference of shares up to which two samples are of one discrete lobe.
SAME_LOBE = 1e-3


def check_gain(evidence: Evidence, lobes: Lobes) -> None:
    """Test the mean flux of the incident polarisation that is scattered best.

    `lobes` has the shape (directions, samples). Half of the smooth samples tell which
    polarisation that is, the other half how much of it leaves. One sample is enough to
    know the share of a discrete lobe.
    """
    weights = lobes.weights
    smooth_too = int(evidence.bsdf.flags()) & int(mi.BSDFFlags.Smooth)
    function = EVAL if smooth_too else SAMPLE
    rows = weights.in_plane()[..., 0, :]
    smooth = np.where(lobes.smooth[..., None, None], rows, 0.0)
    half = rows.shape[1] // 2
    for i in range(len(rows)):
        discrete = _discrete(rows[i], lobes.pdf[i], lobes.delta[i])
        gains = [
            _gain(discrete[c], smooth[i, :half, c], smooth[i, half:, c])
            for c in range(rows.shape[2])
        ]
        mean, std_err, state = max(gains, key=lambda one: one[0])
        condition = weights.condition((i, 0))
        z = (mean - 1 - ROUNDING) / max(std_err, ROUNDING / 4)
        text = f"{mean:.4g} of the flux of {_named(state)} leaves"
        p_value = float(special.stdtr(half - 1, -z))
        how = {"off": max(0.0, mean - 1), "guess": Energy.GAINS(function, found=text)}
        evidence.test(ENERGY, p_value, text, condition, **how)


def _discrete(rows: Floats, pdf: Floats, delta: Flags) -> Floats:
    """First row of all discrete lobes together, each once, shape (channels, 4)."""
    total = np.zeros(rows.shape[1:])
    left = np.flatnonzero(delta)
    shares = rows * pdf[:, None, None]
    while left.size:
        first = shares[left[0]]
        total += first
        other = np.abs(shares[left] - first).max(axis=(1, 2)) > SAME_LOBE
        left = left[other]
    return total


def _gain(
    discrete: Floats, first: Floats, second: Floats
) -> tuple[float, float, Floats]:
    """Mean flux, its standard error, and the polarisation that is scattered best."""
    state = (discrete + first.mean(axis=0))[1:]
    length = np.linalg.norm(state)
    state = state / length if length > ROUNDING else np.zeros(3)
    arriving = np.array([1.0, *state])
    flux = second @ arriving
    mean = float(discrete @ arriving + flux.mean())
    return mean, float(flux.std() / np.sqrt(len(flux))), state


def _named(state: Numbers) -> str:
    """Polarisation in words."""
    if not state.any():
        return "unpolarised light"
    if abs(state[0]) > 0.99:
        return f"{'s' if state[0] > 0 else 'p'}-polarised light"
    if abs(state[2]) > 0.99:
        return f"{'right' if state[2] > 0 else 'left'} circularly polarised light"
    return f"light of (Q, U, V) = ({', '.join(f'{x:.2f}' for x in state)})"

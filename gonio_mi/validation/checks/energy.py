"""No more flux leaves than arrives."""

from typing import Any

import mitsuba as mi
import numpy as np
from scipy import special

from ...array_types import Flags, Floats, Numbers
from ...single_precision import BSDF_ROUNDING
from ..arrays import drawn, of_eval
from ..densities import total
from ..evidence import MODEL, Evidence, Question
from ..integrals import SUM_ERROR
from ..judgements import apart
from ..maps import FourMaps
from ..mistakes import EVAL, SAMPLE, Claim, Mistake
from ..mueller import Matrices
from ..samples import Samples


def best_polarisation(
    bsdf: Any, ctx: Any, si: Any, u: Any
) -> tuple[float, float, float]:
    """No more flux leaves than arrives, of what half of the samples scatter best."""
    _, weight = drawn(bsdf, ctx, si, u)
    rows = np.array(weight)[0].mean(axis=1) + 0 * np.array(u)[0]
    stokes = np.append(1, np.mean(rows[1:, ::2], axis=1))
    stokes[1:] /= np.linalg.norm(stokes[1:]) + 1e-30
    x = stokes @ rows[:, 1::2]
    return np.mean(x), 1, np.std(x) / len(x) ** 0.5


class Energy(Mistake):
    """Mistakes in the flux that leaves."""

    NOT_CONSERVED = "{who} is not energy conserving: {found}"
    NOT_1 = "{who} integrates to {flux}, where a phase function has 1"


ENERGY = Question(
    "energy",
    __doc__,
    MODEL,
    volumes="`eval` integrates to 1",
    shown=Claim(total, apart, (of_eval, 1)),
    matrices="no more flux leaves than arrives, of any polarisation",
)


@ENERGY.asks("maps")
def check_maps(evidence: Evidence, maps: FourMaps) -> None:
    """Test flux in importance mode, of all components together.

    The smooth part is integrated and the discrete part sampled; the mean of all sampled
    weights is tested as well.
    """
    if evidence.of_volumes:
        _check_normalised(evidence, maps)
        return
    if maps.condition.mode != "importance" or maps.condition.component is not None:
        return
    drawn = maps.totals
    std_err = np.sqrt(drawn.variance / drawn.n)
    flux = maps.smooth_flux + drawn.delta_mean
    worst = int(flux.argmax())
    # only its sampled part varies
    noise = np.sqrt(drawn.delta_variance[worst] / drawn.n)
    bound = max(maps.smooth_bound[worst] + maps.eval_rounding, SUM_ERROR)
    smooth = maps.smooth_flux[worst] > drawn.delta_mean[worst]
    whole = "`eval` integrates to" if smooth else "discrete lobes have the weight"
    mean, mean_err = drawn.mean.max(), std_err[drawn.mean.argmax()]
    for value, error, slack, what in (
        (flux[worst], noise, bound, whole),
        (mean, mean_err, BSDF_ROUNDING, "weights have the mean"),
    ):
        z = (value - 1 - slack) / max(error, 1e-7)
        text = f"{what} {value:.5g}"
        evidence.test(ENERGY, float(special.ndtr(-z)), text, maps.condition)


def _check_normalised(evidence: Evidence, maps: FourMaps) -> None:
    """Check that ``eval`` integrates to 1; absorption is the medium's."""
    flux = maps.smooth_flux
    off = np.abs(flux - 1)
    worst = int(off.argmax())
    bound = maps.smooth_bound[worst] + maps.eval_rounding
    if off[worst] > max(bound, SUM_ERROR):
        total, size = f"{flux[worst]:.5g}", float(off[worst])
        guess, text = Energy.NOT_1(EVAL, flux=total), f"`eval` integrates to {total}"
        evidence.breach(ENERGY, guess, maps.condition, found=text, size=size)


# ------------------------------------------------------------------ of any polarisation

# Flux that rounding may add to all that arrives.
ROUNDING = 1e-4

# Difference of shares up to which two samples are of one discrete lobe.
SAME_LOBE = 1e-3


def check_gain(evidence: Evidence, samples: Samples) -> None:
    """Test the mean flux of the incident polarisation that is scattered best.

    Half of the smooth samples tell which polarisation that is, the other half how much
    of it leaves. One sample is enough to know the share of a discrete lobe.
    """
    smooth_too = int(evidence.bsdf.flags()) & int(mi.BSDFFlags.Smooth)
    function = EVAL if smooth_too else SAMPLE
    weights = Matrices.of(samples, SAMPLE, samples.full("weight"))
    rows = weights.in_plane()[:, :, 0]
    smooth = np.where(samples.smooth[:, None, None], rows, 0.0)
    half = len(rows) // 2
    discrete = _discrete(rows, samples.sampled_pdf, samples.discrete)
    gains = [
        _gain(discrete[c], smooth[:half, c], smooth[half:, c])
        for c in range(rows.shape[1])
    ]
    mean, std_err, state = max(gains, key=lambda one: one[0])
    z = (mean - 1 - ROUNDING) / max(std_err, ROUNDING / 4)
    text = f"{mean:.4g} of the flux of {_named(state)} leaves"
    p_value = float(special.stdtr(half - 1, -z))
    guess, off = Energy.NOT_CONSERVED(function, found=text), max(0.0, mean - 1)
    how = {"off": off, "guess": guess, "shown": Claim(best_polarisation, apart)}
    evidence.test(ENERGY, p_value, text, samples.condition, **how)


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

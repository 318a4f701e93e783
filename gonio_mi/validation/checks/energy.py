"""Reflectance plus transmittance is at most 1."""

from __future__ import annotations

import numpy as np
from scipy import special

from ...single_precision import BSDF_ROUNDING
from ..evidence import MODEL, Evidence, Question
from ..integrals import SUM_ERROR
from ..maps import FourMaps
from ..mistakes import EVAL, SAMPLE, Guess, Mistake
from .components import Components


class Energy(Mistake):
    """What is wrong with the flux that leaves."""

    LOSES = "{who} loses light: {flux:.4g} of it leaves"
    GAINS = "{who} gains light: {flux:.4g} of it leaves"
    NOT_1 = "{who} integrates to {flux}, where a phase function has 1"


def _guess(evidence: Evidence) -> Guess:
    """Whether ``eval`` or the weights of discrete lobes gain or lose light."""
    discrete = [m.totals.delta_mean.max() for m in evidence.maps]
    totals = [m.smooth_flux.max() + x for m, x in zip(evidence.maps, discrete)]
    gains = max(discrete, default=0.0) > 1 + 1e-4
    of_lobes = [
        breach.guess
        for breach in evidence.of("components")
        if breach.guess.mistake is Components.OTHER_LOBE
    ]
    if of_lobes and any(discrete) and not gains:
        return of_lobes[0]
    function, most = SAMPLE if gains else EVAL, max(totals, default=1.0)
    if most < 1:  # a phase function, which absorbs nothing
        return Energy.LOSES(function, flux=min(totals))
    return Energy.GAINS(function, flux=most)


ENERGY = Question(
    "energy",
    "no more flux leaves than arrives",
    MODEL,
    of_volumes="`eval` integrates to 1",
    explain=_guess,
    of_matrices="no more flux leaves than arrives, of any polarisation",
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
    noise = std_err[worst] if drawn.delta_mean[worst] > 0 else 0.0
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

"""Reflectance plus transmittance is at most 1."""

from __future__ import annotations

import numpy as np
from scipy import special

from ...single_precision import BSDF_ROUNDING
from ..evidence import Evidence
from ..integrals import SUM_ERROR
from ..maps import FourMaps


def check_maps(evidence: Evidence, maps: FourMaps) -> None:
    """Test flux in importance mode, of all components together.

    The smooth part is integrated and the discrete part sampled; the mean of all sampled
    weights is tested as well.
    """
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
        evidence.test("energy", float(special.ndtr(-z)), text, maps.condition)

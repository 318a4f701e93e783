"""The estimator `quadrature`: what it needs of a setup, and what it finds."""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..errors import SpecimenError
from ..results.tally import WEIGHT_SCALE, Integrals, Tally
from ..settings.values import ALL_ORDERS
from ..transport.setup import Setup
from ..transport.wavelengths import wavelength_lanes
from .integrate import integrate_each


def check_integrable(setup: Setup) -> None:
    """Raise SpecimenError where the estimator `quadrature` does not apply."""
    plane, settings = setup.specimen.plane, setup.settings
    at_point = settings.footprint == "point"
    lanes = wavelength_lanes(setup.passes[0])
    needs = {
        "a single flat rectangle": plane is not None and not settings.trace,
        "a collimated beam": setup.beam.collimated
        and not (settings.divergence or settings.incident),
        "a collector in the far field": not setup.collector.radius,
        "a collector of rings and sectors": setup.collector.subdivision.axes is None,
        "the order all": settings.order == ALL_ORDERS,
        "the same BSDF all over the specimen": plane is None
        or at_point
        or plane.is_uniform(lanes),
    }
    for need, holds in needs.items():
        if not holds:
            remedy = "take weighted instead"
            if setup.collector.subdivision.axes is not None:
                remedy = "take next_event, traced (trace=True, or --trace)"
            raise SpecimenError(f"the estimator quadrature needs {need}: {remedy}")


def integrals(
    setups: Sequence[Setup], sampled: Sequence[Sequence[Tally]]
) -> list[Integrals]:
    """Integrals of all but the delta components, beside the tallies of those.

    Parameters
    ----------
    setups : sequence of Setup
        Of one specimen; they differ in their incident direction only and share kernels.
    sampled : sequence of sequence of Tally
        Of the delta components, at each setup; none without such components.
    """
    groups = [_pass_integrals(setups, nm) for nm in setups[0].passes]
    found = []
    for setup, tallies, parts in zip(setups, sampled, zip(*groups)):
        flux, errors = (np.concatenate(arrays, axis=-1) for arrays in zip(*parts))
        if tallies:
            beside = Tally.join(tallies).spread(flux.shape[-1])
        else:
            shape = setup.collector.subdivision.shape
            beside = Tally.empty(setup.shape[0], shape, flux.shape[-1], WEIGHT_SCALE)
        found.append(Integrals.beside(beside, flux, errors))
    return found


def _pass_integrals(
    setups: Sequence[Setup], nm: tuple[float, ...] | None
) -> list[tuple[Floats, Floats]]:
    """Flux fractions of some wavelengths, and their errors, at each setup.

    Arrays of shape ``(n_hemispheres, n_theta, n_phi, channels)``.
    """
    setup = setups[0]
    si = mi.SurfaceInteraction3f(setup.specimen.plane.interaction)
    si.wavelengths = wavelength_lanes(nm)
    found = integrate_each(
        setup.specimen.plane.bsdf,
        [(one.theta_i, one.phi_i) for one in setups],
        setup.collector.subdivision,
        rel_err=setup.settings.integral_err,
        side="front" if setup.beam.side > 0 else "back",
        interaction=si,
        n_hemispheres=setup.shape[0],
    )
    kept = ..., slice(0, nm and len(nm))
    return [(one.flux[kept], one.error[kept]) for one in found]

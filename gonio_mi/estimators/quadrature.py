"""The estimator `quadrature`: integrals of `eval`, and rays for delta components only.

Of a flat specimen, whose every point scatters alike.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..errors import SpecimenError
from ..results.tally import (
    WEIGHT_SCALE,
    DifferentiatedIntegrals,
    Integrals,
    Tally,
)
from ..settings.values import ALL_ORDERS
from ..specimen.wavelengths import wavelength_lanes
from ..transport.method import Method
from ..transport.setup import Setup
from ..variants import check_unpolarised


class Quadrature(Method):
    """Integrals of all but the delta components, beside tallies of these."""

    delta_only = True
    follows_exits = False
    resumes = False
    integrates = True
    together = 64  # what Ctrl-C may cost
    task = 16

    def check(self, setup: Setup) -> None:
        """Raise SpecimenError unless one plane integral is all there is."""
        plane, settings = setup.specimen.plane, setup.settings
        check_unpolarised("the estimator quadrature")
        needs = {
            "a single flat rectangle": plane is not None and not settings.trace,
            "a collimated beam": setup.beam.collimated
            and not (settings.divergence or settings.incident),
            "a collector in the far field": not setup.collector.radius,
            "round windows, none in another": setup.collector.subdivision.fills_cells,
            "the order all": settings.order == ALL_ORDERS,
            "the same BSDF all over the specimen": plane is None
            or settings.footprint == "point"
            or plane.is_uniform(wavelength_lanes(setup.passes[0])),
        }
        for need, met in needs.items():
            if not met:
                raise SpecimenError(
                    f"the estimator quadrature needs {need}: take weighted instead"
                )
        if setup.gradients is not None and self.samples(setup):
            raise SpecimenError(
                "gradients of delta components need the estimator weighted, got "
                "quadrature"
            )

    def functions(self, bsdf: mi.BSDF) -> set[str]:
        """Return `eval`, and `sample` where there are delta components."""
        return {"eval", "sample"} if _has_delta(bsdf) else {"eval"}

    def samples(self, setup: Setup) -> bool:
        """Whether there are delta components."""
        return _has_delta(setup.specimen.plane.bsdf)

    def begin(
        self,
        setups: Sequence[Setup],
        progress: bool,  # noqa: ARG002
    ) -> Sequence[tuple[Floats, ...]]:
        """Flux fractions of each setup, and their errors; they share kernels.

        Of gradients their derivatives as well.
        """
        groups = [_pass_integrals(setups, nm) for nm in setups[0].passes]
        joined = (zip(*parts) for parts in zip(*groups))
        return [tuple(np.concatenate(x, axis=-1) for x in arrays) for arrays in joined]

    def finish(
        self, setup: Setup, tallies: Sequence[Tally], known: tuple[Floats, ...]
    ) -> Integrals:
        """Integrals beside the tally of the delta components."""
        flux, errors, *changes = known
        if tallies:
            beside = Tally.join(tallies).spread(flux.shape[-1])
        else:
            shape = setup.collector.subdivision.shape
            beside = Tally.empty(setup.shape[0], shape, flux.shape[-1], WEIGHT_SCALE)
        found = Integrals.beside(beside, flux, errors)
        if not changes:
            return found
        arrays = {name: getattr(found, name) for name in found.arrays}
        arrays |= {"changes": changes[0][None], "scale": found.scale}
        return DifferentiatedIntegrals(**arrays)


def _has_delta(bsdf: mi.BSDF) -> bool:
    return bool(mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta))


def _pass_integrals(
    setups: Sequence[Setup], nm: tuple[float, ...] | None
) -> list[tuple[Floats, ...]]:
    """Flux fractions of some wavelengths, and their errors, at each setup.

    Arrays of shape ``(n_hemispheres, n_theta, n_phi, channels)``; derivatives with
    their errors have an axis more before the last.
    """
    from ..quadrature.integrate import integrate_each  # slow to import

    setup = setups[0]
    si = mi.SurfaceInteraction3f(setup.specimen.plane.interaction)
    si.wavelengths = wavelength_lanes(nm)
    found = integrate_each(
        setup.specimen.plane.bsdf,
        [(one.theta_i, one.phi_i) for one in setups],
        setup.collector.subdivision,
        integral_err=setup.settings.integral_err,
        side="front" if setup.beam.side > 0 else "back",
        interaction=si,
        n_hemispheres=setup.shape[0],
    )
    kept = ..., slice(0, nm and len(nm))
    arrays: list[tuple[Floats, ...]]
    arrays = [(one.flux[kept], one.error[kept]) for one in found]
    if setup.gradients is None:
        return arrays
    each: list[list[Floats]] = [[] for _ in found]
    bsdf = setup.specimen.plane.bsdf
    for column, derivative in setup.gradients.derivatives:
        with setup.gradients.attached(column.directions), dr.suspend_grad():
            for own, one in zip(each, found):
                own += one.slopes(bsdf, derivative)
    changes = (np.stack(own, axis=-2)[kept] for own in each)
    return [(*own, more) for own, more in zip(arrays, changes)]

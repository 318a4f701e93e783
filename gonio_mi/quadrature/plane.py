"""The estimator `quadrature`: what it needs of a bench, and what it finds."""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi

from ..array_types import Floats
from ..errors import SpecimenError
from ..settings.measurement_settings import MeasurementSettings
from ..settings.orders import ALL_ORDERS
from ..transport.bench import Bench

__all__ = ["check_integrable", "integrals"]


def check_integrable(
    bench: Bench, settings: MeasurementSettings, wavelengths: mi.Spectrum
) -> None:
    """Raise SpecimenError where the estimator `quadrature` does not apply."""
    plane = bench.specimen.plane
    at_point = settings.footprint == "point"
    needs = {
        "a single flat rectangle": plane is not None and not settings.trace,
        "a collimated beam": bench.beam.collimated
        and not (settings.divergence or settings.incident),
        "a collector in the far field": not bench.collector.radius,
        "a collector of rings and sectors": bench.collector.subdivision.axes is None,
        "the order all": settings.order == ALL_ORDERS,
        "the same BSDF all over the specimen": plane is None
        or at_point
        or plane.is_uniform(wavelengths),
    }
    for need, holds in needs.items():
        if not holds:
            remedy = "take weighted instead"
            if bench.collector.subdivision.axes is not None:
                remedy = "take next_event, traced (trace=True, or --trace)"
            raise SpecimenError(f"the estimator quadrature needs {need}: {remedy}")


def integrals(
    benches: Sequence[Bench],
    wavelengths: mi.Spectrum,
    rel_err: float,
    channels: int | None = None,
) -> list[tuple[Floats, Floats]]:
    """Flux fractions of all but delta components, and their errors, at each bench.

    Parameters
    ----------
    benches : sequence of Bench
        Of one specimen, and alike but for the incident direction.
    wavelengths : mi.Color0f or mi.Spectrum
        As the surface interaction wants them.
    rel_err : float
    channels : int, optional
        How many of them to keep.

    Returns
    -------
    list of (flux, error)
        Arrays of shape ``(n_hemispheres, n_theta, n_phi, channels)``.
    """
    from . import integrate_each  # which stands on these helpers

    bench = benches[0]
    si = mi.SurfaceInteraction3f(bench.specimen.plane.interaction)
    si.wavelengths = wavelengths
    found = integrate_each(
        bench.specimen.plane.bsdf,
        [(one.theta_i, one.phi_i) for one in benches],
        bench.collector.subdivision,
        rel_err=rel_err,
        side="front" if bench.beam.side > 0 else "back",
        interaction=si,
        n_hemispheres=bench.shape[0],
    )
    kept = ..., slice(0, channels)
    return [(one.flux[kept], one.error[kept]) for one in found]

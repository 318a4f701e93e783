"""The interface of an estimator: what is known before rays, and what each ray adds.

The room `estimators` has one module for each. Nothing else asks which one measures.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mitsuba as mi

from ..results.tally import Tally
from ..settings.measurement_settings import MeasurementSettings
from ..settings.values import Order

# Levels of rare powers for those from 2**-47 on, which one sample of a glossy BSDF
# in a million carries: a launch that met them without room would be repeated, and
# compiled anew.
USUAL_LEVELS = range(10, 15)


class Method:
    """An estimator; subclasses say what differs from whole rays that leave.

    Attributes
    ----------
    counted : bool
        Whether rays live or end, and are counted: all powers are whole numbers.
    deposits : bool
        Whether patches hold what events send there, instead of rays that arrived.
    delta_only : bool
        Whether rays are collected after delta components alone.
    follows_exits : bool
        Whether all light is collected where rays leave, with its order: they may walk
        through media, and orders share them.
    resumes : bool
        Whether more rays can continue a record.
    integrates : bool
        Whether incident directions are finished one after the other, as integrals.
    together : int or None
        Incident directions that :meth:`begin` takes at once; None for all.
    shares_points : bool
        Whether incident directions share random points, and with them their chance.
    task : int or None
        Incident directions of a campaign's task; None where their rays tell.
    differentiable : bool
        Whether light may be followed as it changes with parameters.
    levels : range
        Of rare powers, that sums have room for at first.
    """

    counted = False
    deposits = False
    delta_only = False
    follows_exits = True
    resumes = True
    integrates = False
    shares_points = False
    together: int | None = None
    task: int | None = None
    differentiable = True
    levels = USUAL_LEVELS

    # ------------------------------------------------------------------- before rays

    def check(self, setup: Any) -> None:
        """Raise SpecimenError where the estimator does not apply to a Setup."""

    def functions(self, bsdf: mi.BSDF) -> set[str]:  # noqa: ARG002
        """Names of the functions of a BSDF that are called: `sample`, `eval`."""
        return {"sample"}

    def samples(self, setup: Any) -> bool:  # noqa: ARG002
        """Whether rays are needed."""
        return True

    def begin(self, setups: Sequence[Any], progress: bool) -> Sequence[Any]:  # noqa: ARG002
        """Light of each setup that needs no rays; None where there is none."""
        return [None] * len(setups)

    def control(self, setup: Any, wavelengths: Any) -> Any:  # noqa: ARG002
        """Light that is known without rays, which take it off; None without any.

        Its `flux`, of shape ``(n_collected, channels)``, is added as flux fractions.
        """
        return None

    def controls(self, setup: Any) -> bool:  # noqa: ARG002
        """Whether there is such light."""
        return False

    # ---------------------------------------------------------------------- each ray

    def cost(self, setup: Any) -> float:  # noqa: ARG002
        """Approximate CPU time of a ray, relative to a ray without deposits."""
        return 1.0

    def order(self, settings: MeasurementSettings) -> Order:
        """Which rays are collected."""
        return settings.order

    def kept_apart(self, orders: Sequence[Order]) -> Sequence[Order]:
        """Orders whose rays have sums of their own, if `orders` are asked for."""
        return orders

    def add(self, rays: Any, sampler: mi.Sampler, ray: mi.UInt32) -> None:
        """Add to the sums what becomes of one ray per lane, number `ray` of a batch.

        `rays` are :class:`~.launch.LaunchedRays`.
        """
        rays.collect(rays.path()(sampler), ray < rays.size)

    # --------------------------------------------------------------------- after rays

    def tallies(self, totals: Any, n: int) -> list[Tally]:
        """Tally of each of `n` beams, whose batches take turns, of their Totals."""
        found: list[Tally] = totals.tallies(n)
        return found

    def finish(self, setup: Any, tallies: Sequence[Tally], known: Any) -> Tally:  # noqa: ARG002
        """Tally of a setup, of those of its rays and what `begin` knew, if anything."""
        return Tally.join(tallies)

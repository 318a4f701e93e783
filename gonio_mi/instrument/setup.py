"""Set up measurements from settings, a specimen and emitters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from ..collector.directions import direction
from ..errors import (
    FinerPatchesWarning,
    SettingTypeError,
    SpecimenError,
    shown,
    warn,
)
from ..estimators import METHODS
from ..estimators.auto import PILOT_INCIDENT, chosen
from ..results.tally import Tally
from ..settings import Estimator, MeasurementSettings, Order
from ..specimen.digest import emitter_digest
from ..specimen.loading import loaded
from ..specimen.specimen import Specimen
from ..specimen.wavelengths import check_covered, lanes_of
from ..transport.beam import Beam
from ..transport.collector_sphere import CollectorSphere
from ..transport.gradients import Gradients, Rules
from ..transport.layers import layers_of
from ..transport.sampling import check_sampler
from ..transport.setup import Setup
from ..variants import check_differentiates, check_unpolarised
from .incidence import collimated, described_digest, emitter_scene, towards
from .launcher import Launcher
from .schedule import Round


def set_up(
    specimen: Specimen,
    settings: MeasurementSettings,
    incidents: Sequence[tuple[float, float] | None] = (None,),
    emitter: dict[str, Any] | None = None,
    *,
    orders: Sequence[Order] = (),
) -> list[Setup]:
    """Set up a :class:`Setup` for each incident direction.

    Parameters
    ----------
    specimen : Specimen
    settings : MeasurementSettings
        With the period of the specimen.
    incidents : sequence of (float, float) or None
        In degrees; None for an emitter as it is.
    emitter : dict, optional
        In place of the scene's emitter, or of a collimated beam.
    orders : sequence of Order
        Collected separately.

    Returns
    -------
    list of Setup
        With these settings, and the estimator that was chosen for ``auto``.

    Raises
    ------
    TypeError, ValueError, SpecimenError, LookupError
        If the specimen, emitter, collector and sampler do not fit together; and
        whatever a BSDF of the specimen raises.
    """
    sampler = _loaded_sampler(settings)
    defects = _defects(specimen, settings)
    collector = _collector(specimen, settings)
    gradients = _gradients(specimen, settings)
    described = described_digest(emitter)
    choice = None

    def lit(
        settings: MeasurementSettings, incident: tuple[float, float] | None
    ) -> Setup:
        """Setup with a beam from a direction, or with the emitter as it is."""
        source, beam = None, _collimated_beam(specimen, settings, emitter, incident)
        if beam is None:
            source = emitter_scene(specimen.source, emitter, incident, settings.side)
            beam = _beam(specimen, settings, source.emitters())
        method = METHODS[settings.estimator]
        # integrals have an error of their own
        goal = replace(settings, noise=None) if method.integrates else settings
        told = None if beam.collimated else described or emitter_digest([beam.emitter])
        return Setup(
            goal,
            method,
            specimen,
            beam,
            collector,
            sampler,
            incident,
            emitter_digest=told,
            source=source,
            orders=tuple(orders),
            defects=defects,
            choice=choice,
            layers=layers_of(specimen, beam.side),
            gradients=gradients,
        )

    def tried(settings: MeasurementSettings) -> Setup:
        setup = lit(settings, PILOT_INCIDENT if incidents[0] else None)
        setup.method.check(setup)
        return setup

    if settings.estimator is Estimator.AUTO:
        settings, choice = chosen(settings, specimen, orders, tried, _short_run)
    first = lit(settings, incidents[0])
    if choice is None:
        first.method.check(first)  # they differ in their incident direction only
    angles = [incident for incident in incidents if incident is not None]
    if emitter is not None or not angles:
        return [first, *(lit(settings, incident) for incident in incidents[1:])]
    beams = (first.beam.turned(towards(one, settings.side)) for one in angles[1:])
    return [first, *map(first.turned, beams, angles[1:])]


def _collector(specimen: Specimen, settings: MeasurementSettings) -> CollectorSphere:
    """Collector of the settings; SpecimenError if the specimen does not fit inside."""
    radius = settings.collector_radius
    if 0 < radius <= specimen.radius:
        raise SpecimenError(
            "collector.radius must enclose the specimen, which reaches "
            f"{specimen.radius:.7g} from the origin, got {radius}"
        )
    return CollectorSphere(settings.collector, settings.hemispheres, radius)


def _short_run(setup: Setup, each: int) -> Tally:
    """Tally of a short run with `each` rays per batch."""
    part = Round((each,) * setup.settings.batches)
    return Tally.join([tally for (tally,) in Launcher([setup]).tallies([setup], part)])


# Median ratio of the material's patches to the collector's that is no warning.
MAX_LARGER = 2.0


def _warn_of_finer_patches(specimen: Specimen, settings: MeasurementSettings) -> None:
    """Warn if most patches are finer than those in which the material was measured.

    Not for single receptors, whose error a quantity bounds.
    """
    measured = specimen.measured_patches[int(settings.side == "back")]
    if measured is None or settings.collector.axes is not None:
        return
    own, (theta, phi) = settings.collector, settings.collector.middles
    number = measured.patch(direction(theta, phi).reshape(-1, 3))
    larger = measured.solid_angles.ravel()[number] / own.solid_angles.ravel()
    if np.median(larger) > MAX_LARGER:
        warn(
            f"the patches of the collector, {own!s:.40}, are finer than those in which "
            f"the material was measured, {measured!s:.40}: how light is spread within "
            "these is not known",
            FinerPatchesWarning,
        )


def _gradients(specimen: Specimen, settings: MeasurementSettings) -> Gradients | None:
    """Parameters by which light is differentiated, once that is known to be right."""
    if not settings.gradients:
        return None
    check_differentiable(specimen, settings)
    gradients = Gradients.of_names(specimen.source, settings.gradients)
    try_gradients(gradients, specimen, settings)
    return gradients


def check_differentiable(specimen: Specimen, settings: MeasurementSettings) -> None:
    """Raise VariantError or SpecimenError where no gradient can be measured."""
    check_unpolarised("a measurement with gradients")
    check_differentiates("a measurement with gradients")
    if specimen.media:
        raise SpecimenError("gradients need a specimen without media, got one")
    if not METHODS[settings.estimator].differentiable:
        raise SpecimenError(
            "gradients need the estimator weighted, next_event or quadrature, got "
            f"{settings.estimator}"
        )


def try_gradients(
    gradients: Gradients,
    specimen: Specimen,
    settings: MeasurementSettings,
    known: Rules | None = None,
) -> None:
    """Compare gradients with differences, as :meth:`.Gradients.check` does."""
    lanes = lanes_of(settings.wavelengths)[0]
    bsdfs = [surface.bsdf() for surface in specimen.surfaces]
    gradients.check(bsdfs, lanes, known)


def _defects(specimen: Specimen, settings: MeasurementSettings) -> tuple[str, ...]:
    """Try the specimen, and check the estimator; return its defects."""
    method = METHODS[settings.estimator]
    defects = specimen.tried(settings.wavelengths, method.functions)
    if specimen.media and not method.follows_exits:
        raise SpecimenError(
            "a specimen with a medium must be measured by the estimator weighted or "
            f"analog, got {settings.estimator}"
        )
    _warn_of_finer_patches(specimen, settings)
    return defects


def _collimated_beam(
    specimen: Specimen,
    settings: MeasurementSettings,
    emitter: object,
    incident: tuple[float, float] | None,
) -> Beam | None:
    """Collimated beam from a direction; None if an emitter is used instead."""
    if emitter is not None or incident is None:
        return None
    vector = towards(incident, settings.side)
    return _beam(specimen, settings, [collimated(vector)]).turned(vector)


def _beam(
    specimen: Specimen, settings: MeasurementSettings, emitters: Sequence[mi.Emitter]
) -> Beam:
    """Beam of the scene's only emitter, whose spectra cover the wavelengths."""
    if any(emitter.get_medium() is not None for emitter in emitters):
        raise SpecimenError("the emitter must stand in air, got one inside of a medium")
    if len(emitters) != 1:
        raise SpecimenError(
            "the scene must have one emitter, or an incident angle be given, such as "
            f"theta_i=45 or --theta-i 45, got {len(emitters)} emitters"
        )
    (emitter,), emission = emitters, settings.emission
    collimated = mi.has_flag(emitter.flags(), mi.EmitterFlags.DeltaDirection)
    by_shape = emission == "equal_power" and emitter.get_shape() is not None
    # of the other two, no power is asked for
    if mi.is_spectral and not collimated and not by_shape:
        check_covered([emitter], settings.wavelengths)
    nm = settings.wavelengths if mi.is_spectral else None
    spot, spread, incident = settings.footprint, settings.divergence, settings.incident
    return Beam(specimen, emitter, spot, emission, nm, spread, incident)


def _loaded_sampler(settings: MeasurementSettings) -> mi.Sampler:
    """Sampler of the settings; raise for one that would bias the results."""
    sampler = settings.sampler or {"type": "sobol"}
    if isinstance(sampler, dict):
        sampler = loaded("the sampler", mi.load_dict, sampler)
    if not isinstance(sampler, mi.Sampler):
        is_object = isinstance(sampler, mi.Object)
        kind = sampler.class_name() if is_object else shown(sampler)
        raise SettingTypeError(f"sampler must be a Mitsuba sampler, got {kind}")
    check_sampler("sampler", sampler)
    return sampler

"""Settings that a scene file brings along, as its plugins' properties."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from ..errors import SettingTypeError, shown
from ..settings import COLLECTOR, FILM, INTEGRATOR, MeasurementSettings
from ..transport.sampling import check_sampler
from .loading import loaded

__all__ = ["own_settings", "sampler_of"]


def own_settings(scene: mi.Scene, sensor: mi.Sensor | None = None) -> dict[str, Any]:
    """Settings of a scene's integrator `goniophotometer` and sensor `collector`.

    Of the first such sensor, unless `sensor` is given; empty without either.
    """
    own: dict[str, Any] = {}
    settings = getattr(scene.integrator(), "settings", None)
    if isinstance(settings, MeasurementSettings):
        own |= settings.of_plugin(INTEGRATOR)
    sensors = scene.sensors() if sensor is None else [sensor]
    for sensor in sensors:
        if isinstance(getattr(sensor, "settings", None), MeasurementSettings):
            own |= sensor.settings.of_plugin(COLLECTOR)
            own |= sensor.film().settings.of_plugin(FILM)
            own["sampler"] = sensor.sampler()
            break
    return own


def sampler_of(settings: MeasurementSettings) -> mi.Sampler:
    """Sampler of the settings; one that would measure wrongly is refused."""
    return loaded("the sampler", _sampler, settings.sampler or {"type": "sobol"})


def _kind(thing: object) -> str:
    """What a thing is, in a word."""
    return str(thing.class_name() if isinstance(thing, mi.Object) else shown(thing))


def _sampler(given: object) -> mi.Sampler:
    sampler = mi.load_dict(given) if isinstance(given, dict) else given
    if not isinstance(sampler, mi.Sampler):
        raise SettingTypeError(
            f"sampler must be a Mitsuba sampler, got {_kind(sampler)}"
        )
    check_sampler("sampler", sampler)
    return sampler

"""Objects of a scene: their classes, parameters and parts, and plugins in Python."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from typing import Any

import mitsuba as mi

from ..settings import COLLECTOR, FILM, INTEGRATOR, MeasurementSettings

# Packages whose versions a record names.
VERSIONED = ("builtins", "drjit", "gonio_mi", "mitsuba", "nanobind")


def class_of(plugin: Any) -> str:
    """Class of a plugin; one in Python has the class name of its base."""
    name = plugin.class_name()
    own = ("BSDF", "Texture", "Medium", "PhaseFunction")
    return type(plugin).__name__ if name in own else name


def traversed(thing: Any) -> Any:
    """What ``mi.traverse`` answers, without what plugins say whose ``traverse`` raises.

    Mitsuba renders such a plugin, for it does not ask: many were written for a version
    in which the callback had other methods. It is as one without ``traverse`` then.

    Parameters
    ----------
    thing : mi.Object

    Returns
    -------
    mi.SceneParameters
    """
    try:
        return mi.traverse(thing)
    except Exception as error:
        # a plugin may raise anything
        kind = _culprit(error)
        if kind is None:
            raise
    own = kind.traverse
    kind.traverse = lambda *_: None
    try:
        return traversed(thing)  # there may be others
    finally:
        kind.traverse = own


def _culprit(error: BaseException) -> Any:
    """The class whose ``traverse`` raised; None if there is none, or one of ours."""
    found = None
    for frame, _ in traceback.walk_tb(error.__traceback__):
        owner = frame.f_locals.get("self")
        if frame.f_code.co_name == "traverse" and isinstance(owner, mi.Object):
            found = type(owner)
    if found is not None and found.__module__.startswith(__package__.split(".")[0]):
        return None
    bases = [] if found is None else found.__mro__
    return next((base for base in bases if "traverse" in vars(base)), None)


def held_objects(thing: mi.Object) -> Iterator[mi.Object]:
    """Yield an object of a scene and all that it holds, as far as it says so."""
    todo: list[mi.Object | None] = [thing]
    seen: set[int] = set()
    while todo:
        held = todo.pop()
        if held is None or id(held) in seen:
            continue
        seen.add(id(held))
        yield held
        todo += traversed(held).hierarchy
        if isinstance(held, mi.Shape):
            todo.append(held.bsdf())
        own = vars(held).values() if hasattr(held, "__dict__") else ()
        todo += (value for value in own if isinstance(value, mi.Object))


def foreign_plugins(thing: mi.Object) -> list[mi.Object]:
    """Plugins in Python of others that an object of a scene is, or holds."""
    return [held for held in held_objects(thing) if is_foreign(type(held))]


def holds_foreign_plugins(thing: mi.Object) -> bool:
    """Whether there is one of :func:`foreign_plugins`.

    What only has the methods of a BSDF, as a verdict's integrand, holds none.
    """
    return isinstance(thing, mi.Object) and bool(foreign_plugins(thing))


def is_foreign(kind: type) -> bool:
    """Whether a class is of no package whose version a record names."""
    return kind.__module__.split(".")[0] not in VERSIONED


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

"""Where light comes from: incident directions, and the emitter for each of them."""

from typing import Any

import mitsuba as mi
import numpy as np

from ..collector.directions import direction
from ..errors import (
    SettingError,
    SettingTypeError,
    SpecimenError,
    checked_number,
    shown,
)
from ..transport.digest import emitter_digest
from .loading import loaded

__all__ = ["emitter_scene", "incident_angles", "incident_key", "described_digest"]


def incident_angles(
    theta_i: Any, phi_i: Any, patches: Any = None
) -> tuple[list[Any], bool]:
    """List of ``(theta_i, phi_i)`` in degrees, or ``[None]``; whether it is a stack.

    Without `theta_i` they are the middles of `patches`, a Subdivision, if there are.
    """
    if theta_i is None and patches is not None:
        if np.any(phi_i):
            raise SettingError(f"phi_i goes with theta_i, got {shown(phi_i)} without")
        middles = np.degrees([angle.ravel() for angle in patches.middles])
        return [(theta, phi % 360.0) for theta, phi in middles.T.tolist()], True
    if theta_i is None:
        if np.any(phi_i):
            raise SettingError(
                "phi_i goes with theta_i: without it the scene's emitter decides where "
                f"light comes from, got phi_i {shown(phi_i)}"
            )
        return [None], False
    stacked = np.ndim(theta_i) > 0 or np.ndim(phi_i) > 0
    polar = [_theta(value) for value in _sequence("theta_i", theta_i)]
    azimuths = [
        checked_number("phi_i", value, -np.inf, np.inf, "a finite angle in degrees")
        for value in _sequence("phi_i", phi_i)
    ]
    return [(theta, phi % 360.0) for theta in polar for phi in azimuths], stacked


def incident_key(incident: tuple[float, float] | None) -> tuple[int, ...]:
    """Whole numbers that tell a direction from others; they seed its random numbers.

    A direction has the same bits alone and in any stack.
    """
    if incident is None:
        return (0,)
    # no minus zero
    return tuple((np.array(incident, dtype=float) + 0.0).view(np.uint64).tolist())


def _sequence(name: str, value: Any) -> list[Any]:
    values = [value] if np.ndim(value) == 0 else list(value)
    if not values:
        raise SettingError(f"{name} must hold at least one angle, got {shown(value)}")
    return values


def _theta(value: Any) -> float | None:
    return checked_number("theta_i", value, 0, 90, "an angle in degrees in [0, 90)")


def emitter_scene(
    scene: Any,
    emitter: dict[str, Any] | None,
    incident: tuple[float, float] | None,
    side: str,
) -> Any:
    """Scene that holds the one emitter to use."""
    if emitter is None and incident is None:
        if not scene.emitters():
            raise SpecimenError(
                "the specimen has no emitter, so an incident angle must be given, "
                "such as theta_i=45 or --theta-i 45"
            )
        return scene
    if emitter is None:
        emitter = {"type": "directional", "direction": _beam_direction(incident, side)}
    elif not isinstance(emitter, dict):
        raise SettingTypeError(f"emitter must be a dictionary, got {shown(emitter)}")
    elif incident is not None:
        emitter = _turned(emitter, incident, side)
    return loaded("the emitter", mi.load_dict, {"type": "scene", "emitter": emitter})


def described_digest(emitter: dict[str, Any] | None) -> str | None:
    """Digest of an emitter given as a dictionary, as it is described; None for None."""
    if emitter is None:
        return None
    scene = emitter_scene(None, emitter, None, "front")  # which its emitters need
    return emitter_digest(scene.emitters())


def _beam_direction(incident: Any, side: str) -> list[float]:
    """Direction of flight of a collimated beam."""
    theta, phi = np.radians(incident)
    x, y, z = direction(theta, phi)
    return [-x, -y, -z if side == "front" else z]


def _turned(
    emitter: dict[str, Any], incident: tuple[float, float], side: str
) -> dict[str, Any]:
    """Return `emitter`, described on +z, turned to the incident direction."""
    theta, phi = incident
    transform = mi.ScalarTransform4f
    turn = (
        transform()
        .rotate([0, 0, 1], phi)
        .rotate([0, 1, 0], theta if side == "front" else 180 - theta)
    )
    return emitter | {"to_world": turn @ emitter.get("to_world", transform())}

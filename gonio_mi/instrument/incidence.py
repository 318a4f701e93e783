"""Incident directions, and the emitter for each of them."""

import math
from collections.abc import Sequence
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Floats
from ..collector import Subdivision
from ..collector.directions import direction
from ..errors import SettingError, SettingTypeError, checked_number, shown, warn
from ..settings.values import checked_incident
from ..specimen.digest import emitter_digest
from ..specimen.loading import loaded

# Degrees that are asked for, and decimals from which they are known again in radians:
# of the angles below 90 degrees in radians that have three, one in 87 is any of these.
USUAL_ANGLES = (*range(5, 90, 5), 22.5, 67.5)
MIN_DECIMALS = 3


def incident_angles(
    theta_i: ArrayLike | None, phi_i: ArrayLike, incident: Subdivision | None = None
) -> tuple[list[Any], bool]:
    """List of ``(theta_i, phi_i)`` in degrees, or ``[None]``; whether it is a stack.

    Without `theta_i` they are the middles of the patches of the setting `incident`, if
    there are any.
    """
    patches = checked_incident("incident", incident)
    if theta_i is None:
        if np.any(phi_i):
            own = ", for the scene's own emitter has a direction"
            raise SettingError(
                f"phi_i requires theta_i{own if patches is None else ''}, "
                f"got phi_i {shown(phi_i)} alone"
            )
        if patches is None:
            return [None], False
        middles = np.degrees([angle.ravel() for angle in patches.middles])
        return [(theta, phi % 360.0) for theta, phi in middles.T.tolist()], True
    stacked = np.ndim(theta_i) > 0 or np.ndim(phi_i) > 0
    polar = _angles("theta_i", theta_i, 0, 90, "an angle in degrees in [0, 90)")
    _warn_of_radians(polar)
    azimuths = _angles("phi_i", phi_i, -np.inf, np.inf, "a finite angle in degrees")
    return [(theta, phi % 360.0) for theta in polar for phi in azimuths], stacked


def _angles(
    name: str, value: Any, low: float, high: float, condition: str
) -> list[float]:
    """One or several angles as a list, each in ``[low, high)``."""
    values = [value] if np.ndim(value) == 0 else list(value)
    if not values:
        raise SettingError(f"{name} must hold at least one angle, got {shown(value)}")
    return [checked_number(name, one, low, high, condition) for one in values]


def _warn_of_radians(polar: Sequence[float]) -> None:
    """Warn if all angles but zeros are usual ones in radians, as far as they are said.

    So many decimals of so small an angle are rare in degrees.
    """
    oblique = [value for value in polar if value]
    if oblique and all(_degrees_meant(value) for value in oblique):
        warn(
            f"theta_i is in degrees, but {oblique[-1]:.6g} looks like "
            f"{_degrees_meant(oblique[-1]):g} degrees in radians"
        )


def _degrees_meant(value: float) -> float | None:
    """Usual angle that has these radians, to the decimals given; None without one."""
    decimals = min(len(repr(value).partition(".")[2]), 12)
    for usual in USUAL_ANGLES if decimals >= MIN_DECIMALS else ():
        if abs(round(math.radians(usual), decimals) - value) < 1e-11:
            return usual
    return None


def emitter_scene(
    scene: Any,
    emitter: dict[str, Any] | None,
    incident: tuple[float, float] | None,
    side: str,
) -> Any:
    """Scene that holds the one emitter to use, but for :func:`collimated`."""
    if emitter is None:
        return scene
    if not isinstance(emitter, dict):
        raise SettingTypeError(f"emitter must be a dictionary, got {shown(emitter)}")
    if incident is not None:  # it is described on +z
        theta = incident[0] if side == "front" else 180 - incident[0]
        turn = mi.ScalarTransform4f().rotate([0, 0, 1], incident[1])
        own = emitter.get("to_world", mi.ScalarTransform4f())
        emitter = emitter | {"to_world": turn.rotate([0, 1, 0], theta) @ own}
    return loaded("the emitter", mi.load_dict, {"type": "scene", "emitter": emitter})


def described_digest(emitter: dict[str, Any] | None) -> str | None:
    """Digest of an emitter given as a dictionary, as it is described; None for None."""
    if emitter is None:
        return None
    scene = emitter_scene(None, emitter, None, "front")  # which its emitters need
    return emitter_digest(scene.emitters())


def towards(incident: tuple[float, float], side: str) -> Floats:
    """Unit vector to the emitter of a collimated beam on the front or back."""
    x, y, z = direction(*np.radians(incident))
    return np.array([x, y, z if side == "front" else -z])


def collimated(vector: Floats) -> Any:
    """Emitter of a collimated beam, towards which a vector points; without a scene."""
    return mi.load_dict({"type": "directional", "direction": (-vector).tolist()})

"""Settings of a table of measured values in lines ``key: value``."""

import math
from collections.abc import Sequence
from typing import Any

from ..errors import (
    FileFormatError,
    SettingError,
    checked_choice,
    checked_number,
    did_you_mean,
)
from ..errors import shown as shown_value
from .measured_table import NUMBERS, QUANTITIES, TEXTS, UNITS
from .numbers import is_decimal

__all__ = ["parsed_keys"]


def parsed_keys(
    place: str, comments: Sequence[tuple[int, str]]
) -> tuple[dict[str, Any], dict[str, str]]:
    """Settings of a `MeasuredTable`, and other keys as text.

    Parameters
    ----------
    place : str
        The file, for messages.
    comments : sequence of (int, str)
        Line numbers, and lines without their mark.

    Raises
    ------
    FileFormatError
        If a key is out of its range, there twice, or looks misspelt.
    """
    settings: dict[str, Any] = {}
    header: dict[str, str] = {}
    for number, comment in comments:
        _read_key(f"{place}, line {number}", comment, settings, header)
    solid_angle = settings.pop("aperture_solid_angle", None)
    if solid_angle is not None:
        if "aperture_half_angle" in settings:
            raise FileFormatError(
                f"{place} must have either aperture_half_angle or aperture_solid_angle"
            )
        # solid angle of a cone: 4 pi sin^2(a / 2)
        half = 2 * math.asin(math.sqrt(solid_angle / (4 * math.pi)))
        settings["aperture_half_angle"] = math.degrees(half)
    if settings.pop("units", None) == "1":
        settings.setdefault("quantity", "reflectance_factor")
    return settings, header


def _read_key(
    place: str, comment: str, settings: dict[str, Any], header: dict[str, str]
) -> None:
    """Take ``key: value`` from a comment line into `settings` or `header`."""
    key, colon, text = (part.strip() for part in comment.partition(":"))
    if not colon:
        return
    known = (*NUMBERS, *TEXTS)
    name = key.lower().replace(" ", "_")
    if name in settings:
        raise FileFormatError(f"{place}: the key {key} must occur once, got it again")
    if name not in known:
        meant = did_you_mean(name, known)
        if meant:
            raise FileFormatError(f"{place}: unknown key {shown_value(key)}{meant}")
        header[key] = text
        return
    try:
        if name in NUMBERS:
            if not is_decimal(text):
                condition = NUMBERS[name][2]
                raise SettingError(
                    f"{name} must be {condition}, got {shown_value(text)}"
                )
            settings[name] = checked_number(name, text, *NUMBERS[name])
            return
        if name != "channel":
            choices = (*UNITS, "1") if name == "units" else QUANTITIES
            checked_choice(name, text, choices)
    except ValueError as error:
        raise FileFormatError(f"{place}: {error}") from None
    settings[name] = text

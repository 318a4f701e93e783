"""Values of settings that are neither plain numbers nor words, and their checks."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..collector import Subdivision, subdivision
from ..errors import (
    SettingError,
    SettingTypeError,
    checked_choice,
    checked_count,
    checked_number,
    shown,
)

# More events than any `max_depth` admits.
UNLIMITED = 2**31


@dataclass(frozen=True, slots=True)
class Order:
    """Numbers of surface events from `least` to `most`, both included."""

    least: int = 0
    most: int = UNLIMITED

    @classmethod
    def parse(cls, label: str, value: object) -> Order:
        """Orders of ``"all"``, ``2`` or ``"3+"``; ValueError for anything else."""
        if isinstance(value, cls):
            return value
        text = str(value)
        if text == "all":
            return ALL_ORDERS
        if not re.fullmatch(r"0|[1-9]\d{0,8}\+?", text):
            raise SettingError(
                f"{label} must be 'all', a number of surface events such as 2 (0 "
                f"for direct light), or '3+' for three or more, got {shown(value)}"
            )
        least = int(text.rstrip("+"))
        return cls(least, UNLIMITED if text.endswith("+") else least)

    def __str__(self) -> str:
        if self == ALL_ORDERS:
            return "all"
        return f"{self.least}+" if self.most == UNLIMITED else str(self.least)


ALL_ORDERS = Order()


# No period, the bounding box, or extents in x and y.
Period = str | tuple[float, float]

# Wavelengths in nm that no emitter or material of Mitsuba's goes beyond.
WORST_WAVELENGTHS = 100.0, 10000.0


def count(minimum: int = 1, maximum: int | None = None, reason: str = "") -> Any:
    """Check of a whole number from `minimum`, which has a `reason`, to `maximum`."""
    return lambda label, value: checked_count(label, value, minimum, maximum, reason)


def number(low: float, high: float, condition: str) -> Any:
    """Check of a number in ``[low, high)``, which `condition` says in words."""
    return lambda label, value: checked_number(label, value, low, high, condition)


def choice(*choices: str) -> Any:
    """Check of one word of `choices`."""
    return lambda label, value: checked_choice(label, value, choices)


def joined(value: Any) -> Any:
    """Comma-separated numbers; a word or number unchanged."""
    return value if np.ndim(value) == 0 else ",".join(map(repr, map(float, value)))


def checked_flag(label: str, value: object) -> bool:
    """Return `value`, which must be a bool; text is refused, ``"false"`` too."""
    if not isinstance(value, (bool, np.bool_)):
        raise SettingTypeError(
            f"{label} must be a boolean, true or false, got {shown(value)}"
        )
    return bool(value)


def checked_names(label: str, value: object) -> tuple[str, ...]:
    """Names, from a sequence of them or a text with commas; each once."""
    words: Any = value.split(",") if isinstance(value, str) else value
    try:
        names = tuple(dict.fromkeys(one.strip() for one in words))
    except (TypeError, AttributeError):
        names = ("",)
    if not all(names):
        raise SettingError(f"{label} must be names, got {shown(value)}")
    return names


def checked_footprint(label: str, value: object) -> str | float:
    """Return ``"point"``, ``"full"`` or the radius of a disk as a float."""
    if isinstance(value, str) and value in ("point", "full"):
        return value
    condition = "'point', 'full' or a positive radius"
    radius = checked_number(label, value, 0, math.inf, condition)
    if radius == 0:
        raise SettingError(f"{label} must be {condition}, got {shown(value)}")
    return radius


def checked_incident(label: str, value: object) -> Subdivision | None:
    """Patches of incidence from their name; None for ``"none"``."""
    if value is None or value == "none":
        return None
    try:
        patches = subdivision(value)  # type: ignore[arg-type]
    except (SettingError, SettingTypeError) as error:
        raise type(error)(str(error).replace("collector", label, 1)) from None
    if patches.axes is not None:
        raise SettingError(
            f"{label} must be patches about one pole, such as klems, got "
            f"{shown(str(patches))}"
        )
    return patches


def checked_period(label: str, value: object) -> Period:
    """Return ``"none"``, ``"box"``, or extents in x and y.

    `value` is one of these, a text such as ``"2,3"``, or one number for both extents.
    """
    if isinstance(value, str) and value in ("none", "box"):
        return value
    try:
        if isinstance(value, bool):
            raise TypeError
        words: Any = value.split(",") if isinstance(value, str) else value
        x, y = np.broadcast_to(np.asarray(words, dtype=float), 2).tolist()
    except (TypeError, ValueError):
        x = y = math.nan
    if not (0 < x < math.inf and 0 < y < math.inf):
        raise SettingError(
            f"{label} must be 'none', 'box', or one or two positive numbers, "
            f"got {shown(value)}"
        )
    return x, y


def checked_wavelengths(label: str, value: object) -> tuple[float, ...]:
    """Wavelengths in nm, from one number, several, or a text with commas."""
    low, high = WORST_WAVELENGTHS
    words: Sequence[Any]
    if isinstance(value, str):
        words = value.split(",")
    else:
        words = np.atleast_1d(np.asarray(value, dtype=object)).tolist()
    try:
        nm = tuple(float(word) for word in words)
    except (TypeError, ValueError):
        nm = ()
    if not nm or not all(low <= x <= high for x in nm):
        raise SettingError(
            f"{label} must be numbers of nm from {low:g} to {high:g}, "
            f"got {shown(value)}"
        )
    return nm

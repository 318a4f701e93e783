"""Reading plugin properties, with errors that name plugin, parameter and value.

Only the text of an exception survives Mitsuba's plugin loader, so it says it all.
"""

from __future__ import annotations

from collections.abc import Iterable

import mitsuba as mi

from gonio_mi.errors import checked_choice, checked_count, checked_number


def choice(
    props: mi.Properties, name: str, default: str, choices: Iterable[str]
) -> str:
    """Return the string property `name`, one of `choices`."""
    return checked_choice(_label(props, name), props.get(name, default), choices)


def count(
    props: mi.Properties,
    name: str,
    default: int,
    minimum: int = 1,
    maximum: int | None = None,
) -> int:
    """Return the whole-number property `name`."""
    return checked_count(
        _label(props, name), props.get(name, default), minimum, maximum
    )


def number(
    props: mi.Properties,
    name: str,
    default: float,
    low: float,
    high: float,
    condition: str,
) -> float:
    """Return the number property `name`, in ``[low, high)``."""
    value = props.get(name, default)
    return checked_number(_label(props, name), value, low, high, condition)


def _label(props: mi.Properties, name: str) -> str:
    return f"{props.plugin_name()}.{name}"

"""Reading plugin properties, with errors that name plugin, parameter and value.

Only the text of an exception survives Mitsuba's plugin loader, so it says it all.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi


def given(props: mi.Properties, name: str, default: Any) -> tuple[str, Any]:
    """Name of a property in messages, and its value: for the checks of `errors`."""
    return f"{props.plugin_name()}.{name}", props.get(name, default)

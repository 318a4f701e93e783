"""Which processors the rays of a record were sent by, each told by a short text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["joined_processors", "processors"]

# Of records that were made before processors were told.
UNKNOWN = "unknown"


def processors(settings: Mapping[str, Any]) -> list[str]:
    """Processors that the settings of a record name."""
    return settings.get("processors") or [UNKNOWN]


def joined_processors(*parts: Mapping[str, Any]) -> dict[str, list[str]]:
    """Setting of a record of several parts: each processor once; none if none is told.

    Parameters
    ----------
    *parts : mapping
        Settings of each of them.
    """
    if not any(part.get("processors") for part in parts):
        return {}
    each = (name for part in parts for name in processors(part))
    return {"processors": list(dict.fromkeys(each))}

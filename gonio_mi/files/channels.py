"""Meaning of a record's channel names: grey, colours, wavelengths."""

import re
from collections.abc import Sequence

import numpy as np

from ..array_types import Floats
from ..errors import unknown_channel


def wavelengths_nm(channels: Sequence[str]) -> Floats | None:
    """Wavelengths of channels such as ``"550nm"``, shape (n,); None for any others."""
    matches = [re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)nm", name) for name in channels]
    found = [match[1] for match in matches if match]
    return np.array(found, dtype=float) if len(found) == len(channels) else None


def chosen_channel(place: object, names: Sequence[str], channel: str | None) -> str:
    """The channel that is asked for, ``550`` for ``550nm`` too, or the only one.

    Raises
    ------
    SettingError
        If there are several, or none is called so.
    """
    if channel is None and len(names) == 1:
        return names[0]
    for name in (channel, f"{channel}nm"):
        if name in names:
            return str(name)
    raise unknown_channel(place, names, channel)

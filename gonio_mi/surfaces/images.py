"""Heights in the pixels of an image."""

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import OpenEXR
from numpy.typing import NDArray

from .height_maps import unreadable

# How an EXR file begins, and the channels of a layer that come first.
EXR = b"v/1\x01"
FIRST = ("R", "G", "B", "X", "Y", "Z")


def image_heights(path: Path) -> NDArray[np.generic]:
    """Pixels of an image, in its own type: whole numbers are its codes.

    Mitsuba, which reads EXR files in Dr.Jit's other threads, would wait for ever in the
    constructor of a plugin where there are none, as on a single core.
    """
    try:
        with path.open("rb") as file:
            if file.read(len(EXR)) != EXR:
                return np.array(mi.Bitmap(str(path)))
        with OpenEXR.File(str(path), separate_channels=True) as image:
            channels: dict[str, Any] = image.channels()
            return np.array(channels[min(channels, key=_place)].pixels)
    except (RuntimeError, ValueError) as error:
        raise unreadable(path, error) from None


def _place(channel: str) -> tuple[str, int, str]:
    """Sort key of an EXR file's channels, whose first one Mitsuba takes for the red."""
    layer, _, name = channel.rpartition(".")
    return layer, (*FIRST, name).index(name), name

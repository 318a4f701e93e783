"""Heights in the pixels of an image."""

from pathlib import Path

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..threads import reads_files
from .height_maps import unreadable


def image_heights(path: Path) -> NDArray[np.generic]:
    """Pixels of an image, in its own type: whole numbers are its codes."""
    try:
        with reads_files():
            return np.array(mi.Bitmap(str(path)))
    except (RuntimeError, ValueError) as error:
        raise unreadable(path, error) from None

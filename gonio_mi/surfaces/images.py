"""Heights in the pixels of an image."""

from pathlib import Path

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..errors import SpecimenError
from ..threads import two_threads


def image_heights(path: Path) -> NDArray[np.generic]:
    """First channel of an image, in its own type: whole numbers are its codes."""
    try:
        with two_threads():
            array = np.array(mi.Bitmap(str(path)))
    except (RuntimeError, ValueError) as error:
        raise SpecimenError(
            f"heightfield.filename must be an image, a .npy file or a file of a "
            f"profilometer, got {path}: {error}"
        ) from None
    return array[..., 0] if array.ndim == 3 else array

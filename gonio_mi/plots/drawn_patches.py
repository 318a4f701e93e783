"""Rings and sectors to draw instead of patches that are none."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..collector import Apertures, Borders, RingsAndSectors, Subdivision
from ..collector.directions import direction
from ..collector.shirley_chiu import ShirleyChiu

__all__ = ["drawn_in_rings"]

# Their steps in degrees.
FINE = 1


def drawn_in_rings(
    patches: Subdivision, values: NDArray[Any]
) -> tuple[RingsAndSectors, NDArray[Any]]:
    """Rings and sectors, and `values` in them; fine ones where patches have none.

    NaN, or true for flags, is what lies between apertures.

    Parameters
    ----------
    patches : Subdivision
    values : ndarray, shape (..., *patches.shape, channels)
    """
    if not isinstance(patches, (Apertures, ShirleyChiu)):
        return patches.in_rings(values)
    theta, phi = (tuple(map(float, range(0, end + FINE, FINE))) for end in (90, 360))
    fine = Borders(theta, phi)
    index = patches.patch(direction(*fine.middles))
    flat = values.reshape(*values.shape[:-3], -1, values.shape[-1])[..., index, :]
    between = index >= patches.n_detectors
    flat[..., between, :] = True if flat.dtype == bool else np.nan
    return fine, flat

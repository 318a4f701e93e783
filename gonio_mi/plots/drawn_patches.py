"""Rings and sectors to draw instead of patches that are none."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..collector import Apertures, Borders, RingsAndSectors, Subdivision
from ..collector.directions import direction
from ..collector.shirley_chiu import ShirleyChiu
from ..results.record import Record

__all__ = ["ON_BORDER", "drawn_in_rings", "sectors_beside"]

# Their steps in degrees.
FINE = 1

# Radians within which a direction is on a border of patches: those of 2^-20.
ON_BORDER = 1e-6


def sectors_beside(single: Record) -> list[tuple[float, float]]:
    """Sectors in which the profile runs, in degrees, if its plane is their border.

    First that towards the source, then that beyond. Empty if a half-plane lies within
    a sector, or patches have none.
    """
    patches, phi = single.subdivision, np.radians(single.phi_i[0])
    if not isinstance(patches, RingsAndSectors) or np.isnan(phi):
        return []
    edges, found = patches.phi_edges, []
    for azimuth in (phi % (2 * np.pi), (phi + np.pi) % (2 * np.pi)):
        away = np.abs(edges - azimuth)
        if away.min() > ON_BORDER:
            return []
        first = int(np.argmin(away)) % patches.n_phi
        begin, end = np.degrees(edges[first : first + 2])
        found.append((float(begin), float(end)))
    return found


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

"""Steps in which the heights of a surface come: whole numbers of a file."""

from __future__ import annotations

import numpy as np

from ..array_types import Floats

__all__ = ["height_step"]

# Levels up to which steps are made on purpose: gratings, diffractive optics.
LEVELS = 16

# Part of a step by which gaps between levels may miss a whole number of it: single
# precision has 0.008 of 16 bits, and few levels stretched over 16 bits less.
PLAY = 0.02

# Share of points with a bend above which heights are rounded ones. Straight profiles
# of more levels, whose slope is a whole number of steps on purpose, have less.
BENT = 1 / 8


def height_step(heights: Floats) -> float | None:
    """Step to which heights are rounded, in their units.

    Parameters
    ----------
    heights : ndarray, shape (n_y, n_x)
        NaN where nothing was measured.

    Returns
    -------
    float or None
        None where heights do not come in equal steps, or where these look meant: at
        most 16 levels, as of a lamellar grating, or flanks that are straight, as of
        grooves. Terraces of more than 16 points look so, too.
    """
    levels = np.unique(heights[np.isfinite(heights)])
    if levels.size <= LEVELS:
        return None
    gaps = np.diff(levels)
    step = float(gaps[gaps < 1.5 * gaps.min()].mean())
    if np.any(abs(gaps / step - np.rint(gaps / step)) > PLAY):
        if not np.all(gaps == np.rint(gaps)):
            return None
        step = 1.0  # whole numbers, not all of which occur
    for axis in (0, 1):
        bends = np.diff(heights, 2, axis)
        known = np.isfinite(bends)
        bent = np.count_nonzero(abs(bends[known]) > step / 2)
        if bent > BENT * np.count_nonzero(known):
            return step
    return None

"""Preparation of measured heights: gaps filled, form removed."""

from __future__ import annotations

import numpy as np

from ..array_types import Flags, Floats, Integers
from ..errors import SettingError, checked_choice

# Total degree of the polynomial in x and y that is taken away.
FORMS = {"keep": None, "mean": 0, "plane": 1, "quadratic": 2, "cubic": 3}

FILLS = ("none", "nearest", "linear")


def filled(heights: Floats, method: str) -> Floats:
    """Heights with a value in place of every NaN.

    Parameters
    ----------
    heights : ndarray, shape (n_y, n_x)
        NaN where the instrument measured nothing.
    method : {"none", "nearest", "linear"}
        ``none`` refuses them; ``nearest`` takes the nearest measured point, in grid
        points; ``linear`` a plane through three measured points around the gap, and the
        nearest where a gap reaches the border.

    Returns
    -------
    ndarray
        `heights` themselves if nothing is missing.

    Raises
    ------
    ValueError
        If points are missing and `method` is ``none``, or nothing was measured.
    """
    checked_choice("fill", method, FILLS)
    missing = np.isnan(heights)
    n = np.count_nonzero(missing)
    if not n:
        return heights
    if n == missing.size:
        raise SettingError("heights must hold measured points, got none")
    if method == "none":
        raise SettingError(
            f"heights must be known everywhere, but {n} of {missing.size} points were "
            "not measured: take the fill nearest or linear"
        )
    heights = heights.copy()
    rows, columns = _nearest(missing)
    values = heights[rows, columns]
    if method == "linear":
        between = _linear(heights, missing)
        values = np.where(np.isnan(between), values, between)
    heights[missing] = values
    return heights


def _nearest(missing: Flags) -> Integers:
    """Row and column of the measured point next to each missing one."""
    from scipy import ndimage  # slow to import, and rarely needed

    where = np.empty((2, *missing.shape), np.int32)
    ndimage.distance_transform_edt(
        missing, return_distances=False, return_indices=True, indices=where
    )
    return where[:, missing]


def _linear(heights: Floats, missing: Flags) -> Floats:
    """Values at the missing points between those around them; NaN beyond these."""
    from scipy import interpolate, ndimage, spatial

    # of the measured points, those at an edge of a gap are all that counts
    edge = ndimage.binary_dilation(missing, np.ones((3, 3))) & ~missing
    try:
        surface = interpolate.LinearNDInterpolator(np.argwhere(edge), heights[edge])
    except (spatial.QhullError, ValueError):  # too few, or all in one line
        return np.full(np.count_nonzero(missing), np.nan)
    return surface(np.argwhere(missing))


def without_form(heights: Floats, form: str) -> Floats:
    """Heights less the polynomial of least squares through the measured ones.

    Parameters
    ----------
    heights : ndarray, shape (n_y, n_x)
        NaN where nothing was measured.
    form : {"keep", "mean", "plane", "quadratic", "cubic"}
        ``plane`` is the tilt; ``quadratic`` and ``cubic`` polynomials of that total
        degree take spheres, cylinders and what the instrument bends as well.

    Returns
    -------
    ndarray
        `heights` themselves for ``keep``.
    """
    checked_choice("form", form, FORMS)
    degree = FORMS[form]
    if degree is None:
        return heights
    along_y, along_x = (
        np.polynomial.legendre.legvander(np.linspace(-1, 1, n), degree)
        for n in heights.shape
    )
    measured = np.isfinite(heights)
    terms = [(a, b) for a in range(degree + 1) for b in range(degree + 1 - a)]
    pairs_y, pairs_x = (
        (v[:, :, None] * v[:, None]).reshape(len(v), -1) for v in (along_y, along_x)
    )
    # sums over all points of products of two terms: y's factors times x's
    size = degree + 1
    sums = (pairs_y.T @ measured @ pairs_x).reshape(size, size, size, size)
    matrix = [[sums[a, c, b, d] for c, d in terms] for a, b in terms]
    known = np.where(measured, heights, 0.0)
    right = along_y.T @ known @ along_x
    found = np.linalg.lstsq(np.array(matrix), [right[t] for t in terms], rcond=None)[0]
    coefficients = np.zeros((size, size))
    for term, value in zip(terms, found):
        coefficients[term] = value
    return heights - along_y @ coefficients @ along_x.T

"""Height fields: Gaussian ones to order, measured ones prepared, statistics of any."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Flags, Floats, Integers
from ..errors import (
    SettingError,
    SettingTypeError,
    check_memory,
    checked_choice,
    checked_count,
    checked_number,
)

CORRELATIONS = ("gaussian", "exponential")

# Heights and lengths are below it, so that single precision holds their squares.
MAX_LENGTH = 1e18

# Bytes per grid point at the peak of the synthesis, which is in double precision, and
# of the mesh: vertices and triangles in NumPy, Mitsuba and Embree. Measured: 61, 245.
SYNTHESIS_BYTES, MESH_BYTES = 64, 260

# Rows that are transformed at once.
ROWS_AT_ONCE = 256


@dataclass(frozen=True)
class HeightStatistics:
    """Statistics of a height field, in the units of its heights.

    Attributes
    ----------
    rms_height : float
        Standard deviation of the heights.
    alpha_u, alpha_v : float
        Roughness along x and y as Beckmann's distribution has it: sqrt(2) times the rms
        slope of the facets, weighted by projected area.
    correlation_length_u, correlation_length_v : float
        Distance along x and y at which the autocorrelation has fallen to 1/e; NaN if it
        does nowhere up to half the extent.
    """

    rms_height: float
    alpha_u: float
    alpha_v: float
    correlation_length_u: float
    correlation_length_v: float

    @property
    def correlation_lengths(self) -> str:
        """Both correlation lengths in words; empty if there is none."""
        lengths = self.correlation_length_u, self.correlation_length_v
        if np.isnan(lengths).all():
            return ""
        return " x ".join("none" if np.isnan(x) else f"{x:.4g}" for x in lengths)

    def __str__(self) -> str:
        text = f"rms height {self.rms_height:.4g}, "
        text += f"alpha {self.alpha_u:.4g} x {self.alpha_v:.4g}"
        lengths = self.correlation_lengths
        return f"{text}, correlation length {lengths}" if lengths else text


def gaussian_heights(
    resolution: tuple[int, int],
    spacing: float,
    alphas: tuple[float, float],
    correlation_length: float,
    *,
    correlation: str = "gaussian",
    shortest: float = 0.0,
    seed: int = 0,
) -> Floats:
    r"""Periodic heights with Gaussian statistics, by filtering noise in Fourier space.

    Slopes are then Gaussian too, which is Beckmann's distribution of facets.

    Parameters
    ----------
    resolution : (int, int)
        Grid points along x and along y, at least 4. The field repeats after them.
    spacing : float
        Distance between them.
    alphas : (float, float)
        Expected roughness of the facets along x and along y, as of
        :class:`HeightStatistics`; one realisation scatters about it. It fixes the rms
        height.
    correlation_length : float
        Geometric mean over x and y of the distance in which the autocorrelation falls
        to 1/e; the direction of the larger alpha has the smaller one, in proportion.
    correlation : {"gaussian", "exponential"}
        Autocorrelation :math:`e^{-r^2}` or :math:`e^{-r}`, r in correlation lengths.
        The slopes of the latter have no finite variance without a band limit, so that
        there the rms height depends on `shortest`.
    shortest : float
        Shortest wavelength, as a geometric mean too; no shorter than what the grid
        holds in both directions, which is twice its spacing.
    seed : int

    Returns
    -------
    ndarray of float64, shape (n_y, n_x)
        Heights of mean 0; row 0 is the smallest y.

    Raises
    ------
    TypeError, ValueError
        If a parameter is out of its range, or memory would not hold the field.
    """
    n_x, n_y = (checked_count("resolution", n, 4) for n in resolution)
    checked_choice("correlation", correlation, CORRELATIONS)
    what = f"a height field of {n_x} x {n_y} points"
    check_memory(what, n_x * n_y * SYNTHESIS_BYTES, "lower its resolution")
    alpha_u, alpha_v = (
        checked_number(name, alpha, 1e-6, 100, "from 1e-6 to 100")
        for name, alpha in zip(("alpha_u", "alpha_v"), alphas)
    )
    stretch = np.sqrt(alpha_v / alpha_u)
    length_u, length_v = correlation_length * stretch, correlation_length / stretch
    for name, length, n in (("x", length_u, n_x), ("y", length_v, n_y)):
        if not 2 * spacing <= length <= n * spacing / 4:
            raise SettingError(
                f"correlation_length along {name} must be from two grid spacings to a "
                f"quarter of the period, {2 * spacing:.4g} to {n * spacing / 4:.4g}, "
                f"got {length:.4g}"
            )
    shortest = max(shortest, 2 * spacing * max(stretch, 1 / stretch))
    k_x = 2 * np.pi * np.fft.rfftfreq(n_x, spacing)
    k_y = 2 * np.pi * np.fft.fftfreq(n_y, spacing)[:, None]
    square = (k_x * length_u) ** 2 + (k_y * length_v) ** 2
    is_gaussian = correlation == "gaussian"
    power = np.exp(-square / 4) if is_gaussian else (1 + square) ** -1.5
    limit = (2 * np.pi / shortest * (1 + 1e-9)) ** 2
    power *= (k_x * stretch) ** 2 + (k_y / stretch) ** 2 <= limit
    power[0, 0] = 0
    expected = _expected_alphas(power, k_x, k_y, n_x, spacing)
    scale = np.sqrt(alpha_u * alpha_v / expected.prod())
    noise = np.random.default_rng(seed).standard_normal((n_y, n_x))
    spectrum = np.fft.rfft2(noise)
    spectrum *= scale * np.sqrt(power)
    return np.fft.irfft2(spectrum, (n_y, n_x))


def _expected_alphas(
    power: Floats, k_x: Any, k_y: Any, n_x: int, spacing: float
) -> Floats:
    """Both alphas of unit white noise that is filtered with `power`, in expectation.

    The variance of the difference quotient of neighbours, as the facets have it.
    """
    # rfft keeps one of each pair of conjugate frequencies
    twice = np.full(k_x.size, 2.0)
    twice[0] = 1
    if n_x % 2 == 0:
        twice[-1] = 1
    points = n_x * k_y.size
    slopes = [2 * np.sin(k * spacing / 2) / spacing for k in (k_x, k_y)]
    variances = [np.sum(power * twice * slope**2) / points for slope in slopes]
    if not min(variances) > 0:
        raise SettingError(
            "shortest must leave wavelengths that the period holds, got none"
        )
    return np.sqrt(2 * np.array(variances))


def height_statistics(
    heights: ArrayLike, spacing: float | tuple[float, float], periodic: bool = True
) -> HeightStatistics:
    """:class:`HeightStatistics` of a grid of heights.

    Parameters
    ----------
    heights : array_like, shape (n_y, n_x)
    spacing : float or (float, float)
        Distance between grid points, along x and y.
    periodic : bool
        Whether the last row and column are next to the first.
    """
    heights = checked_heights(heights)
    dx, dy = np.broadcast_to(spacing, 2).tolist()
    # one more row and column of a periodic field, those that follow its last
    more = int(periodic)
    slope_u = np.diff(heights, axis=1, append=heights[:, :more]) / dx
    slope_v = np.diff(heights, axis=0, append=heights[:more]) / dy
    centred = heights - heights.mean()
    return HeightStatistics(
        rms_height=float(centred.std()),
        alpha_u=float(np.sqrt(2 * np.mean(slope_u**2))),
        alpha_v=float(np.sqrt(2 * np.mean(slope_v**2))),
        correlation_length_u=dx * _correlation_length(centred, periodic),
        correlation_length_v=dy * _correlation_length(centred.T, periodic),
    )


def _correlation_length(heights: Floats, periodic: bool) -> float:
    """Lag along the second axis at which the autocorrelation is 1/e; NaN for none."""
    n = heights.shape[1]
    # zeros keep the ends of a field that is not periodic apart
    size = n if periodic else 2 * n
    power = np.zeros(size // 2 + 1)
    for first in range(0, len(heights), ROWS_AT_ONCE):
        rows = heights[first : first + ROWS_AT_ONCE]
        power += np.sum(np.abs(np.fft.rfft(rows, size)) ** 2, axis=0)
    correlation = np.fft.irfft(power, size)[: n // 2 + 1]
    if not periodic:
        correlation *= n / (n - np.arange(n // 2 + 1))
    if not correlation[0] > 0:
        return np.nan
    correlation /= correlation[0]
    below = np.flatnonzero(correlation < np.exp(-1))
    if not below.size:
        return np.nan
    i = below[0]
    # linear between the grid points
    left, right = correlation[i - 1 : i + 1]
    return float(i - 1 + (left - np.exp(-1)) / (left - right))


def checked_heights(heights: ArrayLike, missing: bool = False) -> Floats:
    """Return `heights` as a float64 array, or raise SettingError.

    With `missing`, NaN is allowed, for what was not measured.
    """
    heights = np.asarray(heights)
    if heights.ndim == 3 and heights.shape[2] == 1:
        heights = heights[..., 0]
    if heights.ndim != 2 or min(heights.shape) < 2:
        raise SettingError(
            "heights must be a grid of at least 2 x 2 numbers, got an array of shape "
            f"{heights.shape}"
        )
    try:
        with np.errstate(invalid="ignore"):  # signalling NaNs are refused below
            heights = heights.astype(float)
    except (TypeError, ValueError):
        raise SettingTypeError(
            f"heights must be real numbers, got an array of {heights.dtype}"
        ) from None
    allowed = np.abs(heights) < MAX_LENGTH
    if missing:
        allowed |= np.isnan(heights)
    wrong = np.count_nonzero(~allowed)
    if wrong:
        raise SettingError(
            f"heights must be finite and below {MAX_LENGTH:g}, got {wrong} of "
            f"{heights.size} that are not"
        )
    return heights


# -------------------------------------------------------------------------- preparation

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
            "not measured: fill them, such as by fill=nearest or --fill nearest"
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
    """Linear interpolation at the missing points; NaN outside the convex hull."""
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

"""A surface that is ready to be lit: heights without gaps, in the scene's units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..array_types import Floats
from ..errors import SettingError, printable, shown
from ..single_precision import ROUNDING
from .height_maps import HeightMap
from .heights import (
    MAX_LENGTH,
    HeightStatistics,
    checked_heights,
    filled,
    height_statistics,
    without_form,
)

# The micro sign and the Greek letter are two characters.
UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3} | dict.fromkeys(("um", "µm", "μm"), 1e-6)
UNITS |= {"nm": 1e-9, "Å": 1e-10, "pm": 1e-12, "in": 0.0254}


def metres(unit: str) -> float:
    """Metres of one unit; ValueError for an unknown one."""
    if unit not in UNITS:
        raise SettingError(f"unit must be one of {', '.join(UNITS)}, got {shown(unit)}")
    return UNITS[unit]


# Metres: the middle of what is seen, for surfaces whose unit is known.
VISIBLE = 550e-9

# Beckmann's alpha beyond which units are more likely wrong than facets steep: an rms
# slope of 70 degrees. Grooves and fibres have less.
MAX_ALPHA = 4.0

# Alpha below which units are more likely wrong than facets flat: the best mirrors have
# as much, 20 nm over some millimetres; with nm taken for mm it is a millionth.
MIN_ALPHA = 1e-5

# Change of alpha over one wavelength, as a part of it, up to which facets smaller than
# that are no matter: the same surface in facets of its size would have the same slopes.
MAX_ALPHA_CHANGE = 0.03

# Step of slope, as a part of the rms slope, from where it is told. At 0.03 a mirror of
# Gaussian waves has 0.9 to 4.5 % of its light in other patches of projected:30x30 than
# without steps, twice what another seed makes of 4e5 rays at most; at 0.1 3 to 16 %, at
# 0.3 13 to 70 %. Of a rough conductor of alpha 0.05 it is 0.8 to 3.6 % at 0.3, where
# another seed makes 1 to 2.5 %.
MAX_SLOPE_STEP = 0.03

# Share of light that stays in a mirror's direction, from where it is told.
MAX_COHERENT = 0.01


@dataclass(frozen=True, eq=False)
class Topography:
    """Heights without gaps, and all that a mesh of them needs.

    Attributes
    ----------
    heights : ndarray of float64, shape (n_y, n_x)
        In scene units, which are those of the file where it states one.
    spacing : (float, float)
        Distance of grid points along x and y.
    periodic : bool
        Whether the last row and column are next to the first.
    source : str
        What they come from, and what was done to them.
    unit : str, optional
        The scene unit, if it is known.
    step : float, optional
        What the heights were rounded to, see
        :func:`~gonio_mi.surfaces.topography.height_step`.
    width_taken : bool
        Whether neither file nor user said how wide it is.
    """

    heights: Floats
    spacing: tuple[float, float]
    periodic: bool
    source: str
    unit: str | None = None
    step: float | None = None
    width_taken: bool = False

    def __repr__(self) -> str:
        n_y, n_x = self.heights.shape
        return f"<Topography of {printable(self.source)}: {n_x} x {n_y} points>"

    @cached_property
    def statistics(self) -> HeightStatistics:
        """:class:`HeightStatistics` in scene units."""
        return height_statistics(self.heights, self.spacing, self.periodic)

    @property
    def extent(self) -> tuple[float, float]:
        """Size along x and y, the joints of a period included."""
        n_y, n_x = (n if self.periodic else n - 1 for n in self.heights.shape)
        return n_x * self.spacing[0], n_y * self.spacing[1]

    def summary(self) -> str:
        """Lines on extents, heights, slopes and autocorrelation."""
        s, heights = self.statistics, self.heights
        unit = "scene units" if self.unit is None else self.unit
        centred = heights - heights.mean()
        shape = ": the map is flat"
        if s.rms_height:
            of = (float(np.mean(centred**n)) / s.rms_height**n for n in (3, 4))
            shape = ", skewness {:.3g}, kurtosis {:.3g}".format(*of)
        (n_y, n_x), (x, y), (dx, dy) = heights.shape, self.extent, self.spacing
        joined = "joined at its borders" if self.periodic else "not joined"
        extremes = f"{heights.min():.4g} to {heights.max():.4g}"
        alphas = f"{s.alpha_u:.4g} x {s.alpha_v:.4g}"
        lines = [
            ("surface", self.source),
            ("points", f"{n_x} x {n_y}, {dx:.4g} x {dy:.4g} {unit} apart"),
            ("extent", f"{x:.4g} x {y:.4g} {unit}, {joined}"),
            ("heights", f"{extremes} {unit}, rms {s.rms_height:.4g}{shape}"),
            ("slopes", f"rms {_rms_slopes(s)} degrees, alpha {alphas}"),
        ]
        if lengths := s.correlation_lengths:
            lines.append(("lengths", f"autocorrelation 1/e after {lengths} {unit}"))
        return "\n".join(f"{name:<10}{text}" for name, text in lines)

    def concerns(self) -> list[str]:
        """Reasons to doubt a measurement of the surface, as sentences."""
        s = self.statistics
        found = []
        if self.width_guess:
            found.append(
                f"the width of {self.source} is not known, and {self.width_guess} was "
                f"taken, which makes its rms slopes {_rms_slopes(s)} degrees: give "
                "size (--size), in the unit of the heights"
            )
        steepest = max(s.alpha_u, s.alpha_v)
        if steepest > MAX_ALPHA or 0 < steepest < MIN_ALPHA:
            degrees = math.degrees(math.atan(steepest / math.sqrt(2)))
            word = "steep" if steepest > MAX_ALPHA else "flat"
            extent, rms = "{:.4g} x {:.4g}".format(*self.extent), f"{s.rms_height:.3g}"
            unit = "" if self.unit is None else f" {self.unit}"
            found.append(
                f"the facets of {self.source} are absurdly {word}, alpha "
                f"{s.alpha_u:.3g} x {s.alpha_v:.3g}, an rms slope of {degrees:.4g} "
                f"degrees, for an extent of {extent}{unit} and an rms height of "
                f"{rms}{unit}: both must be in one unit; give the extent by size "
                "(--size), the heights by scale (--scale) or range (--range)"
            )
        if steps := self._slope_steps():
            unit = "" if self.unit is None else f" {self.unit}"
            found.append(
                f"the heights of {self.source} come in steps of {self.step:.3g}{unit}, "
                f"and slopes in steps of {steps[0]:.3g}, which is {steps[1]}: smooth "
                "facets send light to other patches than those of the surface would; "
                "take 16 bits or floats, smooth the heights, or make it of a rough BSDF"
            )
        if self.unit in UNITS:
            found += self._waves(s, VISIBLE / UNITS[self.unit])
        return found

    @property
    def described(self) -> str:
        """Statistics and unit of the heights, and whether they are too coarse."""
        steps = self._slope_steps()
        unit = "" if self.unit is None else f" in {self.unit}"
        coarse = "" if steps is None else f"; slopes in steps of {steps[1]}"
        width = (
            f"; width not given, {self.width_guess} taken" if self.width_guess else ""
        )
        return f"{self.statistics}{unit}{width}{coarse}"

    @property
    def width_guess(self) -> str:
        """The width that was taken; empty if it is known, or no matter in a plane."""
        if not self.width_taken or not self.statistics.rms_height:
            return ""
        return f"{self.extent[0]:.4g}{'' if self.unit is None else f' {self.unit}'}"

    def _slope_steps(self) -> tuple[float, str] | None:
        """Slope of a height step, and its share of the rms slope; None if small."""
        s = self.statistics
        rms = max(s.alpha_u, s.alpha_v) / 2**0.5
        slope = 0.0 if self.step is None else self.step / min(self.spacing)
        if self.step is None or slope < MAX_SLOPE_STEP * rms:
            return None
        return slope, f"{100 * slope / rms:.3g} % of the rms slope"

    def _waves(self, s: HeightStatistics, wavelength: float) -> list[str]:
        """Wave effects beyond geometric optics at a wavelength in scene units."""
        found = []
        shown = f"{wavelength:.3g} {self.unit}"
        least = min(self.spacing)
        if least < wavelength:
            u, v = self._alphas_over(wavelength)
            # a slope that single precision leaves of heights is none
            rounding = 2 * ROUNDING * float(abs(self.heights).max()) / least
            both = np.array([s.alpha_u, s.alpha_v])
            limits = np.maximum(MAX_ALPHA_CHANGE * both, rounding)
            if (abs(np.array([u, v]) - both) > limits).any():
                found.append(
                    f"the facets of {self.source} are smaller than the wavelength, "
                    f"{least:.3g} {self.unit} beside {shown}: this is geometric "
                    f"optics, which sees alpha {s.alpha_u:.3g} x {s.alpha_v:.3g}; over "
                    f"one wavelength it is {u:.3g} x {v:.3g}"
                )
        coherent = math.exp(-((4 * math.pi * s.rms_height / wavelength) ** 2))
        if coherent > MAX_COHERENT:
            found.append(
                f"the rms height of {self.source} is small beside the wavelength: at "
                f"normal incidence and a wavelength of {shown} waves would reflect "
                f"{100 * coherent:.3g} % as a mirror does, which geometric optics "
                "leaves out"
            )
        return found

    def _alphas_over(self, length: float) -> tuple[float, float]:
        """Alpha along x and y of differences over a length, at least of one facet.

        The facets along a row are lines: between grid points, heights are too.
        """
        alphas = []
        for axis, step in ((1, self.spacing[0]), (0, self.spacing[1])):
            n = self.heights.shape[axis]
            lag = min(max(1.0, length / step), n - 1.0)
            whole, part = int(lag), lag % 1
            behind = np.arange(n if self.periodic else n - math.ceil(lag))
            lags = (0, whole, math.ceil(lag))
            take = self.heights.take
            here, low, high = (take(behind + i, axis, mode="wrap") for i in lags)
            rise = low * (1 - part) + high * part - here
            alphas.append(math.sqrt(2 * np.mean(rise**2)) / (lag * step))
        return alphas[0], alphas[1]


def _rms_slopes(statistics: HeightStatistics) -> str:
    """Slopes along x and y in degrees."""
    alphas = statistics.alpha_u, statistics.alpha_v
    degrees = (math.degrees(math.atan(alpha / math.sqrt(2))) for alpha in alphas)
    return " x ".join(f"{one:.3g}" for one in degrees)


@dataclass(frozen=True)
class Preparation:
    """Settings that turn a map of heights into a surface.

    Attributes
    ----------
    size, size_y : float, optional
        Extent in x and y. Default: what the file says, else 2 with square cells,
        which :meth:`Topography.concerns` tells.
    scale : float, optional
        Factor on the heights. Default: 1, but codes of an image have none.
    height_range : float, optional
        Height from black to white, in place of `scale`, for codes of an image.
    unit : str, optional
        The unit of all these, where the file does not say it.
    periodic : bool, optional
        Whether to join the last row and column to the first. Default: what the file
        says, else yes.
    form : {"keep", "mean", "plane", "quadratic", "cubic"}
        See :func:`~gonio_mi.surfaces.heights.without_form`.
    fill : {"none", "nearest", "linear"}
        See :func:`~gonio_mi.surfaces.heights.filled`.
    """

    size: float | None = None
    size_y: float | None = None
    scale: float | None = None
    height_range: float | None = None
    unit: str | None = None
    periodic: bool | None = None
    form: str = "keep"
    fill: str = "none"

    def factor(self, given: HeightMap, heights: Floats) -> float:
        """Height of one unit of the numbers of a map."""
        scale, height_range = self.scale, self.height_range
        if given.codes is None:
            if height_range is not None:
                raise SettingError(
                    "range (--range) applies to images of integers; for the "
                    f"heights of {given.source} take scale (--scale)"
                )
            return 1.0 if scale is None else scale
        if (scale is None) == (height_range is None):
            low, high = np.nanmin(heights), np.nanmax(heights)
            raise SettingError(
                f"the pixels of {given.source} are whole numbers from {low:.0f} to "
                f"{high:.0f}, and one of two must be given to make them heights: "
                "scale (--scale), the height of a step of 1, or range (--range), that "
                f"of all {given.codes}"
            )
        return scale if height_range is None else height_range / given.codes  # type: ignore[return-value]

    def spacing(self, given: HeightMap, cells: tuple[int, int]) -> tuple[float, float]:
        """Distance of grid points along x and y."""
        dx, dy = given.spacing or (2.0 / cells[0],) * 2
        if not (1 / MAX_LENGTH < dx < MAX_LENGTH and 1 / MAX_LENGTH < dy < MAX_LENGTH):
            raise SettingError(
                f"the spacing of grid points must be positive, {given.source} has "
                f"{dx:g} x {dy:g}: give size (--size)"
            )
        if self.size is not None:
            dx, dy = self.size / cells[0], self.size / cells[0] * (dy / dx)
        if self.size_y is not None:
            dy = self.size_y / cells[1]
        return dx, dy

    def unit_of(self, given: HeightMap) -> str | None:
        """The unit of length of a map, from its file or from the user."""
        if self.unit is None:
            return given.unit
        metres(self.unit)
        if given.unit is not None:
            raise SettingError(
                "unit (--unit) applies to files that do not state theirs; "
                f"{given.source} is in {given.unit}, got {self.unit}"
            )
        return self.unit


AS_GIVEN = Preparation()


def topography(given: HeightMap, wanted: Preparation = AS_GIVEN) -> Topography:
    """:class:`Topography` of a map of heights.

    Raises
    ------
    ValueError
        If something is missing, or given twice.
    """
    heights = checked_heights(given.heights, missing=True)
    factor, step = wanted.factor(given, heights), height_step(heights)
    heights = heights * factor
    done = [given.source]
    if wanted.form != "keep":
        done.append(f"{wanted.form} removed")
    if missing := np.count_nonzero(np.isnan(heights)):
        done.append(f"{missing} missing points filled ({wanted.fill})")
    heights = filled(without_form(heights, wanted.form), wanted.fill)
    joined = given.periodic if wanted.periodic is None else wanted.periodic
    joined = True if joined is None else joined
    n_y, n_x = (n if joined else n - 1 for n in heights.shape)
    step = None if step is None else abs(factor) * step
    taken = given.spacing is None and wanted.size is None
    spacing, unit = wanted.spacing(given, (n_x, n_y)), wanted.unit_of(given)
    return Topography(heights, spacing, joined, ", ".join(done), unit, step, taken)


# Levels up to which steps are made on purpose: gratings, diffractive optics.
MAX_LEVELS = 16

# Part of a step by which gaps between levels may miss a whole number of it: single
# precision has 0.008 of 16 bits, and few levels stretched over 16 bits less.
MAX_STEP_ERROR = 0.02

# Share of points with a bend above which heights are rounded ones. Straight profiles
# of more levels, whose slope is a whole number of steps on purpose, have less.
MAX_BENT = 1 / 8


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
    if levels.size <= MAX_LEVELS:
        return None
    gaps = np.diff(levels)
    step = float(gaps[gaps < 1.5 * gaps.min()].mean())
    if np.any(abs(gaps / step - np.rint(gaps / step)) > MAX_STEP_ERROR):
        if not np.all(gaps == np.rint(gaps)):
            return None
        step = 1.0  # whole numbers, not all of which occur
    for axis in (0, 1):
        bends = np.diff(heights, 2, axis)
        known = np.isfinite(bends)
        bent = np.count_nonzero(abs(bends[known]) > step / 2)
        if bent > MAX_BENT * np.count_nonzero(known):
            return step
    return None

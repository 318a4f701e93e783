"""Uncertainty budget of each point of a comparison, by source."""

from dataclasses import dataclass, replace
from os import PathLike
from typing import Any

import numpy as np

from ...array_types import Floats
from ...files import check_output, replacing
from ...files.measured_table import MeasuredTable
from ...single_precision import FEW_ROUNDINGS
from ...specimen.specimen_text import SpecimenLike
from .compare import compare
from .comparison import Comparison
from .measure_like import measure_like, without_aperture

SOURCES = ("rays", "single_precision", "instrument", "calibration")
POINT = ("theta_i", "phi_i", "theta_o", "phi_o", "channel", "value", "other")

# The mean over an aperture differs from the value at its axis as the square of its
# half-angle: from one half as wide, the difference follows to this part.
NARROWED, EXTRAPOLATION = 0.5, 4 / 3


@dataclass(frozen=True, eq=False, repr=False)
class Budget:
    """Standard uncertainties of the differences of a comparison, by their source.

    Attributes
    ----------
    comparison : Comparison
    rays : ndarray of float64, shape (n_points,)
        Of the record in 1/sr, as all of these: chance, from its batches, or what its
        integrals may be wrong by. NaN where there was no hit. Of a table or a fit that
        comes first, its own error.
    single_precision : ndarray
        A few roundings of the value.
    instrument : ndarray
        Of the other, independent between points.
    calibration : ndarray
        Of a factor common to all of the other's values.
    aperture : ndarray, optional
        How much the mean over the aperture differs from the value at its axis. It is no
        part of `total`: both sides see the same aperture, if its half-angle is right.
    """

    comparison: Comparison
    rays: Floats
    single_precision: Floats
    instrument: Floats
    calibration: Floats
    aperture: Floats | None = None

    @property
    def total(self) -> Floats:
        """Root of the sum of the squares of the four sources."""
        squares = [np.nan_to_num(getattr(self, name)) ** 2 for name in SOURCES]
        return np.sqrt(np.sum(squares, axis=0))

    def save(self, path: str | PathLike[str]) -> None:
        """Write a line for each point to a ``.csv`` file, angles in degrees.

        Raises
        ------
        ValueError, OSError
            For another ending, or if the file cannot be written.
        """
        check_output(path, (".csv",))
        columns: dict[str, Any] = {k: getattr(self.comparison, k) for k in POINT}
        columns |= {name: getattr(self, name) for name in (*SOURCES, "total")}
        columns["z"] = self.comparison.z
        if self.aperture is not None:
            columns["aperture"] = self.aperture
        rows = zip(*(column.tolist() for column in columns.values()))
        lines = [",".join(columns), *(",".join(map(str, row)) for row in rows)]
        with replacing(path) as stream:
            stream.write(("\n".join(lines) + "\n").encode())

    def __repr__(self) -> str:
        return f"<Budget of {len(self.rays)} points>"

    def __str__(self) -> str:
        variance = np.maximum(self.total**2, np.finfo(float).tiny)
        scale = float(np.mean(np.abs(self.comparison.other))) or 1.0
        lines = ["uncertainty budget   median      largest    share of the variance"]
        for name in (*SOURCES, "aperture"):
            column = getattr(self, name)
            if column is None:
                continue
            column = np.nan_to_num(column)  # nothing is known of no hit
            sizes = np.abs(column) / scale
            share = f"{np.median(column**2 / variance):8.1%}"
            if name == "aperture":
                share = "not in it: mean over the aperture less its axis"
            lines.append(
                f"{name.replace('_', ' '):16s} {np.median(sizes):10.2e} "
                f"{sizes.max():12.2e}    {share}"
            )
        return "\n".join([*lines, "relative to the mean of the other's values"])


def uncertainty_budget(
    comparison: Comparison,
    scale_uncertainty: float = 0.0,
    aperture: Floats | None = None,
) -> Budget:
    """Uncertainty budget of a comparison, point by point.

    Parameters
    ----------
    comparison : Comparison
    scale_uncertainty : float
        With which it was made: relative, of a factor common to the other's values. Of
        two tables that have one each, the root of the sum of both squares.
    aperture : ndarray, shape (n_points,), optional
        What :func:`aperture_effect` returns.
    """
    calibration = scale_uncertainty * np.abs(comparison.other)
    independent = comparison.other_std_err**2 - calibration**2
    return Budget(
        comparison,
        rays=comparison.std_err,
        single_precision=FEW_ROUNDINGS * np.abs(comparison.value),
        instrument=np.sqrt(np.maximum(independent, 0)),
        calibration=calibration,
        aperture=aperture,
    )


def aperture_effect(
    specimen: SpecimenLike,
    table: MeasuredTable,
    comparison: Comparison,
    *,
    aperture_half_angle: float | None = None,
    **settings: Any,
) -> Floats:
    """Mean over each aperture less the value at its axis, in 1/sr, to second order.

    From a second measurement, with apertures half as wide.

    Parameters
    ----------
    specimen : dict, mi.BSDF, mi.Scene, str or path
    table : MeasuredTable
    comparison : Comparison
        Of a record that :func:`measure_like` made for the table.
    aperture_half_angle : float, optional
        In degrees, if the table does not say it.
    **settings
        Of :func:`measure_like`.
    """
    half_angle = table.aperture_half_angle or aperture_half_angle
    if half_angle is None:
        raise without_aperture(table)
    narrow = replace(table, aperture_half_angle=NARROWED * half_angle)
    records = measure_like(specimen, narrow, **settings)
    other = compare(records, narrow)
    values = dict(zip(_directions(other), other.value))
    at = [values[one] for one in _directions(comparison)]
    return EXTRAPOLATION * (comparison.value - np.array(at))


def _directions(comparison: Comparison) -> list[tuple[float, ...]]:
    """Directions of each point."""
    columns = (getattr(comparison, name).tolist() for name in POINT[:4])
    return list(zip(*columns))

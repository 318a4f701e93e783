"""Picture of a fit: the record's points with error bars, and the model through them."""

from __future__ import annotations

from dataclasses import fields
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import SettingError
from ..files.measured_table import MeasuredTable
from ..plots.drawable import finished, new_figure
from ..results.record import Record
from .points_figure import points_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["fit_figure"]

# Incident directions that are drawn, evenly among those of a stack.
MOST_DIRECTIONS = 4


def fit_figure(fits: Any, path: str | PathLike[str] | None = None) -> Figure:
    """Draw fits of one record in the plane of incidence, and write it if `path` is.

    A row for reflection and one for transmission, if the record has any; a column for
    each of up to four incident directions. Points are patches of the record with 95 %
    intervals, lines the models.

    Parameters
    ----------
    fits : Fit or sequence of Fit
    path : str or path, optional
        Ends in ``.pdf``, ``.png`` or ``.svg``.
    """
    fits = list(fits) if isinstance(fits, (list, tuple)) else [fits]
    record = fits[0].record
    if not all(_is_same(one.record, record) for one in fits):
        raise SettingError("fits must be of one record to be drawn together")
    if isinstance(record, MeasuredTable) or record.subdivision.axes is not None:
        return points_figure(fits, path)
    last = len(record) - 1
    shown = np.unique(np.linspace(0, last, min(MOST_DIRECTIONS, last + 1)).round())
    rows = ["brdf", *(["btdf"] if record.has_lower and record.btdf.any() else [])]
    figure = new_figure(path, figsize=(5 * len(shown) + 1, 4.2 * len(rows)))
    all_axes = figure.subplots(len(rows), len(shown), squeeze=False)
    for axes_of_row, of in zip(all_axes, rows):
        for axes, index in zip(axes_of_row, shown.astype(int)):
            _draw(axes, fits, int(index), of)
        axes_of_row[0].set_ylabel(f"{of.upper()} (1/sr)")
    all_axes[0, 0].legend(frameon=False, fontsize="small")
    return finished(figure, path)


def _is_same(one: Record | MeasuredTable, other: Record | MeasuredTable) -> bool:
    """Whether both hold the same; a table that was told something is another object."""
    if not (isinstance(one, MeasuredTable) and isinstance(other, MeasuredTable)):
        return one is other or one == other
    pairs = [(getattr(one, f.name), getattr(other, f.name)) for f in fields(one)]
    return all(
        np.array_equal(a, b, equal_nan=np.asarray(a).dtype.kind == "f")
        for a, b in pairs
    )


def _draw(axes: Axes, fits: list[Any], index: int, of: str) -> None:
    """One incident direction: the first channel of record and models."""
    from ..plots.profile import bars_text, profile

    single = fits[0].record[index]
    points = profile(single, of)
    value = points.value[:, 0]
    errors = np.abs([value - points.low[:, 0], points.high[:, 0] - value])
    axes.errorbar(
        points.theta,
        value,
        errors,
        fmt="ok",
        markersize=3,
        capsize=2,
        label=f"record, {bars_text(single)}",
    )
    for fitted in fits:
        model = profile(fitted.prediction[index], of)
        line = np.append(model.value[:, 0], model.value[-1, 0])
        axes.step(model.edges, line, where="post", label=fitted.label)
    axes.set_title(
        f"theta_i {single.theta_i[0]:.4g}°, phi_i {single.phi_i[0]:.4g}°, "
        f"{single.channels[0]}",
        fontsize="small",
    )
    axes.set_xlabel("theta_o (degrees; negative: towards the source)")

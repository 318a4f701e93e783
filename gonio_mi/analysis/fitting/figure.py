"""Picture of fits: values with error bars, the models, and the residuals of points."""

from __future__ import annotations

from dataclasses import dataclass, fields
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from ...array_types import Floats
from ...errors import SettingError
from ...files.measured_table import MeasuredTable
from ...plots.figure import direction_text, evenly, finished, new_figure
from ...results.record import Record
from ..comparison.figure import points_in_profile, quantity_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Incident directions that are drawn, evenly among all.
MAX_DIRECTIONS = 4

# Of points with their error bars.
POINTS = {"fmt": "ok", "markersize": 3, "capsize": 2}

# Quantile of the relative residuals that the lower axis shows; its least half-range.
RESIDUAL_QUANTILE, MIN_HALF_RANGE = 0.95, 1e-6


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
        return _figure_of_points(fits, path)
    shown = evenly(len(record), MAX_DIRECTIONS)
    rows = ["brdf", *(["btdf"] if record.has_lower and record.btdf.any() else [])]
    figure = new_figure(path, figsize=(5 * len(shown) + 1, 4.2 * len(rows)))
    all_axes = figure.subplots(len(rows), len(shown), squeeze=False)
    for axes_of_row, of in zip(all_axes, rows):
        for axes, index in zip(axes_of_row, shown):
            _draw_patches(axes, fits, index, of)
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


def _draw_patches(axes: Axes, fits: list[Any], index: int, of: str) -> None:
    """One incident direction: the first channel of record and models."""
    from ...plots.profile import bars_text, profile

    single = fits[0].record[index]
    points = profile(single, of)
    value = points.value[:, 0]
    errors = np.abs([value - points.low[:, 0], points.high[:, 0] - value])
    label = f"record, {bars_text(single)}"
    axes.errorbar(points.theta, value, errors, label=label, **POINTS)
    for fitted in fits:
        model = profile(fitted.prediction[index], of)
        line = np.append(model.value[:, 0], model.value[-1, 0])
        axes.step(model.edges, line, where="post", label=fitted.label)
    direction = direction_text(single.theta_i[0], single.phi_i[0])
    axes.set_title(f"{direction}, {single.channels[0]}", fontsize="small")
    axes.set_xlabel("θₒ (degrees; negative: towards the source)")


@dataclass
class _Points:
    """Values in directions, one of each per row; angles in degrees."""

    incident: Floats
    exit: Floats
    value: Floats
    std_err: Floats
    unit: Floats


def _figure_of_points(fits: list[Any], path: str | PathLike[str] | None) -> Figure:
    """Draw fits over the signed polar angle, and below what they leave.

    A column for each of up to four incident directions, of the first channel.
    """
    points = _points(fits[0].record)
    directions = np.unique(points.incident, axis=0)
    shown = evenly(len(directions), MAX_DIRECTIONS)
    figure = new_figure(path, figsize=(5 * len(shown) + 1, 5.6))
    axes = figure.subplots(
        2, len(shown), squeeze=False, sharex="col", height_ratios=(3, 1)
    )
    for (above, below), number in zip(axes.T, shown):
        _draw_points(fits, points, directions[number], above, below)
    axes[0, 0].set_ylabel(f"{quantity_of(points.exit[:, 0])} (1/sr)")
    axes[1, 0].set_ylabel("model / points - 1\n(what is beyond: not drawn)")
    axes[0, 0].legend(frameon=False, fontsize="small")
    return finished(figure, path)


def _points(record: Record | MeasuredTable) -> _Points:
    """Points of a table, or of the apertures of a record."""
    if isinstance(record, MeasuredTable):
        incident = np.stack([record.theta_i, record.phi_i], axis=-1)
        towards = np.stack([record.theta_o, record.phi_o], axis=-1)
        unit = np.ones(len(record))
        return _Points(incident, towards, record.bsdf, record.bsdf_std_err, unit)
    patches, n = record.subdivision, record.subdivision.n_detectors
    axes = np.degrees(np.concatenate(patches.middles, axis=1))[:n]
    below = np.stack([180 - axes[:, 0], axes[:, 1]], axis=-1)
    towards = np.concatenate([axes, below][: record.n_hemispheres])
    solid = np.tile(patches.projected_solid_angles[:n, 0], record.n_hemispheres)
    parts = []
    for single in record:
        both = [(single.brdf, single.brdf_std_err), (single.btdf, single.btdf_std_err)]
        found = [
            np.concatenate([one[:n, 0, 0] for one in values if one is not None])
            for values in zip(*both)
        ]
        incident = np.tile([single.theta_i[0], single.phi_i[0]], (len(towards), 1))
        parts.append((incident, towards, *found, solid))
    return _Points(*(np.concatenate(columns) for columns in zip(*parts)))


def _draw_points(
    fits: list[Any], points: _Points, incident: Floats, above: Axes, below: Axes
) -> None:
    """One incident direction."""
    (own,) = np.nonzero((points.incident == incident).all(axis=1))
    theta_o, phi_o = points.exit[own].T
    x, in_plane, axis = points_in_profile(theta_o, phi_o, float(incident[1]))
    order = np.argsort(x[in_plane], kind="stable")
    x, own = x[in_plane][order], own[in_plane][order]
    value, errors = points.value[own], np.nan_to_num(points.std_err[own])
    label = "points +- std_err" if errors.any() else "points, uncertainty not stated"
    above.errorbar(x, value, errors, label=label, **POINTS)
    below.axhline(0, color="0.5", linewidth=0.8)
    some = np.where(value == 0, np.nan, value)
    left = [errors / some]
    below.errorbar(x, 0 * x, left[0], **POINTS | {"markersize": 0})
    for fitted in fits:
        channels = fitted.predicted.size // len(points.value)
        model = fitted.predicted[::channels][own] / points.unit[own]
        above.plot(x, model, linewidth=1, label=fitted.label)
        left.append((model - value) / some)
        below.plot(x, left[-1], linewidth=1)
    above.set_title(direction_text(*incident), fontsize="small")
    found = np.abs(np.stack(left))
    found = found[np.isfinite(found)]
    reach = np.quantile(found, RESIDUAL_QUANTILE) if some.any() else 1.0
    reach = float(np.clip(1.5 * reach, MIN_HALF_RANGE, 1.0))
    below.set_ylim(-reach, reach)
    below.set_xlabel(axis)

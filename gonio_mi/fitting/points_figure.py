"""Picture of fits to a table or to apertures: the points, the models, what is left."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from ..array_types import Floats
from ..comparison.comparison_figure import points_in_profile
from ..files.measured_table import MeasuredTable
from ..plots.drawable import finished, new_figure
from ..results.record import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["points_figure"]

# Part of the differences that is within the scale, which is at least so large.
SHOWN, LEAST = 0.95, 1e-6

# Incident directions that are drawn, evenly among all.
MOST_DIRECTIONS = 4


@dataclass
class _Points:
    """Values in directions, one of each per row; angles in degrees."""

    incident: Floats
    exit: Floats
    value: Floats
    std_err: Floats
    unit: Floats


def points_figure(fits: list[Any], path: str | PathLike[str] | None = None) -> Figure:
    """Draw fits over the signed polar angle, and below what they leave.

    A column for each of up to four incident directions, of the first channel.
    """
    points = _points(fits[0].record)
    directions = np.unique(points.incident, axis=0)
    last = len(directions) - 1
    shown = np.unique(np.linspace(0, last, min(MOST_DIRECTIONS, last + 1)).round())
    figure = new_figure(path, figsize=(5 * len(shown) + 1, 5.6))
    axes = figure.subplots(
        2, len(shown), squeeze=False, sharex="col", height_ratios=(3, 1)
    )
    for (above, below), number in zip(axes.T, shown.astype(int)):
        _draw(fits, points, directions[number], above, below)
    axes[0, 0].set_ylabel("BSDF (1/sr)")
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
    towards = np.concatenate([axes, below][: 1 + record.has_lower])
    solid = np.tile(patches.projected_solid_angles[:n, 0], 1 + record.has_lower)
    parts = []
    for single in (record[i] for i in range(len(record))):
        both = [(single.brdf, single.brdf_std_err), (single.btdf, single.btdf_std_err)]
        found = [
            np.concatenate([one[:n, 0, 0] for one in values if one is not None])
            for values in zip(*both)
        ]
        incident = np.tile([single.theta_i[0], single.phi_i[0]], (len(towards), 1))
        parts.append((incident, towards, *found, solid))
    return _Points(*(np.concatenate(columns) for columns in zip(*parts)))


def _draw(
    fits: list[Any], points: _Points, incident: Floats, above: Axes, below: Axes
) -> None:
    """One incident direction."""
    (own,) = np.nonzero((points.incident == incident).all(axis=1))
    theta_o, phi_o = points.exit[own].T
    x, in_plane, axis = points_in_profile(theta_o, phi_o, float(incident[1]))
    order = np.argsort(x[in_plane], kind="stable")
    x, own = x[in_plane][order], own[in_plane][order]
    value, errors = points.value[own], np.nan_to_num(points.std_err[own])
    style = {"fmt": "ok", "markersize": 3, "capsize": 2}
    label = "points +- std_err" if errors.any() else "points, uncertainty not stated"
    above.errorbar(x, value, errors, label=label, **style)
    below.axhline(0, color="0.5", linewidth=0.8)
    some = np.where(value == 0, np.nan, value)
    left = [errors / some]
    below.errorbar(x, 0 * x, left[0], **style | {"markersize": 0})
    for fitted in fits:
        channels = fitted.predicted.size // len(points.value)
        model = fitted.predicted[::channels][own] / points.unit[own]
        above.plot(x, model, linewidth=1, label=fitted.label)
        left.append((model - value) / some)
        below.plot(x, left[-1], linewidth=1)
    above.set_title(
        f"theta_i {incident[0]:.4g}°, phi_i {incident[1]:.4g}°", fontsize="small"
    )
    found = np.abs(np.stack(left))
    reach = np.quantile(found[np.isfinite(found)], SHOWN) if some.any() else 1.0
    reach = float(np.clip(1.5 * reach, LEAST, 1.0))
    below.set_ylim(-reach, reach)
    below.set_xlabel(axis)

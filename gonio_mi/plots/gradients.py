"""Figures of gradients: maps of what patches gain and lose with a parameter."""

from __future__ import annotations

import math
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from ..results.record import Record
from .figure import finished, new_figure
from .plot import GRID, NAMES, chosen, figure_title, received

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Maps of a row.
MAX_COLUMNS = 4


def plot_gradient(
    record: Record,
    name: str,
    path: str | PathLike[str] | None = None,
    *,
    index: int = 0,
) -> Figure:
    """Draw maps of the derivative of BRDF and BTDF by a parameter.

    Of several channels the mean; a map for each number of the parameter. Patches that
    gain with it are red, those that lose are blue; grey patches received nothing.

    Parameters
    ----------
    record : Record
    name : str
        As :meth:`~gonio_mi.results.record.Record.gradient` takes it.
    path : str or path, optional
        Ends in ``.pdf``, ``.png`` or ``.svg``.
    index : int
        Number of the incident direction of a stack.

    Returns the matplotlib figure, and raises as :func:`gonio_mi.plot`.
    """
    single, maps = chosen(record, index), []
    for of in received(single):
        values = single.gradient(name, of)
        channels = values.reshape(*values.shape[:2], len(single.channels), -1)
        maps += [(of, one) for one in np.moveaxis(channels.mean(axis=2), -1, 0)]
    n = len(maps)
    columns = min(n, MAX_COLUMNS)
    rows = math.ceil(n / columns)
    figure = new_figure(path, figsize=(max(5, 3.6 * columns), 3.4 * rows + 1.4))
    from matplotlib.colors import Normalize

    from .polar_map import add_legend, colour_bar, draw_patches

    largest = max(float(np.nanmax(np.abs(one))) for _, one in maps) or 1.0
    scale = Normalize(-largest, largest)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    each = n // len(received(single))
    for number, (place, (of, values)) in enumerate(zip(axes, maps)):
        mesh = draw_patches(place, single, of, scale, "", "RdBu_r", values=values)
        own = f"[{number % each}]" if each > 1 else ""
        place.set_title(f"{NAMES[of]}{own}", fontsize="small")
    for place in axes[n:]:
        place.set_axis_off()
    colour_bar(figure, mesh, axes.tolist(), f"d / d {name}  (1/sr)")
    add_legend(figure, axes[:n], loc="outside lower center")
    title = f"{figure_title(record, index)}\nDerivative by {name} ({GRID})"
    return finished(figure, path, title)

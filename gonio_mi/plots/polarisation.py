"""Figures of Mueller matrices: all elements, and what incident light becomes."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from ..array_types import Floats
from ..results import statistics
from ..results.mueller import checked_stokes
from ..results.record import Record
from .figure import finished, new_figure
from .plot import GRID, NAMES, chosen, figure_title, received
from .profile import LEVEL, cut_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Stokes vectors of light that is polarised along s and p.
POLARISED = {"s": (1.0, 1.0, 0.0, 0.0), "p": (1.0, -1.0, 0.0, 0.0)}

# Part of the largest value, below which nothing is said of the polarisation of light.
MIN_LIGHT = 1e-9


def plot_mueller(
    record: Record,
    path: str | PathLike[str] | None = None,
    *,
    index: int = 0,
    of: str = "brdf",
) -> Figure:
    """Draw 16 maps: the BRDF, and the other elements of its Mueller matrix over it.

    Of several channels the mean. The colours of all elements but the first go from -1
    (blue) to 1 (red); grey patches received nothing.

    Parameters
    ----------
    record : Record
        Of a polarised variant.
    path : str or path, optional
        Ends in ``.pdf``, ``.png`` or ``.svg``.
    index : int
        Number of the incident direction of a stack.
    of : {"brdf", "btdf"}

    Returns the matplotlib figure, and raises as :func:`gonio_mi.plot`.
    """
    single = chosen(record, index)
    columns = [single.stokes(vector, of)[0] for vector in _light_of_columns()]
    # of the four basis vectors, from those of real light
    first = columns[0]
    matrices = np.stack([first, *(one - first for one in columns[1:])], axis=-1)
    matrices = matrices.mean(axis=-3)
    figure = new_figure(path, figsize=(10, 11))
    from .polar_map import add_bar, add_legend, colour_bar, draw_patches, scale_of

    light = matrices[..., 0, 0]
    axes = figure.subplots(4, 4)
    for place, (i, j) in zip(axes.ravel(), np.ndindex(4, 4)):
        if (i, j) == (0, 0):
            scale = scale_of(light[light > 0])
            mesh = draw_patches(place, single, of, scale)
            bar = place.inset_axes((-0.3, 0.1, 0.06, 0.8))
            add_bar(figure, mesh, bar, single, of)
            bar.yaxis.set_ticks_position("left")
            bar.yaxis.set_label_position("left")
            place.set_title("M00", fontsize="small")
        else:
            values = _over(matrices[..., i, j], light)
            mesh = draw_patches(place, single, of, *_signed(), values=values)
            place.set_title(f"M{i}{j} / M00", fontsize="small")
    colour_bar(figure, mesh, axes[:, -1], "element over M00")
    add_legend(figure, axes.ravel(), loc="outside lower center")
    name = NAMES[of]
    title = f"{figure_title(record, index)}\n{name}, Mueller matrix ({GRID})"
    return finished(figure, path, title)


def plot_stokes(
    record: Record,
    path: str | PathLike[str] | None = None,
    *,
    stokes: Sequence[float] = (1.0, 0.0, 0.0, 0.0),
    index: int = 0,
) -> Figure:
    """Draw the polarisation of what leaves for light of one polarisation.

    Maps of the power, of the degree and the angle of linear polarisation, and of the
    circular part V / I. The angle counts from s towards p and is from -90 to 90
    degrees. Below, profiles in the plane of incidence for light that is polarised
    along s and along p, with 95 % intervals by Student's t. Of several channels the
    mean; transmission is drawn in a second row if any was received.

    Parameters
    ----------
    record : Record
        Of a polarised variant.
    path : str or path, optional
        Ends in ``.pdf``, ``.png`` or ``.svg``.
    stokes : sequence of 4 floats
        Of the incident light. Default: unpolarised.
    index : int
        Number of the incident direction of a stack.

    Returns the matplotlib figure, and raises as :func:`gonio_mi.plot` and
    :meth:`~gonio_mi.results.record.Record.stokes`.
    """
    single, vector = chosen(record, index), checked_stokes(stokes)
    shown = received(single)
    figure = new_figure(path, figsize=(12, 3.7 * len(shown) + 3.8))
    heights = (1.05 * len(shown), 1)
    above, below = figure.subfigures(2, 1, height_ratios=heights)
    rows = above.subplots(len(shown), 4, squeeze=False)
    from .polar_map import add_legend

    for of, axes in zip(shown, rows):
        _draw_state(above, axes, single, of, vector)
    add_legend(above, rows.ravel(), loc="outside upper right")
    _draw_s_and_p(below.subplots(), single, shown)
    numbers = ", ".join(f"{x:g}" for x in vector)
    title = f"{figure_title(record, index)}\nincident Stokes vector ({numbers}), {GRID}"
    return finished(figure, path, title)


def _light_of_columns() -> Floats:
    """Stokes vectors of unpolarised light, and of three that are polarised."""
    return np.eye(4) + np.array([[0, 0, 0, 0], *[[1, 0, 0, 0]] * 3])


def _over(values: Floats, light: Floats) -> Floats:
    """Values over light; NaN in the dark."""
    lit = light > MIN_LIGHT * np.max(light, initial=0)
    return np.where(lit, values, np.nan) / np.where(lit, light, 1.0)


def _signed() -> tuple[Any, str, str]:
    """Scale of numbers between -1 and 1, no note, and their colours."""
    from matplotlib.colors import Normalize

    return Normalize(-1, 1), "", "RdBu_r"


def _draw_state(
    figure: Any, axes: Sequence[Any], single: Record, of: str, vector: Floats
) -> None:
    """Draw maps of the four numbers of a state of polarisation."""
    from matplotlib.colors import Normalize

    from .polar_map import colour_bar, draw_patches, scale_of

    light, q, u, v = np.moveaxis(single.stokes(vector, of)[0].mean(axis=-2), -1, 0)
    linear = _over(np.hypot(q, u), light)
    angle = np.degrees(np.arctan2(u, q)) / 2
    # rounding has a direction too
    angle = np.where(linear > 1e-4, angle, np.nan)
    scale, steps = scale_of(light[light > 0]), range(-90, 91, 45)
    states = [
        (light, scale, "viridis", f"{of.upper()} (1/sr)", None),
        (linear, Normalize(0, 1), "magma", "degree of linear polarisation", None),
        (angle, Normalize(-90, 90), "twilight", "angle from s to p (degrees)", steps),
        (_over(v, light), Normalize(-1, 1), "RdBu_r", "circular part V / I", None),
    ]
    for place, (values, scale, colours, label, ticks) in zip(axes, states):
        mesh = draw_patches(place, single, of, scale, "", colours, values=values)
        bar = place.inset_axes((0.05, -0.06, 0.9, 0.05))
        where = {"cax": bar, "orientation": "horizontal", "ticks": ticks}
        colour_bar(figure, mesh, None, label, **where)
    axes[0].set_title(NAMES[of], fontsize="medium", loc="left")


def _draw_s_and_p(axes: Any, single: Record, shown: Sequence[str]) -> None:
    """Draw profiles for light that is polarised along s and along p."""
    edges, theta, cut = cut_of(single)
    factor = 1.0
    if single.n_batches > 1:
        # the limits of a value of 0 with a standard error of 1
        factor = float(
            statistics.student_interval(
                np.zeros(1), np.ones(1), single.n_batches, LEVEL
            )[1][0]
        )
    for of in shown:
        for colour, (name, vector) in zip(("C0", "C3"), POLARISED.items()):
            values, errors = single.stokes(vector, of)
            value, error = (
                cut(one[..., 0].mean(axis=-1)[..., None])[:, 0]
                for one in (values, errors)
            )
            error = factor * np.nan_to_num(error)
            full = of == "brdf"
            line = {"baseline": None, "color": colour, "ls": "-" if full else "--"}
            axes.stairs(value, edges, lw=1, alpha=0.5, **line)
            label = f"{of.upper()}, incident light along {name}"
            points = {"ms": 3, "lw": 1, "mfc": None if full else "w", "color": colour}
            axes.errorbar(theta, value, error, fmt="o", label=label, **points)
    axes.set_xlim(-90, 90)
    axes.set_ylim(0, None)
    axes.set_xticks(range(-90, 91, 30), [f"{angle}°" for angle in range(-90, 91, 30)])
    axes.set_xlabel(
        r"$\theta_o$ in the plane of incidence (negative: towards the source)"
    )
    axes.set_ylabel(f"power, {LEVEL:.0%} interval (1/sr)")
    axes.grid(alpha=0.3, lw=0.5)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize="small")

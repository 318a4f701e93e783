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
from .profile import (
    GREY,
    LEVEL,
    Profile,
    bars_text,
    colours_of,
    cut_profile,
    draw_curve,
    plane_text,
    set_angles,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Stokes vectors of light that is polarised along s and p.
POLARISED = {"s": (1.0, 1.0, 0.0, 0.0), "p": (1.0, -1.0, 0.0, 0.0)}

# Part of the largest value, below which nothing is said of the polarisation of light.
MIN_LIGHT = 1e-9

# A smaller degree of polarisation is rounding, which has a direction too.
MIN_DEGREE = 1e-4


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
    # a column is what one element of the Stokes vector adds to unpolarised light
    plain, *more = (single.stokes([1.0, *rest], of)[0] for rest in np.eye(4)[:, 1:])
    matrices = np.stack([plain, *(one - plain for one in more)], axis=-1)
    matrices = matrices.mean(axis=-3)
    figure = new_figure(path, figsize=(10, 11))
    from matplotlib.colors import Normalize

    from .polar_map import add_bar, add_legend, colour_bar, draw_patches, scale_of

    light, signed = matrices[..., 0, 0], Normalize(-1, 1)
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
            mesh = draw_patches(place, single, of, signed, "", "RdBu_r", values=values)
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
    """Draw the polarisation of scattered light for one incident Stokes vector.

    Maps of the power, of the degree of polarisation, of the angle of its linear part
    and of the circular part V / I, both up to the largest value. The angle counts from
    s towards p and is from -90 to 90 degrees. Below, profiles in the plane of
    incidence with 95 % intervals by Student's t: the power for light that is polarised
    along s and along p, and the degree of polarisation for that of `stokes`. Of
    several channels the mean, but a degree of each in the profile; transmission is
    drawn in a second row if any was received.

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
    figure = new_figure(path, figsize=(12, 4 * len(shown) + 3.8))
    above, below = figure.subfigures(2, 1, height_ratios=(1.05 * len(shown), 1))
    from .polar_map import add_legend

    maps: list[Any] = []
    blocks = above.subfigures(len(shown), 1, squeeze=False)[:, 0]
    for of, block in zip(shown, blocks):
        axes = block.subplots(1, 4)
        _draw_state(block, axes, single, of, vector)
        block.suptitle(NAMES[of], size="medium", x=0.02, ha="left")
        maps += [*axes]
    add_legend(above, maps, loc="outside upper right")
    powers, degrees = below.subplots(1, 2)
    _draw_s_and_p(powers, single, shown)
    _draw_degree(degrees, single, shown, vector)
    below.supxlabel(plane_text(single), size="medium")
    numbers = ", ".join(f"{x:g}" for x in vector)
    title = figure_title(record, index, vector)
    title += f"\nincident Stokes vector ({numbers}), {GRID}"
    return finished(figure, path, title)


def _over(values: Floats, light: Floats) -> Floats:
    """Values over light; NaN in the dark."""
    lit = light > MIN_LIGHT * np.max(light, initial=0)
    return np.where(lit, values, np.nan) / np.where(lit, light, 1.0)


def _draw_state(
    figure: Any, axes: Sequence[Any], single: Record, of: str, vector: Floats
) -> None:
    """Draw maps of the four numbers of a state of polarisation."""
    from matplotlib.colors import Normalize

    from .polar_map import bar_label, border_note, colour_bar, draw_patches, scale_of

    light, q, u, v = np.moveaxis(single.stokes(vector, of)[0].mean(axis=-2), -1, 0)
    degree = _over(np.sqrt(q**2 + u**2 + v**2), light)
    circular = _over(v, light)
    linear = _over(np.hypot(q, u), light)
    angle = np.degrees(np.arctan2(u, q)) / 2
    angle = np.where(linear > MIN_DEGREE, angle, np.nan)
    most, most_circular = (
        float(np.max(np.abs(x), initial=0, where=~np.isnan(x)))
        for x in (degree, circular)
    )
    ends = max(most_circular, MIN_DEGREE)
    to_most, signed = Normalize(0, max(most, MIN_DEGREE)), Normalize(-ends, ends)
    of_degree = f"degree of polarisation, at most {most:.2g}"
    of_circular = f"circular part V / I, |V / I| at most {most_circular:.2g}"
    states = [
        (light, scale_of(light[light > 0]), "viridis", bar_label(single, of)),
        (degree, to_most, "magma", of_degree),
        (angle, Normalize(-90, 90), "twilight", "angle from s to p (degrees)"),
        (circular, signed, "RdBu_r", of_circular),
    ]
    note = border_note(single)
    for place, (values, scale, colours, label) in zip(axes, states):
        mesh = draw_patches(place, single, of, scale, note, colours, values=values)
        bar = place.inset_axes((0.05, -0.06, 0.9, 0.05))
        where = {"cax": bar, "orientation": "horizontal"}
        if values is not light:  # whose scale may be logarithmic
            ticks = np.linspace(scale.vmin, scale.vmax, 5)
            where |= {"ticks": ticks, "format": "%.2g"}
        colour_bar(figure, mesh, None, label, **where)


def _draw_s_and_p(axes: Any, single: Record, shown: Sequence[str]) -> None:
    """Draw the power of light that is polarised along s and along p."""
    for of in shown:
        # wider below, which shows beside the other where both are the same
        styles = ("C0", 2.0), ("C3", 1.0)
        for (colour, width), (name, vector) in zip(styles, POLARISED.items()):
            power, error = (
                one[..., 0].mean(axis=-1, keepdims=True)
                for one in single.stokes(vector, of)
            )
            limits = statistics.student_interval(power, error, single.n_batches, LEVEL)
            cut = cut_profile(single, of, power, *limits)
            label = f"{of.upper()}, incident light along {name}"
            _draw(axes, cut, 0, colour, of, label, width)
    several = f", mean of {len(single.channels)} channels"
    label = " and ".join(of.upper() for of in shown)
    axes.set_ylabel(f"{label}{several if len(single.channels) > 1 else ''} (1/sr)")
    _finish(axes, single)


def _draw_degree(
    axes: Any, single: Record, shown: Sequence[str], vector: Floats
) -> None:
    """Draw the degree of polarisation for light of a Stokes vector, per channel."""
    for of in shown:
        limits = single.degree_interval(vector, LEVEL, of)
        cut = cut_profile(single, of, single.degree(vector, of)[0], *limits)
        for channel, colour in enumerate(colours_of(single.channels)):
            name = single.channels[channel] if len(single.channels) > 1 else ""
            label = ", ".join(filter(None, (NAMES[of].lower(), name)))
            _draw(axes, cut, channel, colour, of, label)
    axes.set_ylabel("degree of polarisation")
    _finish(axes, single)
    axes.set_ylim(0, max(axes.get_ylim()[1], MIN_DEGREE))


def _draw(
    axes: Any,
    cut: Profile,
    channel: int,
    colour: Any,
    of: str,
    label: str,
    width: float = 1.0,
) -> None:
    """Draw a curve with its name."""
    draw_curve(axes, cut, channel, colour, of, width)
    filling = None if of == "brdf" else "w"
    style = {"marker": "o", "ms": 3 * width, "lw": width, "mfc": filling}
    axes.plot([], [], c=colour, label=label, **style)


def _finish(axes: Any, single: Record) -> None:
    """Draw the parts common to both profiles."""
    axes.plot([], [], marker="|", ms=9, c=GREY, ls="none", label=bars_text(single))
    set_angles(axes)
    axes.set_ylim(0, None)
    axes.legend(frameon=False, fontsize="small")

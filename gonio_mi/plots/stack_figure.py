"""A stack of records as a sheet of maps, or as an animation, on one colour scale."""

from __future__ import annotations

import math
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import abridged
from ..files import check_output, replacing
from ..progress import bar
from ..results.record import Record
from .drawable import (
    ANIMATION_ENDINGS,
    FIGURE_ENDINGS,
    check_matplotlib,
    save_picture,
    set_title,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["animation", "sheet"]

# Maps that a sheet has room for, and frames that make an animation long enough.
MOST_MAPS, MOST_FRAMES = 24, 60
FRAMES_PER_SECOND = 4
# Inches at the right of a frame for the colour bar with its numbers and its name.
BAR = 1.1
NAMES = {"brdf": "Reflection", "btdf": "Transmission"}
GRID = "circles: θₒ = 30°, 60°; φₒ = 0° to the right"


def sheet(record: Record, path: str | PathLike[str] | None = None) -> Figure:
    """Draw the maps of all incident directions of a stack, on one colour scale.

    Reflection above, transmission below if any was received. Of more than 24
    maps evenly chosen directions are drawn, and the title says so.

    Parameters
    ----------
    record : Record
    path : str or path, optional
        Ends in ``.pdf``, ``.png`` or ``.svg``.

    Returns the matplotlib figure, and raises as :func:`gonio_mi.plot`.
    """
    check_matplotlib()
    from .figure import NotebookFigure
    from .polar_map import add_bar, add_legend, draw_patches

    if path is not None:
        check_output(path, FIGURE_ENDINGS)
    quantities = _received(record)
    shown = _evenly(record, MOST_MAPS // len(quantities))
    columns = min(len(shown), 6)
    rows = math.ceil(len(shown) / columns)
    size = 2.1 * columns + 1.2, 2.3 * rows * len(quantities) + 0.8
    figure = NotebookFigure(figsize=size, layout="constrained")
    blocks = figure.subfigures(len(quantities), 1, squeeze=False)[:, 0]
    for of, block in zip(quantities, blocks):
        scale = _common_scale(record, of)
        axes = block.subplots(rows, columns, squeeze=False).ravel()
        for place, number in zip(axes, shown):
            mesh = draw_patches(place, record[number], of, scale)
            place.set_title(_direction(record, number), fontsize="small")
        for place in axes[len(shown) :]:
            place.set_axis_off()
        place = axes[columns - 1].inset_axes((1.12, 0, 0.07, 1))
        add_bar(block, mesh, place, record[0], of)
        add_legend(block, axes, loc="outside lower center")
        block.suptitle(f"{NAMES[of]} ({GRID})", fontsize="medium")
    set_title(figure, _title(record, len(shown)))
    if path is not None:
        save_picture(figure, path)
    return figure


def animation(
    record: Record, path: str | PathLike[str], *, progress: bool = False
) -> None:
    """Write the maps of a stack one after the other, on one colour scale, as a GIF.

    Of more than 60 incident directions evenly chosen ones are drawn.

    Parameters
    ----------
    record : Record
    path : str or path
        Ends in ``.gif``.
    progress : bool
        Show a progress bar on standard error.

    Raises as :func:`gonio_mi.plot`.
    """
    check_matplotlib()
    check_output(path, ANIMATION_ENDINGS)
    from PIL import Image  # matplotlib brings it

    shown = _evenly(record, MOST_FRAMES)
    scales = {of: _common_scale(record, of) for of in _received(record)}
    images = []
    with bar(progress, total=len(shown), desc="animation", unit="frame") as report:
        for number in shown:
            images.append(Image.fromarray(_frame(record, number, scales, len(shown))))
            if report is not None:
                report(1)
    with replacing(path) as stream:
        images[0].save(
            stream,
            format="GIF",
            save_all=True,
            append_images=images[1:],
            duration=1000 // FRAMES_PER_SECOND,
            loop=0,
        )


def _frame(record: Record, number: int, scales: dict[str, Any], n_shown: int) -> Any:
    """Pixels of one incident direction, uint8, of the shape (rows, columns, 3)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from .polar_map import add_bar, draw_patches

    width = 4.7 * len(scales)
    figure = Figure(figsize=(width, 4.4), dpi=100)
    canvas = FigureCanvasAgg(figure)
    places = figure.subplots(1, len(scales), squeeze=False)[0]
    for (of, scale), axes in zip(scales.items(), places):
        mesh = draw_patches(axes, record[number], of, scale)
        add_bar(figure, mesh, axes.inset_axes((1.05, 0.1, 0.05, 0.8)), record[0], of)
        axes.set_title(NAMES[of], fontsize="small")
    title = f"{_title(record, n_shown)}\n{_direction(record, number)}"
    set_title(figure, title, "small")
    right = 1 - BAR / width
    figure.subplots_adjust(left=0.02, right=right, top=0.82, bottom=0.03, wspace=0.5)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3]


def _received(record: Record) -> list[str]:
    """The quantities that are worth a map."""
    return ["brdf"] if record.btdf is None or not record.btdf.any() else list(NAMES)


def _evenly(record: Record, most: int) -> list[int]:
    """Numbers of at most that many directions, evenly among those of the stack."""
    n = min(len(record), most)
    return np.unique(np.linspace(0, len(record) - 1, n).round().astype(int)).tolist()


def _common_scale(record: Record, of: str) -> Any:
    """Colour scale of the values of all directions."""
    from .polar_map import scale_of, shown_values

    looks = (record[number] for number in range(len(record)))
    return scale_of(
        np.concatenate([shown_values(one, of)[1].compressed() for one in looks])
    )


def _direction(record: Record, number: int) -> str:
    theta, phi = record.theta_i[number], record.phi_i[number]
    return f"θᵢ = {theta:g}°, φᵢ = {phi:g}°"


def _title(record: Record, n_shown: int) -> str:
    name = " ".join(str(record.settings.get("specimen", "specimen")).split())
    name = abridged(name, 60)
    if n_shown < len(record):
        name += f" ({n_shown} of {len(record)} incident directions)"
    return name

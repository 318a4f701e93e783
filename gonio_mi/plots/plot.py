"""Records as figures: one incident direction, or a stack on one colour scale.

matplotlib is the optional extra ``plot``; it is imported when a figure is drawn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from ..array_types import Floats
from ..errors import LABEL, SettingError, abridged, checked_count
from ..files import check_output, replacing
from ..progress import counted
from ..results.planning import precision
from ..results.record import Record, checked_records
from ..results.tally import sent_text, without_chance
from ..single_precision import ROUNDING
from .figure import (
    ANIMATION_ENDINGS,
    check_matplotlib,
    direction_text,
    evenly,
    finished,
    new_figure,
    set_title,
)
from .profile import draw_profiles

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_TITLE = 80
METHOD_SETTINGS = ("estimator", "sampler")
# Settings that are said where they are not the default.
DEFAULTS = {"period": "none", "order": "all"}
# Maps that a sheet has room for, and those of a row; frames that make an animation long
# enough.
MAX_MAPS, MAX_COLUMNS, MAX_FRAMES = 24, 6, 60
FRAMES_PER_SECOND = 4
# Inches at the right of a frame for the colour bar with its numbers and its name.
BAR_WIDTH = 1.1
NAMES = {"brdf": "Reflection", "btdf": "Transmission"}
GRID = "circles: θₒ = 30°, 60°; φₒ = 0° to the right"


def plot(
    record: Record, path: str | PathLike[str] | None = None, *, index: int = 0
) -> Figure:
    """Draw one figure of a record, and write it if `path` is given.

    Above, the patches of one incident direction in orthographic projection, seen along
    -z: the radius is sin(theta_o), so that equal areas are equal projected solid
    angles; phi_o is 0 to the right and grows counter-clockwise. Colours are linear, or
    logarithmic where values differ by more than a factor of 100, or the largest is more
    than 20 times the median. With several channels they show the mean. Transmission is
    drawn if any was received.

    Below, the profile in the plane of incidence with 95 % intervals: one curve per
    channel, or per incident direction of a stack of up to 8 with one channel. Triangles
    are the upper limits of patches without a hit, dotted lines the mirror directions.
    Where the plane is a border of sectors, it says which ones are drawn.

    Parameters
    ----------
    record : Record
    path : str or path, optional
        Ends in ``.pdf``, ``.png`` or ``.svg``.
    index : int
        Number of the incident direction of a stack.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ImportError
        If matplotlib is not installed.
    ValueError
        If there is no such direction, or for another file ending.
    OSError
        If the file cannot be written.
    """
    single = chosen(record, index)
    shown = received(single)
    figure = new_figure(path, figsize=(7 if len(shown) == 1 else 10, 8))
    from .polar_map import draw_map

    above, below = figure.subfigures(2, 1, height_ratios=(1.3, 1))
    for axes, of in zip(above.subplots(1, len(shown), squeeze=False)[0], shown):
        draw_map(axes, single, of)
    draw_profiles(below.subplots(), record, index, shown)
    return finished(figure, path, figure_title(record, index))


def chosen(record: Record, index: int) -> Record:
    """Record of the incident direction of that number.

    Raises
    ------
    ValueError
        If there is no such direction.
    """
    (record,) = checked_records(record, several=False)
    index = checked_count("index", index, 0)
    if index >= len(record):
        raise SettingError(
            f"index must be below {len(record)}, the number of incident directions, "
            f"got {index}"
        )
    return record[index]


def figure_title(record: Record, index: int, stokes: Floats | None = None) -> str:
    """Four lines: specimen, incident direction, settings, totals.

    The totals are of incident light of the Stokes vector, or unpolarised.
    """
    single, settings = record[index], record.settings
    direction = _direction(record, index)
    if math.isnan(single.theta_i[0]):
        direction = "incident as the emitter"
    if len(record) > 1:
        direction += f" ({index + 1} of {len(record)} directions)"
    facts = [direction, "back side" if record.asked.side == "back" else ""]
    rays = [sent_text(single.tallies)]
    # integrals draw no samples
    words = METHOD_SETTINGS if single.ledger.emitted else METHOD_SETTINGS[:1]
    rays += [f"{settings[key]} {key}" for key in words if key in settings]
    rays += [
        f"{key} {settings[key]}"
        for key, default in DEFAULTS.items()
        if settings.get(key, default) != default
    ]
    lines = [_name(record, MAX_TITLE)]
    lines += [_items([*filter(None, facts), str(record.subdivision)]), _items(rays)]
    totals = [
        _total(of, *_of_light(single, of, stokes))
        for of in ("dhr", "dht")[: single.n_hemispheres]
    ]
    if single.ledger.direct:
        totals.append(_total("direct", single.direct, single.direct_std_err))
    worst, _ = precision(single)
    if stokes is None and 0 < worst < math.inf:
        percent = f"{100 * float(f'{worst:.2g}'):g} %"
        totals.append(f"bright patches ± {percent} at worst")
    if (n := len(single.channels)) > 1:
        totals[0] = f"means of {n} channels: {totals[0]}"
    if any("±" in one for one in totals):
        of = "largest error" if without_chance(single.tallies) else "std_err"
        totals[-1] += f" (± {of})"
    lines.append(_items(totals))
    return "\n".join(lines).encode("utf-8", "backslashreplace").decode()


def _of_light(single: Record, of: str, stokes: Floats | None) -> tuple[Floats, Floats]:
    """Total of each channel and its standard error for incident light."""
    if stokes is None:
        return getattr(single, of), getattr(single, f"{of}_std_err")
    power, error = (one[..., 0] for one in single.stokes(stokes, of))
    return power / stokes[0], error / stokes[0]


def _items(texts: Sequence[str]) -> str:
    """Items of a line that is broken between them only."""
    return ", ".join(text.replace(" ", "\N{NO-BREAK SPACE}") for text in texts)


def _total(name: str, values: Floats, std_errs: Floats) -> str:
    """Mean over the channels, with the standard error of a single channel."""
    if len(values) > 1:
        return f"{name} {values.mean():.4g}"
    value, std_err = float(values[0]), float(std_errs[0])
    if not std_err > 0:
        return f"{name} {value:.4g}"
    std_err = max(std_err, ROUNDING * abs(value))
    decimals = max(0, 1 - math.floor(math.log10(std_err)))
    return f"{name} {value:.{decimals}f} ± {std_err:.{decimals}f}"


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
    quantities = received(record)
    shown = evenly(len(record), MAX_MAPS // len(quantities))
    rows = math.ceil(len(shown) / MAX_COLUMNS)
    columns = math.ceil(len(shown) / rows)
    size = 2.1 * columns + 1.2, 2.3 * rows * len(quantities) + 0.8
    figure = new_figure(path, figsize=size)
    from .polar_map import add_bar, add_legend, draw_patches

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
    return finished(figure, path, _title_of_stack(record, len(shown)))


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

    shown = evenly(len(record), MAX_FRAMES)
    scales = {of: _common_scale(record, of) for of in received(record)}
    images = [
        Image.fromarray(_frame(record, number, scales, len(shown)))
        for number in counted(shown, progress, desc="animation", unit="frame")
    ]
    frames = {"save_all": True, "append_images": images[1:], "loop": 0}
    with replacing(path) as stream:
        images[0].save(stream, "GIF", duration=1000 // FRAMES_PER_SECOND, **frames)


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
    title = f"{_title_of_stack(record, n_shown)}\n{_direction(record, number)}"
    set_title(figure, title, "small")
    right = 1 - BAR_WIDTH / width
    figure.subplots_adjust(left=0.02, right=right, top=0.82, bottom=0.03, wspace=0.5)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3]


def received(record: Record) -> list[str]:
    """The quantities that are worth a map."""
    return ["brdf"] if record.btdf is None or not record.btdf.any() else list(NAMES)


def _common_scale(record: Record, of: str) -> Any:
    """Colour scale of the values of all directions."""
    from .polar_map import scale_of, shown_values

    values = [shown_values(one, of)[1].compressed() for one in record]
    return scale_of(np.concatenate(values))


def _direction(record: Record, number: int) -> str:
    return direction_text(record.theta_i[number], record.phi_i[number])


def _name(record: Record, longest: int) -> str:
    """The specimen in one line."""
    return abridged(" ".join(record.provenance.name.split()), longest)


def _title_of_stack(record: Record, n_shown: int) -> str:
    name = _name(record, LABEL)
    if n_shown < len(record):
        name += f" ({n_shown} of {len(record)} incident directions)"
    return f"{name}\n{sent_text(record.tallies)} over {len(record)} directions"

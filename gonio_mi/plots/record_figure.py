"""A record as one figure: polar maps, and the profile in the plane of incidence.

matplotlib is the optional extra ``plot``; it is imported when a figure is drawn.
"""

import math
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..errors import SettingError, abridged, checked_count
from ..files import check_output
from ..results.integral_sums import sent_text, without_chance
from ..results.precision import precision
from ..results.record import Record
from .drawable import FIGURE_ENDINGS, check_matplotlib, save_picture, set_title
from .profile import draw_profiles

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["plot"]

MAX_TITLE = 80
WORDS = ("estimator", "sampler")
# Settings that are said where they are not the default.
DEFAULTS = {"period": "none", "order": "all"}


def plot(
    record: Record, path: str | PathLike[str] | None = None, *, index: int = 0
) -> "Figure":
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
    check_matplotlib()
    from .figure import NotebookFigure
    from .polar_map import draw_map

    index = checked_count("index", index, 0)
    if index >= len(record):
        raise SettingError(
            f"index must be below {len(record)}, the number of incident directions, "
            f"got {index}"
        )
    if path is not None:
        check_output(path, FIGURE_ENDINGS)
    single = record[index]
    shown = ["brdf"]
    if single.btdf is not None and single.btdf.any():
        shown.append("btdf")

    size = 7 if len(shown) == 1 else 10, 8
    figure = NotebookFigure(figsize=size, layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=(1.3, 1))
    for axes, of in zip(above.subplots(1, len(shown), squeeze=False)[0], shown):
        draw_map(axes, single, of)
    draw_profiles(below.subplots(), record, index, shown)
    set_title(figure, _title(record, index))
    if path is not None:
        save_picture(figure, path)
    return figure


def _title(record: Record, index: int) -> str:
    """Four lines: specimen, incident direction, settings, totals."""
    single, settings = record[index], record.settings
    specimen = " ".join(str(settings.get("specimen", "specimen")).split())
    specimen = abridged(specimen, MAX_TITLE)
    direction = f"θᵢ = {single.theta_i[0]:g}°, φᵢ = {single.phi_i[0]:g}°"
    if math.isnan(single.theta_i[0]):
        direction = "incident as the emitter"
    if len(record) > 1:
        direction += f" ({index + 1} of {len(record)} directions)"
    facts = [direction, "back side" if settings.get("side") == "back" else ""]
    rays = [sent_text(single.tallies)]
    words = WORDS if single.ledger.emitted else WORDS[:1]  # integrals draw no samples
    rays += [f"{settings[key]} {key}" for key in words if key in settings]
    rays += [
        f"{key} {settings[key]}"
        for key, default in DEFAULTS.items()
        if settings.get(key, default) != default
    ]
    lines = [
        specimen,
        ", ".join(filter(None, facts)) + ", " + str(record.subdivision),
        ", ".join(rays),
    ]
    totals = [_total("dhr", single.dhr, single.dhr_std_err)]
    if single.dht is not None and single.dht_std_err is not None:
        totals.append(_total("dht", single.dht, single.dht_std_err))
    if single.ledger.direct:
        totals.append(_total("direct", single.direct, single.direct_std_err))
    worst, _ = precision(single)
    if 0 < worst < math.inf:
        totals.append(f"bright patches ±\N{NO-BREAK SPACE}{100 * worst:.2g} % at worst")
    lines.append(", ".join(totals))
    if "±" in lines[-1]:
        of = "largest error" if without_chance(single.tallies) else "std_err"
        lines[-1] += f" (± {of})"
    return "\n".join(lines).encode("utf-8", "backslashreplace").decode()


def _total(
    name: str, values: NDArray[np.float64], std_errs: NDArray[np.float64]
) -> str:
    """Mean over the channels, with the standard error of a single channel."""
    if len(values) > 1:
        return f"{name} {values.mean():.4g}, mean of {len(values)} channels"
    value, std_err = float(values[0]), float(std_errs[0])
    if not std_err > 0:
        return f"{name} {value:.4g}"
    decimals = max(0, 1 - math.floor(math.log10(std_err)))
    words = f"{name} {value:.{decimals}f} ± {std_err:.{decimals}f}"
    return words.replace(" ", "\N{NO-BREAK SPACE}")

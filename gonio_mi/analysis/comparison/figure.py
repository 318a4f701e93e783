"""Picture of a comparison: both curves with error bars, and their scores below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...array_types import Flags, Floats, Integers
from ...errors import LABEL, abridged
from ...plots.figure import direction_text, evenly, new_figure, set_title

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Panels that are drawn, evenly among all, and in a row.
MAX_PANELS, MAX_COLUMNS = 6, 3

# Values whose largest is so many times the smallest are drawn on a logarithmic axis.
MAX_LINEAR_RANGE = 100

# Azimuths closer than this, in degrees, are the same.
AZIMUTH_TOLERANCE = 1e-3

# Of bars and markers of both curves.
BARS = {"markeredgewidth": 0.8, "elinewidth": 0.8, "capsize": 2}

# Of the record, of what it is compared with, and of scores.
COLOURS = {"record": "C0", "other": "0.6", "z": "0.45"}


def comparison_figure(comparison: Any) -> Figure:
    """Draw both curves of a comparison with error bars, and their scores below.

    One panel per incident direction, channel and hemisphere, up to six, evenly among
    all, with the points of the two half-planes next to the plane of incidence over the
    signed polar angle: positive on the mirror direction's side. Points that do not line
    up are drawn over theta_o. A hemisphere that is dark in both is left out. A table
    with hardly more than a point for each incident direction has one panel per channel,
    over theta_i. All panels are linear, or all are logarithmic; the title says what is
    left out.

    Raises ImportError without Matplotlib.
    """
    panels = _panels(comparison)
    shown = [panels[number] for number in evenly(len(panels), MAX_PANELS)]
    columns = min(len(shown), MAX_COLUMNS)
    rows = -(-len(shown) // columns)
    figure = new_figure(None, figsize=(5.2 * columns + 0.8, 4.6 * rows + 1))
    axes = figure.subplots(
        2 * rows, columns, squeeze=False, sharex=False, height_ratios=(3, 1) * rows
    )
    above, below = axes[::2].ravel(), axes[1::2].ravel()
    for curves, scores, panel in zip(above, below, shown):
        _draw(comparison, panel, curves, scores)
    for left_over in (*above[len(shown) :], *below[len(shown) :]):
        left_over.remove()
    points = np.concatenate([panel.points for panel in shown])
    drawn = np.concatenate([comparison.other[points], comparison.value[points]])
    # what is not positive would be drawn nowhere
    if drawn.min() > 0 and drawn.max() > MAX_LINEAR_RANGE * drawn.min():
        for curves in above[: len(shown)]:
            curves.set_yscale("log", nonpositive="clip")
    parts = (part.get_legend_handles_labels() for part in axes[:2, 0])
    handles = [[*of_curves, *of_z] for of_curves, of_z in zip(*parts)]
    n_legends = min(3, columns)
    figure.legend(*handles, loc="outside lower center", ncols=n_legends, frameon=False)
    for row in range(rows):
        axes[2 * row, 0].set_ylabel(f"{quantity_of(comparison.theta_o[points])} (1/sr)")
        less = ", less the\npatches' variation" if comparison.within_patches else ""
        axes[2 * row + 1, 0].set_ylabel(f"z of the\ndifference{less}", size="small")
    said = f"{conclusion(comparison)}: {p_text(comparison.p_value, 2)}"
    title = f"{said}, rms {comparison.rms:.3g} 1/sr"
    if len(panels) > len(shown):
        title += f"; {len(shown)} of {len(panels)} panels are shown"
    if len(points) < len(comparison.z):
        title += f"; {len(points)} of {len(comparison.z)} points"
    set_title(figure, title)
    return figure


def conclusion(comparison: Any) -> str:
    """The verdict in words: means over patches decide no more than they can."""
    if comparison.verdict == "undecided":
        return "cannot be decided with these patches"
    if comparison.verdict == "differ":
        return "DIFFER"
    within = " within what these patches can decide"
    return f"agree{within if comparison.within_patches else ''}"


def quantity_of(theta_o: Floats) -> str:
    """BRDF or BTDF, if all exit angles in degrees are of one hemisphere, or BSDF."""
    lower = theta_o > 90
    return "BTDF" if lower.all() else "BSDF" if lower.any() else "BRDF"


def p_text(p: float, digits: int = 3) -> str:
    """A probability in words: one of 0 is below the smallest normal number."""
    return f"p < {np.finfo(float).tiny:.0g}" if p == 0 else f"p = {p:.{digits}g}"


@dataclass
class _Panel:
    """Numbers of the points of a panel, their abscissas, and what is written there."""

    points: Integers
    x: Floats
    title: str
    label: str
    line: str = "-"


def _panels(comparison: Any) -> list[_Panel]:
    """One for each incident direction, channel and hemisphere, or for each channel."""
    lower = comparison.theta_o > 90
    lit = (comparison.value != 0) | (comparison.other != 0)
    columns = (comparison.theta_i, comparison.phi_i, comparison.channel, lower)
    distinct = list(dict.fromkeys(zip(*(column.tolist() for column in columns))))
    if len(distinct) > 1 and len(comparison.theta_i) < 2 * len(distinct):
        label = "θᵢ (degrees), all points"
        each = dict.fromkeys(comparison.channel.tolist())
        of_each = [(np.flatnonzero(comparison.channel == one), one) for one in each]
        return [_Panel(k, comparison.theta_i[k], one, label, "") for k, one in of_each]
    shown = {*lower[lit].tolist()} or {*lower.tolist()}
    sides = ("reflection", "transmission") if len(shown) > 1 else ()
    return [_profile(comparison, sides, *one) for one in distinct if one[-1] in shown]


def _profile(
    comparison: Any,
    sides: Sequence[str],
    theta_i: float,
    phi_i: float,
    channel: str,
    lower: bool,
) -> _Panel:
    """One incident direction, channel and hemisphere, which is named if both are."""
    own = (comparison.theta_i == theta_i) & (comparison.phi_i == phi_i)
    own &= (comparison.channel == channel) & ((comparison.theta_o > 90) == lower)
    points = np.flatnonzero(own)
    theta_o, phi_o = comparison.theta_o[points], comparison.phi_o[points]
    if lower:
        theta_o = 180 - theta_o
    x, in_plane, label = points_in_profile(theta_o, phi_o, phi_i)
    title = f"{direction_text(theta_i, phi_i)}, {channel}"
    title += f", {sides[lower]}" if sides else ""
    label = f"180° - {label}" if lower else label
    return _Panel(points[in_plane], x[in_plane], title, label)


def _draw(comparison: Any, panel: _Panel, above: Axes, below: Axes) -> None:
    """Values of a panel, and their scores."""
    points, x = panel.points, panel.x
    order = np.argsort(x, kind="stable")
    points, x = points[order], x[order]
    first, second = comparison.labels
    for name, of, values, errors, style, face in (
        (second, "other", comparison.other, comparison.other_std_err, "s", "none"),
        (first, "record", comparison.value, comparison.std_err, "o", None),
    ):
        # wide below narrow: curves that agree are both seen
        size, width = (7, 2.5) if of == "other" else (3, 0.8)
        own = {"markersize": size, "linewidth": width, "markerfacecolor": face}
        own |= {"color": COLOURS[of], "label": f"{abridged(name, LABEL)} +- std_err"}
        bars = x, values[points], np.nan_to_num(errors[points])
        above.errorbar(*bars, fmt=f"{panel.line}{style}", **BARS, **own)
    above.set_title(panel.title, fontsize="small")
    above.tick_params(labelbottom=False)
    z = comparison.z[points]
    most = "at least " if comparison.within_patches else ""
    below.axhspan(-2, 2, color="0.9", label=f"{most}95 % of z if both agree")
    below.axhline(0, color="0.5", linewidth=0.8)
    below.plot(x, z, "o", markersize=3, color=COLOURS["z"])
    below.set_xlim(above.get_xlim())
    reach = max(3.5, 1.1 * np.abs(z).max())
    below.set_ylim(-reach, reach)
    below.set_xlabel(panel.label)


def points_in_profile(
    theta_o: Floats, phi_o: Floats, phi_i: float
) -> tuple[Floats, Flags, str]:
    """Abscissa of each point, which points lie in the profile, and the axis label.

    All angles are in degrees, `theta_o` and `phi_o` of shape ``(n,)``.
    """
    ahead = _turn(phi_o - phi_i - 180)
    back = _turn(phi_o - phi_i)
    nearest = [
        angle[np.argmin(np.abs(angle) - AZIMUTH_TOLERANCE * np.sign(angle))]
        for angle in (ahead, back)
    ]
    on_pole = np.minimum(theta_o, 180 - theta_o) < AZIMUTH_TOLERANCE
    forward = np.abs(_turn(ahead - nearest[0])) < AZIMUTH_TOLERANCE
    backward = np.abs(_turn(back - nearest[1])) < AZIMUTH_TOLERANCE
    # a half-plane on the other's side is no half-plane of its own
    forward &= abs(nearest[0]) <= 90
    backward &= abs(nearest[1]) <= 90
    chosen = forward | backward | on_pole
    if chosen.sum() < min(3, len(theta_o)):
        return theta_o, np.ones(len(theta_o), bool), "θₒ (degrees), all points"
    azimuths = [
        f"{sign} at φₒ = {(phi_i + turn + angle) % 360:.4g}°"
        for sign, turn, angle, there in (
            ("positive", 180, nearest[0], forward),
            ("negative", 0, nearest[1], backward),
        )
        if there.any()
    ]
    label = f"θₒ (degrees), {', '.join(azimuths)}"
    return np.where(backward & ~forward, -theta_o, theta_o), chosen, label


def _turn(angle: Floats) -> Floats:
    """Angle in degrees in [-180, 180)."""
    return (angle + 180) % 360 - 180

"""Drawing the patches of one hemisphere in orthographic projection."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib import colors
from matplotlib.axes import Axes
from matplotlib.collections import Collection, PolyCollection
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke

from ..array_types import Floats
from ..collector import RingsAndSectors, Subdivision
from ..results.record import Record
from .profile import BORDER_TOLERANCE, drawn_in_rings, sectors_beside

# Ratios of the largest value to the smallest, and to the median, above which the scale
# is logarithmic.
MIN_LOG_RANGE, MIN_LOG_PEAK = 100, 20
# Values below this fraction of the largest one have the darkest colour.
MIN_RELATIVE_VALUE = 1e-6
# Degrees of azimuth in which the edge of a patch is drawn as a straight line.
MAX_CHORD_DEG = 1
NO_HIT = "0.8"
# Half the width of a map in radii of its circle; marks at the horizon are not cut.
HALF_WIDTH = 1.08
# Polar angles in degrees that are drawn as circles.
CIRCLES = (30, 60, 90)


def draw_map(axes: Axes, single: Record, of: str) -> None:
    """Draw the patches of one hemisphere with grid, directions and colour bar.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    single : Record
        Of one incident direction.
    of : {"brdf", "btdf"}
    """
    _, mean = shown_values(single, of)
    scale = scale_of(mean.compressed())
    mesh = draw_patches(axes, single, of, scale, border_note(single))
    add_bar(axes.figure, mesh, axes.inset_axes((1.16, 0.1, 0.045, 0.8)), single, of)
    _label_grid(axes)
    add_legend(axes, [axes], loc="upper center", bbox_to_anchor=(0.5, -0.05))
    title = {"brdf": "Reflection", "btdf": "Transmission"}[of]
    axes.set_title(title, pad=12)  # above the azimuth


def add_legend(place: Any, maps: Iterable[Axes], **where: Any) -> None:
    """Add a one-row legend of the maps' marks to `place` (axes or figure)."""
    marks: dict[str, Any] = {}
    for axes in maps:
        handles, labels = axes.get_legend_handles_labels()
        marks |= dict(zip(labels, handles))
    if marks:
        where |= {"frameon": False, "fontsize": "small", "handletextpad": 0.3}
        place.legend(marks.values(), marks.keys(), ncols=3, columnspacing=1.5, **where)


def shown_values(
    single: Record, of: str, values: Floats | None = None
) -> tuple[RingsAndSectors | None, np.ma.MaskedArray[Any, Any]]:
    """Rings and sectors, and the mean over channels in them, masked without a hit.

    `values` of the patches, shape ``(n_theta, n_phi)``, replace the quantity; they are
    masked where NaN. Apertures have no rings; their values are in one column.
    """
    shown = getattr(single, of) if values is None else values[..., None]
    empty = single.without_hit[int(of == "btdf"), ..., None]
    patches, rings = single.subdivision, None
    if patches.aperture_half_angle is None:
        rings, means = drawn_in_rings(patches, shown)
        _, empty = drawn_in_rings(patches, empty)
    else:
        means, empty = shown[: patches.n_detectors], empty[: patches.n_detectors]
    means = means.mean(axis=-1)
    masked = empty[..., 0] if values is None else empty[..., 0] | np.isnan(means)
    return rings, np.ma.masked_array(means, mask=masked)


def scale_of(values: Floats) -> colors.Normalize:
    """Colour scale from zero to the largest value, or logarithmic."""
    positive = values[values > 0]
    if positive.size == 0:
        return colors.Normalize(0, 1)
    low, high = positive.min(), positive.max()
    if high > MIN_LOG_RANGE * low or high > MIN_LOG_PEAK * np.median(positive):
        return colors.LogNorm(max(low, MIN_RELATIVE_VALUE * high), high, clip=True)
    return colors.Normalize(0, high)


def draw_patches(
    axes: Axes,
    single: Record,
    of: str,
    scale: colors.Normalize,
    note: str = "",
    colours: str = "viridis",
    *,
    values: Floats | None = None,
) -> Collection:
    """Fill each patch with the colour of its value, and draw circles and directions.

    `note` follows the name of the mirror direction, or of that straight through;
    `values` are drawn instead of the quantity `of`.
    """
    rings, shown = shown_values(single, of, values)
    style: dict[str, Any] = {"norm": scale, "cmap": colours, "rasterized": True}
    mesh: Collection
    if rings is None:
        axes.add_patch(Circle((0, 0), 1, color=NO_HIT, lw=0))
        # drawn with a line, so that the narrowest are seen
        mesh = PolyCollection(
            _rims(single.subdivision), edgecolors="face", linewidths=1, **style
        )
        mesh.set_array(shown.ravel())
        axes.add_collection(mesh)
    else:
        pieces = math.ceil(360 / rings.n_phi / MAX_CHORD_DEG)
        steps = np.arange(rings.n_phi * pieces + 1) / pieces
        phi = np.interp(steps, np.arange(rings.n_phi + 1), rings.phi_edges)
        radius = np.sin(rings.theta_edges)[:, None]
        x, y = radius * np.cos(phi), radius * np.sin(phi)
        mesh = axes.pcolormesh(x, y, np.ma.repeat(shown, pieces, axis=1), **style)
    mesh.set_cmap(mesh.get_cmap().with_extremes(bad=NO_HIT))
    circle = np.radians(np.arange(361))
    for theta in CIRCLES:
        size = math.sin(math.radians(theta))
        style = {"c": "0.2", "lw": 0.8} if theta == 90 else {"c": "w", "lw": 0.4}
        axes.plot(size * np.cos(circle), size * np.sin(circle), **style)
    _mark_directions(axes, single, of, note)
    grey = ["no aperture"] if rings is None else []
    grey += ["no hit"] if shown.mask.any() else []
    for label in grey:
        axes.plot([], [], "s", color=NO_HIT, label=label)
    limits = -HALF_WIDTH, HALF_WIDTH
    axes.set(aspect="equal", xlim=limits, ylim=limits)
    axes.set_axis_off()
    return mesh


def _rims(patches: Subdivision) -> Floats:
    """Rims of apertures seen along -z, shape ``(n, points, 2)``."""
    theta, phi = (angle[:-1] for angle in patches.middles)
    half, turn = float(patches.cells[0, 1]), np.radians(np.arange(360))
    across = math.sin(half) * np.cos(turn) * np.cos(theta)
    across += math.cos(half) * np.sin(theta)
    along = math.sin(half) * np.sin(turn)
    x = across * np.cos(phi) - along * np.sin(phi)
    y = across * np.sin(phi) + along * np.cos(phi)
    return np.stack([x, y], axis=-1)


def add_bar(
    figure: Any, mesh: Collection, place: Axes, single: Record, of: str
) -> None:
    """Draw the colour bar of a map into the axes `place`."""
    colour_bar(figure, mesh, None, bar_label(single, of), cax=place)


def bar_label(single: Record, of: str) -> str:
    """Name of the quantity of a map, with its unit."""
    label = of.upper()
    if len(single.channels) > 1:
        label += f", mean of {len(single.channels)} channels"
    return f"{label} (1/sr)"


def colour_bar(
    figure: Any, mesh: Collection, beside: Any, label: str, **place: Any
) -> None:
    """Draw a colour bar `beside` axes, or at the place of matplotlib's keywords."""
    bar = figure.colorbar(mesh, ax=beside, **place)
    bar.set_label(label)
    bar.outline.set_linewidth(0.5)


def _label_grid(axes: Axes) -> None:
    """Write the angles of the circles, and draw ticks of phi_o."""
    style: dict[str, Any] = {"color": "w", "size": "x-small", "va": "center"}
    for theta in CIRCLES[:-1]:
        radius = math.sin(math.radians(theta))
        at = radius * math.cos(math.radians(75)), radius * math.sin(math.radians(75))
        style |= {"ha": "center", "path_effects": _outlined(1.5)}
        axes.annotate(f"{theta}°", at, **style)
    for phi in range(0, 360, 30):
        x, y = math.cos(math.radians(phi)), math.sin(math.radians(phi))
        axes.plot([x, 1.025 * x], [y, 1.025 * y], c="0.2", lw=0.8)
        if phi % 90 == 0:
            text = r"$\varphi_o$ = 0°" if phi == 0 else f"{phi}°"
            ha = ("left", "center", "right", "center")[phi // 90]
            va = ("center", "bottom", "center", "top")[phi // 90]
            axes.annotate(text, (1.05 * x, 1.05 * y), size="small", ha=ha, va=va)


def border_note(single: Record) -> str:
    """Note of a mirror direction that lies on the border of a sector or ring."""
    patches, theta = single.subdivision, np.radians(single.theta_i[0])
    if not isinstance(patches, RingsAndSectors) or np.isnan(theta):
        return ""
    rings = np.abs(np.asarray(patches.theta_edges)[1:-1] - theta)
    on_ring = rings.min(initial=np.inf) < BORDER_TOLERANCE
    on_border = theta > 0 and (on_ring or sectors_beside(single))
    return ", on a border of patches" if on_border else ""


def _mark_directions(axes: Axes, single: Record, of: str, note: str) -> None:
    """Mark the incident direction, and the mirror or straight-through direction."""
    theta, phi = np.radians([single.theta_i[0], single.phi_i[0]])
    if np.isnan(theta) or np.isnan(phi):
        return
    x, y = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi)
    style = {"ls": "none", "c": "tab:red", "mfc": "none", "ms": 9, "mew": 1.5}
    style |= {"path_effects": _outlined(3, "w"), "clip_on": False}
    if of == "brdf":
        axes.plot(x, y, marker="o", label="incident", **style)
        axes.plot(-x, -y, marker="D", label=f"mirror direction{note}", **style)
    else:
        axes.plot(-x, -y, marker="D", label=f"straight through{note}", **style)


def _outlined(width: float, colour: str = "0.15") -> list[withStroke]:
    """Effect that keeps marks readable on any colour."""
    return [withStroke(linewidth=width, foreground=colour)]

"""The profile of a record in the plane of incidence, and its drawing.

Also the rings and sectors that stand for other patches in a drawing.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..array_types import Flags, Floats
from ..collector import Borders, RingsAndSectors, Subdivision
from ..collector.directions import direction
from ..collector.shirley_chiu import ShirleyChiu
from ..results.record import Record
from ..results.tally import without_chance

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEVEL = 0.95
# Number of patches above which intervals are drawn as a band.
MAX_POINTS = 200
# Largest number of incident directions in one profile.
MAX_CURVES = 8
# Ratio of the largest to the smallest value above which the axis is logarithmic.
MIN_LOG_RANGE = 100
# A logarithmic axis begins at this fraction of the largest value, or above.
MIN_RELATIVE_VALUE = 1e-9
# Ratio of the largest to the smallest value below which the axis omits zero.
MIN_ZERO_RANGE = 1.5
# Colour of marks that several curves share.
GREY = "0.4"
# Smallest span of the axis, relative to the values; less is rounding.
MIN_RANGE = 0.01
# Steps in degrees of the rings and sectors that stand for other patches.
FINE_STEP_DEG = 1

# Radians within which a direction is on a border of patches: those of 2^-20.
BORDER_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Profile:
    """Patches cut by the plane of incidence, from theta_o = -90 to 90 degrees.

    Attributes
    ----------
    edges : ndarray, shape (n + 1,)
        Edges of the patches, theta_o in degrees; negative on the side of the source.
    theta : ndarray, shape (n,)
        Middles of the patches in degrees.
    value, low, high : ndarray, shape (n, channels)
        Patch means in 1/sr and their intervals; NaN between apertures.
    empty : ndarray of bool, shape (n, channels)
        Where nothing arrived: `high` is an upper limit, or NaN between apertures.
    """

    edges: Floats
    theta: Floats
    value: Floats
    low: Floats
    high: Floats
    empty: Flags


def bars_text(record: Record) -> str:
    """Name of the error bars of a profile."""
    if without_chance(record.tallies):
        return "largest error, estimated"
    return f"{100 * LEVEL:g} % interval"


def profile(single: Record, of: str = "brdf") -> Profile:
    """Return the :class:`Profile` of a record of one incident direction.

    It follows the sectors that contain phi_i and phi_i + 180 degrees.

    Parameters
    ----------
    single : Record
    of : {"brdf", "btdf"}
    """
    return cut_profile(single, of, getattr(single, of), *single.interval(LEVEL, of=of))


def cut_profile(
    single: Record, of: str, value: Floats, low: Floats, high: Floats
) -> Profile:
    """Return the :class:`Profile` of a quantity of the patches, and its limits.

    Those of each channel, or one of all, ``(n_theta, n_phi, 1)``.
    """
    dark = single.estimates[0].patches(int(of == "btdf")).dark
    if value.shape[-1] == 1:
        dark = np.all(dark, axis=-1, keepdims=True)
    arrays = value, low, high, dark
    phi_i = float(np.radians(np.nan_to_num(single.phi_i[0])))
    if single.subdivision.aperture_half_angle is not None:
        return _cones_in_plane(single.subdivision, phi_i, arrays)
    if isinstance(single.subdivision, ShirleyChiu):
        return _runs_in_plane(single.subdivision, phi_i, arrays)
    patches, _ = drawn_in_rings(single.subdivision, single.brdf)
    towards, beyond = (
        int(patches.patch([math.cos(phi), math.sin(phi), 1])) % patches.n_phi
        for phi in (phi_i, phi_i + np.pi)
    )

    def cut(values: NDArray[Any]) -> NDArray[Any]:
        _, array = drawn_in_rings(single.subdivision, values)
        return np.concatenate([array[::-1, towards], array[:, beyond]])

    edges, theta = np.degrees(patches.theta_edges), np.degrees(patches.theta)
    return Profile(
        np.concatenate([-edges[:0:-1], edges]),
        np.concatenate([-theta[::-1], theta]),
        *map(cut, arrays),
    )


def _cones_in_plane(
    patches: Subdivision, phi_i: float, arrays: Iterable[NDArray[Any]]
) -> Profile:
    """Profile of the cones that the plane of incidence cuts, one cell for each.

    The gaps between cones are dark and have no upper limit.
    """
    axes = direction(*patches.middles)[:-1, 0]
    beyond = -axes[:, 0] * math.cos(phi_i) - axes[:, 1] * math.sin(phi_i)
    # cosine of the angle between an axis and its projection on the plane
    cosine = np.hypot(beyond, axes[:, 2])
    cos_half = math.cos(patches.cells[0, 1])
    (met,) = np.nonzero(cosine > cos_half)
    theta = np.degrees(np.arctan2(beyond, axes[:, 2]))[met]
    met, theta = met[np.argsort(theta)], np.sort(theta)
    half = np.degrees(np.arccos(cos_half / cosine[met]))
    edges = np.array([-90, *np.stack([theta - half, theta + half], 1).ravel(), 90])
    middles = (edges[1:] + edges[:-1]) / 2

    def cut(values: NDArray[Any]) -> NDArray[Any]:
        flat = values.reshape(-1, values.shape[-1])
        nothing: Any = True if flat.dtype == bool else np.nan
        cells = np.full((len(middles), flat.shape[-1]), nothing)
        cells[1::2] = flat[met]
        return cells

    return Profile(edges, middles, *map(cut, arrays))


def _runs_in_plane(
    patches: ShirleyChiu, phi_i: float, arrays: Iterable[NDArray[Any]]
) -> Profile:
    """Profile of the patches along the plane of incidence, in fine steps."""
    steps = np.arange(-90, 90 + FINE_STEP_DEG, FINE_STEP_DEG, dtype=float)
    middles = np.radians(steps[1:] + steps[:-1]) / 2
    index = patches.patch(direction(np.abs(middles), phi_i + np.pi * (middles > 0)))
    begins = np.flatnonzero(np.diff(index, prepend=-1))
    edges = steps[[*begins, -1]]
    met = index[begins]
    cells = (values.reshape(-1, values.shape[-1])[met] for values in arrays)
    return Profile(edges, (edges[1:] + edges[:-1]) / 2, *cells)


def draw_profiles(
    axes: "Axes", record: Record, index: int, shown: Sequence[str]
) -> None:
    """Draw the profiles of a record on common axes.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    record : Record
        All its incident directions are drawn if there are at most 8 and one channel.
    index : int
        Number of the incident direction to draw otherwise.
    shown : list of {"brdf", "btdf"}
    """
    several = len(record.channels) == 1 and 1 < len(record) <= MAX_CURVES
    cuts, limits = [], []
    for number in range(len(record)) if several else [index]:
        single = record[number]
        colours = [f"C{number}"] if several else colours_of(single.channels)
        if not np.isnan(single.theta_i[0]):
            line = colours[0] if several else GREY
            axes.axvline(single.theta_i[0], c=line, ls=":", lw=1, zorder=0)
        for of in shown:
            cut = profile(single, of)
            cuts.append(cut)
            for channel, colour in enumerate(colours):
                limits += draw_curve(axes, cut, channel, colour, of)
        if several or len(colours) > 1:
            labels = [_direction(record, number)] if several else single.channels
            for colour, label in zip(colours, labels):
                axes.plot([], [], c=colour, label=label)
    _draw_limits(axes, limits)
    values = np.concatenate([cut.value.ravel() for cut in cuts])
    highs = [cut.high[cut.empty] for cut in cuts]
    _scale(axes, values[values > 0], np.concatenate(highs))
    set_angles(axes)
    axes.set_xlabel(plane_text(record[index]))
    axes.set_ylabel(" and ".join(of.upper() for of in shown) + " (1/sr)")
    _add_legend(axes, record[index], cuts, shown)


def draw_curve(
    axes: "Axes", cut: Profile, channel: int, colour: Any, of: str, width: float = 1.0
) -> list[tuple[float, float, Any]]:
    """Draw one channel, `width` times as wide: steps, points with intervals or a band.

    Returns the upper limits that are not in a band: theta, limit and colour of each.
    """
    value, low, high = (a[:, channel] for a in (cut.value, cut.low, cut.high))
    hit = ~cut.empty[:, channel]
    steps = {"baseline": None, "color": colour, "ls": "-" if of == "brdf" else "--"}
    axes.stairs(np.where(hit, value, np.nan), cut.edges, lw=width, alpha=0.5, **steps)
    if cut.theta.size > MAX_POINTS:
        low = np.where(hit, low, np.nan)
        axes.stairs(high, cut.edges, baseline=low, fill=True, alpha=0.3, color=colour)
        return []
    filling = None if of == "brdf" else "w"
    points = {"color": colour, "lw": width, "ms": 3 * width, "mfc": filling}
    errors = np.maximum([value - low, high - value], 0)[:, hit]
    axes.errorbar(cut.theta[hit], value[hit], errors, fmt="o", **points)
    return [(theta, limit, colour) for theta, limit in zip(cut.theta[~hit], high[~hit])]


def _draw_limits(axes: "Axes", limits: list[tuple[float, float, Any]]) -> None:
    """Draw upper limits; those shared by several curves are grey.

    Channels and directions without a hit have the same limit after as many rays.
    """
    from matplotlib.colors import to_hex

    shared: dict[tuple[float, float], set[str]] = {}
    for theta, limit, colour in limits:
        shared.setdefault((theta, limit), set()).add(to_hex(colour))
    places: dict[str, list[tuple[float, float]]] = {}
    for place, colours in shared.items():
        colour = min(colours) if len(colours) == 1 else GREY
        places.setdefault(colour, []).append(place)
    for colour, some in places.items():
        axes.plot(*np.transpose(some), "v", c=colour, ms=4, mfc="none", mew=0.7)


def set_angles(axes: "Axes") -> None:
    """Set the axis of theta_o, and the style common to all profiles."""
    axes.set_xlim(-90, 90)
    axes.set_xticks(range(-90, 91, 30), [f"{theta}°" for theta in range(-90, 91, 30)])
    axes.grid(alpha=0.3, lw=0.5)
    axes.spines[["top", "right"]].set_visible(False)


def plane_text(single: Record) -> str:
    """Name of the axis, and the sectors drawn if the plane is a border of them."""
    text = r"$\theta_o$ in the plane of incidence (negative: towards the source)"
    beside = sectors_beside(single)
    if not beside:
        return text
    drawn = " and ".join(f"{begin:.4g}° to {end:.4g}°" for begin, end in beside)
    border = r"This is a border of sectors: drawn are those of $\varphi_o$ ="
    return f"{text}\n{border} {drawn}"


def _scale(axes: "Axes", positive: Floats, limits: Floats) -> None:
    """Choose the axis of the values: logarithmic, from zero, or close to them.

    `limits`: upper ones of what is not known to be positive.
    """
    if positive.size == 0:
        return
    low, high = positive.min(), positive.max()
    if high > MIN_LOG_RANGE * low:
        axes.set_yscale("log", nonpositive="clip")
        least = min(low, limits[limits > 0].min(initial=low))
        axes.set_ylim(max(least / 3, MIN_RELATIVE_VALUE * high), None)
    elif high > MIN_ZERO_RANGE * low:
        axes.set_ylim(0, None)
    else:
        below, above = axes.get_ylim()
        margin = MIN_RANGE * high / 2
        axes.set_ylim(min(below, low - margin), max(above, high + margin))


def _add_legend(
    axes: "Axes", single: Record, cuts: Sequence[Profile], shown: Sequence[str]
) -> None:
    """Add a legend of curves and marks next to the axes."""
    grey = {"c": GREY, "ls": "none"}
    if len(shown) > 1:
        axes.plot([], [], marker="o", ms=3, label="reflection", **grey)
        axes.plot([], [], marker="o", ms=3, mfc="w", label="transmission", **grey)
    lows = [cut.low[~cut.empty] for cut in cuts]
    if any(low.size and np.isfinite(low).all() for low in lows):
        axes.plot([], [], marker="|", ms=9, label=bars_text(single), **grey)
    if any(np.isfinite(cut.high[cut.empty]).any() for cut in cuts):
        label = "upper limit, no hit"
        axes.plot([], [], marker="v", ms=4, mfc="none", label=label, **grey)
    if not np.isnan(single.theta_i[0]):
        axes.plot([], [], c=GREY, ls=":", lw=1, label="mirror direction")
    if axes.get_legend_handles_labels()[1]:
        axes.legend(
            fontsize="small", frameon=False, loc="center left", bbox_to_anchor=(1, 0.5)
        )


def _direction(record: Record, number: int) -> str:
    """Words for one incident direction of a stack."""
    words = rf"$\theta_i$ = {record.theta_i[number]:g}°"
    if np.ptp(record.phi_i) > 0:
        words += rf", $\varphi_i$ = {record.phi_i[number]:g}°"
    return words


def colours_of(channels: Sequence[str]) -> list[Any]:
    """Colours of the curves of one direction."""
    if len(channels) == 1:
        return ["C0"]
    if tuple(channels) == ("R", "G", "B"):
        return ["tab:red", "tab:green", "tab:blue"]
    from matplotlib import colormaps

    return list(colormaps["turbo"](np.linspace(0.1, 0.9, len(channels))))


def sectors_beside(single: Record) -> list[tuple[float, float]]:
    """Sectors, in degrees, that the profile takes where its plane is a border.

    First that towards the source, then that beyond. Empty if a half-plane lies within
    a sector, or patches have none.
    """
    patches, phi = single.subdivision, np.radians(single.phi_i[0])
    if not isinstance(patches, RingsAndSectors) or np.isnan(phi):
        return []
    edges, found = patches.phi_edges, []
    for azimuth in (phi % (2 * np.pi), (phi + np.pi) % (2 * np.pi)):
        away = np.abs(edges - azimuth)
        if away.min() > BORDER_TOLERANCE:
            return []
        first = int(np.argmin(away)) % patches.n_phi
        begin, end = np.degrees(edges[first : first + 2])
        found.append((float(begin), float(end)))
    return found


def drawn_in_rings(
    patches: Subdivision, values: NDArray[Any]
) -> tuple[RingsAndSectors, NDArray[Any]]:
    """Rings and sectors, and `values` in them; fine ones where patches have none.

    Parameters
    ----------
    patches : Subdivision
        Other than apertures, which leave room between them.
    values : ndarray, shape (..., *patches.shape, channels)
    """
    if not isinstance(patches, ShirleyChiu):
        return patches.in_rings(values)
    steps = tuple(map(float, range(0, 360 + FINE_STEP_DEG, FINE_STEP_DEG)))
    fine = Borders(steps[: 90 // FINE_STEP_DEG + 1], steps)
    index = patches.patch(direction(*fine.middles))
    flat = values.reshape(*values.shape[:-3], -1, values.shape[-1])
    return fine, flat[..., index, :]

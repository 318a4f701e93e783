"""The report on a BSDF: one self-contained HTML file, with pictures of four maps."""

from __future__ import annotations

import html
from collections.abc import Iterator
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from ..array_types import Floats
from ..plots.figure import new_figure
from ..reports.page import (
    check_page,
    coded,
    figure,
    folded,
    preformatted,
    save_page,
    table,
)
from .maps import FourMaps, Scores
from .reproducers import reproducer
from .verdict import FAILS, HOLDS, Property, Verdict

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

# Style of the word that says how a property fares; others are not certain.
STYLES = {FAILS: "background: #c33; color: white", HOLDS: "background: #cec"}
UNCERTAIN = "background: #fd8"

# Scores to which the colours reach, at least and at most, and up to which they are
# linear.
MIN_SCALE, MAX_SCALE, LINEAR = 6, 1000, 2

# Width in inches: a page of 500 pixels shows them without a magnifying glass.
WIDTH = 7.5

LEGEND = (
    "Maps of both hemispheres in 1/sr, seen from the normal: the circle is the "
    "direction to the source, the cross the patch whose score is the worst. Scores z "
    "are normal if nothing is wrong: beyond 5 or so, they are no chance; their colours "
    "are linear up to 2, and logarithmic beyond. Below, counts and integrals "
    "in the plane through that patch, which a line marks; the band is two standard "
    "errors wide on either side of the integral."
)

check_report = check_page


def save_report(verdict: Verdict, path: str | PathLike[str]) -> None:
    """Write verdict, properties and the maps of every incident direction to `path`.

    What fails comes first, and is unfolded: properties, and the directions of maps.

    Raises as :func:`check_report`.
    """
    check_report(path)
    parts = [f"<h1>{html.escape(verdict.name)}</h1>", verdict_view(verdict)]
    if verdict.source is not None:
        parts += [
            folded(
                f"Reproducer: {one.name}", preformatted(reproducer(verdict, one.name))
            )
            for one in verdict.failures
        ]
    if verdict.maps:
        parts.append(f"<p>{LEGEND}</p>")
    shown = [verdict.fails_at(maps) for maps in verdict.maps]
    shown = shown if any(shown) else [i == 0 for i in range(len(shown))]
    rest: list[str] = []
    for maps, own in zip(verdict.maps, shown):
        (parts if own else rest).extend(_pictures(maps))
    if rest:
        n = shown.count(False)
        parts.append(folded(f"{n} more incident directions", *rest))
    save_page(path, verdict.name, parts)


def verdict_view(verdict: Verdict) -> str:
    """Return headline and properties as HTML, for pages and notebooks."""
    failed = verdict.failures
    rest = [one for one in verdict.properties if one not in failed]
    others = table(map(_cells, rest))
    if failed:
        held = table(map(_cells, failed))
        others = held + folded(f"{len(rest)} more properties", others)
    return (
        f"<p><b>{coded(verdict.headline)}</b></p>{others}"
        f"<p><small>{html.escape(str(verdict).splitlines()[-2])}</small></p>"
    )


def _pictures(maps: FourMaps) -> list[str]:
    """Heading and figures of one incident direction."""
    heading = f"<h2>{html.escape(str(maps.condition))}</h2>"
    return [heading, figure(draw(maps)), figure(draw_plane(maps))]


def _cells(one: Property) -> Iterator[str]:
    """Status, name and what was found, as cells of a table."""
    details = [coded(one.statistic)] if one.statistic else []
    if one.status == FAILS:
        details.insert(0, html.escape(str(one.consequence)))
    if one.mistake and one.mistake != one.statistic:
        details.append(f"<b>{coded(one.mistake)}</b>")
    if len(one.places) > 1:
        details.append("also:")
        places = [coded(place) for place in one.places]
        details += [place for place in places if place not in details]
    style = STYLES.get(one.status, UNCERTAIN)
    yield f'<td class="{one.status}" style="{style}">{one.status}</td>'
    yield one.name
    yield "<br>".join([coded(one.question), *(f"<small>{d}</small>" for d in details)])


# --------------------------------------------------------------------------- pictures


def draw(maps: FourMaps) -> Figure:
    """Figure of one :class:`FourMaps`: what is drawn, what is due, and the scores.

    Of directions and of weights, one row for each hemisphere into which anything goes,
    in 1/sr and in orthographic projection; the lit side is the upper row.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.colors import AsinhNorm, Normalize

    comparisons = _comparisons(maps)
    flux = [values for pair in comparisons for _, values in pair[:2]]
    halves = [half for half in (0, 1) if any(one[half].any() for one in flux)] or [0]
    rows = [(half, comparison) for comparison in comparisons for half in halves]
    figure = new_figure(None, figsize=(WIDTH, 0.3 * WIDTH * len(rows)))
    axes = figure.subplots(len(rows), 3, squeeze=False)
    for places, (half, (*pair, (title, z))) in zip(axes, rows):
        scale = Normalize(0, max(values[half].max() for _, values in pair) or 1)
        for place, (name, values) in zip(places, pair):
            mesh = _patches(place, maps, values[half], name, scale)
        figure.colorbar(mesh, ax=places[:2], shrink=0.8, aspect=15)
        top = float(np.clip(np.abs(z).max(), MIN_SCALE, MAX_SCALE))
        scale = AsinhNorm(LINEAR, -top, top)
        worst = f"\nworst {z[_worst(z)]:.3g}"
        mesh = _patches(places[2], maps, z[half], title + worst, scale, "RdBu_r")
        bar = figure.colorbar(mesh, ax=places[2], shrink=0.8, aspect=15)
        inner = min(10, top / 3)
        ticks = [-top, -inner, 0, inner, top]
        bar.set_ticks(ticks, labels=[f"{one:.4g}" for one in ticks])
        bar.minorticks_off()
        _cross(places[2], maps, z, half)
        places[0].set_ylabel("illuminated side" if half == 0 else "other side")
    return figure


def draw_plane(maps: FourMaps) -> Figure:
    """Figure of the plane through the normal and the patch whose score is the worst.

    Two panels, of directions and of weights: what is drawn and what is due, in 1/sr,
    over the polar angle on the worst patch's side of its hemisphere, negative beyond
    the normal. A line marks the patch, a band two standard errors of what is due.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = new_figure(None, figsize=(WIDTH, 0.7 * WIDTH))
    patches = maps.subdivision
    edges = np.degrees(patches.theta_edges)
    edges = np.concatenate([-edges[:0:-1], edges])
    panels = figure.subplots(2, 1), _comparisons(maps), _errors(maps)
    for axes, (*lines, (_, z)), error in zip(*panels):
        half, ring, sector = _worst(z)
        beyond = (sector + patches.n_phi // 2) % patches.n_phi
        drawn, due, wide = (
            np.concatenate([one[half][::-1, beyond], one[half][:, sector]])
            for one in (*(values for _, values in lines), 2 * error)
        )
        band = {"color": "tab:orange", "alpha": 0.2, "lw": 0, "fill": True}
        axes.stairs(due + wide, edges, baseline=np.maximum(due - wide, 0), **band)
        for (title, _), values, style in zip(lines, (drawn, due), ("-", "--")):
            axes.stairs(values, edges, baseline=None, ls=style, label=title)
        axes.axvline(np.degrees(patches.theta[ring]), c="0.6", lw=1, zorder=0)
        side = "illuminated side" if half == 0 else "other side"
        azimuth = f"azimuth {np.degrees(patches.phi[sector]):.0f}°"
        axes.set_title(f"{side}, {azimuth}", fontsize="medium")
        axes.set_xlabel("polar angle in degrees")
        axes.set_ylabel("1/sr")
        axes.legend(frameon=False, fontsize="small")
    return figure


def _errors(maps: FourMaps) -> tuple[Floats, Floats]:
    """Standard errors of counted directions and of summed weights, in 1/sr."""
    shape, solid = (2, *maps.subdivision.shape), maps.subdivision.solid_angles
    due = np.clip(maps.pdf, 0, 1)
    first, second = (
        np.sqrt(variance / maps.totals.n).reshape(shape) / solid
        for variance in (due * (1 - due), np.maximum(maps.due.squares.values, 0))
    )
    return first, second


def _worst(scores: Floats) -> tuple[int, int, int]:
    """Hemisphere, ring and sector of the patch whose score is the worst."""
    half, ring, sector = np.unravel_index(np.abs(scores).argmax(), scores.shape)
    return int(half), int(ring), int(sector)


def _comparisons(maps: FourMaps) -> list[list[tuple[str, Floats]]]:
    """Of directions and of weights: what is drawn, what is due, and the scores.

    A title and values, shape (2, n_theta, n_phi), of each.
    """
    shape = (2, *maps.subdivision.shape)
    solid = maps.subdivision.solid_angles

    def _density(values: Floats) -> Floats:
        return values.reshape(shape) / solid

    def _scores(found: Scores) -> Floats:
        z = np.zeros(int(np.prod(shape)))
        if found.first.size:
            sizes = np.diff(found.first, append=z.size)
            z[:] = np.repeat(np.nan_to_num(found.z), sizes)
        return z.reshape(shape)

    drawn, n = maps.totals, maps.totals.n
    return [
        [
            ("counted directions", _density(drawn.counts / n)),
            ("integral of pdf", _density(maps.pdf)),
            ("z: counted - pdf", _scores(maps.count_scores)),
        ],
        [
            ("summed weights", _density(drawn.sums / n)),
            ("due weights", _density(maps.weights)),
            ("z: weights - due", _scores(maps.weight_scores)),
        ],
    ]


def _cross(axes: Axes, maps: FourMaps, scores: Floats, half: int) -> None:
    """Mark the patch whose score is the worst, if it is in this hemisphere."""
    worst = _worst(scores)
    if worst[0] != half or not scores[worst]:
        return
    theta, phi = maps.subdivision.theta[worst[1]], maps.subdivision.phi[worst[2]]
    x, y = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi)
    axes.plot(x, y, "x", color="black", ms=6)


def _patches(
    axes: Axes,
    maps: FourMaps,
    values: Floats,
    title: str,
    scale: Normalize,
    colours: str = "viridis",
) -> QuadMesh:
    """Fill each patch with the colour of its value, and return the patches."""
    patches = maps.subdivision
    phi = np.linspace(0, 2 * np.pi, 4 * patches.n_phi + 1)
    radius = np.sin(patches.theta_edges)[:, None]
    mesh = axes.pcolormesh(
        radius * np.cos(phi),
        radius * np.sin(phi),
        np.repeat(values, 4, axis=1),
        norm=scale,
        cmap=colours,
        rasterized=True,
    )
    wi = maps.condition.wi
    axes.plot(wi[0], wi[1], "o", mfc="none", mec="tab:red", ms=6)
    axes.set_title(title, fontsize="medium")
    axes.set(aspect="equal", xticks=[], yticks=[], frame_on=False)
    # wider than the circle, whose sides would be cut
    axes.set(xlim=(-1.05, 1.05), ylim=(-1.05, 1.05))
    return mesh

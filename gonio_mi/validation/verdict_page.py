"""The report on a BSDF: one self-contained HTML file, with the four maps in it."""

from __future__ import annotations

import html
from collections.abc import Iterator
from os import PathLike

from ..reports.page import check_page, coded, figure, save_page, table
from .pictures import draw, draw_plane
from .verdict import FAILS, HOLDS, Property, Verdict

__all__ = ["check_report", "save_report", "verdict_view"]

# Style of the word that says how a property fares; others are not certain.
STYLES = {FAILS: "background: #c33; color: white", HOLDS: "background: #cec"}
UNCERTAIN = "background: #fd8"

LEGEND = (
    "Maps of both hemispheres in 1/sr, seen from the normal: the circle is the "
    "direction to the source, the cross the patch whose score is the worst. Scores z "
    "are normal if nothing is wrong: beyond 5 or so, they are no chance. Below, what "
    "is drawn and what is due in the plane through that patch, which a line marks; the "
    "band is two standard errors wide on either side of what is due."
)

check_report = check_page


def save_report(verdict: Verdict, path: str | PathLike[str]) -> None:
    """Write verdict, properties and the maps of every incident direction to `path`.

    Raises as :func:`check_report`.
    """
    check_report(path)
    parts = [f"<h1>{html.escape(verdict.name)}</h1>", verdict_view(verdict)]
    if verdict.maps:
        parts.append(f"<p>{LEGEND}</p>")
    for maps in verdict.maps:
        parts.append(f"<h2>{html.escape(str(maps.condition))}</h2>")
        parts += [figure(draw(maps)), figure(draw_plane(maps))]
    save_page(path, verdict.name, parts)


def verdict_view(verdict: Verdict) -> str:
    """Return headline and properties as HTML, for pages and notebooks."""
    rest = (one for one in verdict.properties if one not in verdict.failures)
    return (
        f"<p><b>{coded(verdict.headline)}</b></p>"
        + table(map(_cells, (*verdict.failures, *rest)))
        + f"<p><small>{html.escape(str(verdict).splitlines()[-2])}</small></p>"
    )


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

"""The report on a BSDF: one self-contained HTML file, with the four maps in it."""

from __future__ import annotations

import html
from os import PathLike

from ..files import check_output, replacing
from ..plots import html_of_figure
from ..plots.drawable import check_matplotlib
from ..reports import html_page
from .pictures import draw, draw_plane
from .verdict import FAILS, Property, Verdict

__all__ = ["check_report", "save_report", "verdict_view"]

STYLE = """
.fails td:first-child { background: #c33; color: white; }
.holds td:first-child { background: #cec; }
.lacks td:first-child, .undecided td:first-child { background: #fd8; }
"""

LEGEND = (
    "Maps of both hemispheres in 1/sr, seen from the normal: the circle is the "
    "direction to the source, the cross the patch whose score is the worst. Scores z "
    "are normal if nothing is wrong: beyond 5 or so, they are no chance. Below, what "
    "is drawn and what is due in the plane through that patch, which a line marks; the "
    "band is two standard errors wide on either side of what is due."
)


def check_report(path: str | PathLike[str]) -> None:
    """Raise one clear sentence unless a report can be made and written to `path`.

    Raises
    ------
    ImportError
        Without Matplotlib.
    ValueError, OSError
        If the ending is not ``.html``, or the file cannot be written.
    """
    check_matplotlib()
    check_output(path, (".html",))


def save_report(verdict: Verdict, path: str | PathLike[str]) -> None:
    """Write verdict, properties and the maps of every incident direction to `path`.

    Raises as :func:`check_report`.
    """
    check_report(path)
    parts = [f"<h1>{html.escape(verdict.name)}</h1>", *_table(verdict)]
    if verdict.maps:
        parts.append(f"<p>{LEGEND}</p>")
    for maps in verdict.maps:
        parts.append(f"<h2>{html.escape(str(maps.condition))}</h2>")
        parts.append(html_of_figure(draw(maps)))
        parts.append(html_of_figure(draw_plane(maps)))
    with replacing(path) as stream:
        stream.write(html_page(verdict.name, parts, STYLE).encode())


def verdict_view(verdict: Verdict) -> str:
    """Return a verdict as HTML for notebooks."""
    return f"<style>{STYLE}</style>" + "".join(_table(verdict))


def _table(verdict: Verdict) -> list[str]:
    """Headline, and one row for each property, as pieces of HTML."""
    return [
        f"<p><b>{_code(verdict.headline)}</b></p>",
        "<table>",
        *(_row(one) for one in verdict.failures),
        *(_row(one) for one in verdict.properties if one not in verdict.failures),
        "</table>",
        f"<p><small>{html.escape(str(verdict).splitlines()[-2])}</small></p>",
    ]


def _row(one: Property) -> str:
    details = [_code(one.statistic)] if one.statistic else []
    if one.status == FAILS:
        details.insert(0, html.escape(str(one.consequence)))
    if one.mistake and one.mistake != one.statistic:
        details.append(f"<b>{_code(one.mistake)}</b>")
    if len(one.places) > 1:
        details.append("also:")
        places = [_code(place) for place in one.places]
        details += [place for place in places if place not in details]
    text = "<br>".join([_code(one.question), *(f"<small>{d}</small>" for d in details)])
    return (
        f'<tr class="{one.status}"><td>{one.status}</td>'
        f"<td>{one.name}</td><td>{text}</td></tr>"
    )


def _code(text: str) -> str:
    """Escaped text, with what stands between backquotes as code."""
    pieces = html.escape(text).split("`")
    return "".join(
        f"<code>{piece}</code>" if i % 2 else piece for i, piece in enumerate(pieces)
    )

"""The one writer of HTML pages, and the pieces that pages and notebooks are made of."""

import base64
import html
import io
from collections.abc import Callable, Iterable
from importlib import resources
from os import PathLike
from typing import Any

from ..errors import PackageError
from ..files import check_output, replacing
from ..plots.figure import check_matplotlib


def check_page(path: str | PathLike[str]) -> None:
    """Raise one clear sentence unless a page can be drawn and written to `path`.

    Raises
    ------
    ImportError
        Without matplotlib.
    ValueError, OSError
        If the ending is not ``.html``, or the file cannot be written.
    """
    check_matplotlib()
    check_output(path, (".html",))


def save_page(path: str | PathLike[str], title: str, body: Iterable[str]) -> None:
    """Write a whole page of pieces of HTML under a title of plain text."""
    style = (resources.files(__package__) / "page.css").read_text("utf-8")
    lines = [
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<link rel="icon" href="data:,">',
        f"<title>{html.escape(title)}</title>",
        f"<style>{style}</style></head><body>",
        *body,
        "</body></html>",
    ]
    with replacing(path) as stream:
        stream.write("\n".join(lines).encode("utf-8", "backslashreplace"))


def figure(drawn: Any) -> str:
    """A matplotlib figure as an image within the page."""
    stream = io.BytesIO()
    drawn.savefig(stream, format="png", dpi=80)
    data = base64.b64encode(stream.getvalue()).decode("ascii")
    return f'<img alt="figure" src="data:image/png;base64,{data}">'


def picture_and_text(draw: Callable[[], Any], text: object, heading: str = "") -> str:
    """Notebook output: the figure that `draw` returns, and numbers.

    Numbers alone without Matplotlib. They are folded under the `heading`, if there is
    one.
    """
    try:
        picture = figure(draw())
    except PackageError:
        picture = ""
    numbers = preformatted(text)
    return picture + (folded(heading, numbers) if heading else numbers)


def folded(title: str, *pieces: str) -> str:
    """Pieces of HTML that a click on the title, a plain text, shows."""
    summary = f"<summary>{html.escape(title)}</summary>"
    return f"<details>{summary}{''.join(pieces)}</details>"


def preformatted(text: object) -> str:
    """Lines of text as they are."""
    return f"<pre>{html.escape(str(text))}</pre>"


def table(rows: Iterable[Iterable[str]]) -> str:
    """Rows of cells, which are pieces of HTML; one may bring its own ``<td ...>``."""
    lines = []
    for cells in rows:
        own = (c if c.startswith("<td") else f"<td>{c}</td>" for c in cells)
        lines.append(f"<tr>{''.join(own)}</tr>")
    return f"<table>{''.join(lines)}</table>"


def coded(text: str) -> str:
    """Escaped text, with backquoted parts as code."""
    pieces = html.escape(text).split("`")
    return "".join(
        f"<code>{piece}</code>" if i % 2 else piece for i, piece in enumerate(pieces)
    )

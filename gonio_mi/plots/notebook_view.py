"""How a record shows itself in a notebook: picture, totals, warnings."""

import base64
import html
import io

from ..errors import PackageError
from ..results.record import Record
from ..results.summary import summarize
from ..results.summary_text import summary_text
from .record_figure import plot
from .stack_figure import sheet

__all__ = ["html_of_figure", "notebook_view"]


def notebook_view(record: Record) -> str:
    """Return a record as HTML: its picture, a sheet of a stack, and its numbers.

    Without matplotlib there are the numbers alone.
    """
    numbers = summarize(record)
    warnings = "".join(
        f"<p>Warning: {html.escape(one)}</p>" for one in numbers["warnings"]
    )
    text = summary_text(numbers | {"warnings": []})
    try:
        picture = html_of_figure(sheet(record) if len(record) > 1 else plot(record))
    except PackageError:
        picture = ""
    words = html.escape(repr(record))
    return (
        f"<p><code>{words}</code></p>{warnings}{picture}"
        f"<details><summary>numbers</summary><pre>{html.escape(text)}</pre></details>"
    )


def html_of_figure(figure: object) -> str:
    """A matplotlib figure as an image within the page."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=80)  # type: ignore[attr-defined]
    data = base64.b64encode(stream.getvalue()).decode("ascii")
    return f'<img alt="figure" src="data:image/png;base64,{data}">'

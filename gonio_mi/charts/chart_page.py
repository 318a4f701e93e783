"""A chart as one self-contained HTML page: the figure, and what it says in words."""

import html
from os import PathLike

from ..files import check_output, replacing
from ..plots import html_of_figure
from ..plots.drawable import check_matplotlib
from ..reports import html_page
from .chart_figure import plot_chart
from .curves import Chart

__all__ = ["PAGE_ENDINGS", "check_page", "save_page"]

PAGE_ENDINGS = (".html",)


def check_page(path: str | PathLike[str]) -> None:
    """Raise one clear sentence unless a page can be drawn and written to `path`.

    ImportError without Matplotlib; ValueError or OSError unless the ending is
    ``.html`` and the file can be written.
    """
    check_matplotlib()
    check_output(path, PAGE_ENDINGS)


def save_page(chart: Chart, path: str | PathLike[str], target: float = 0.01) -> None:
    """Write the figure of a chart, its costs for `target`, and what to use.

    Raises as :func:`check_page`.
    """
    check_page(path)
    reference = chart.reference
    sentences = [
        f"Use {chart.advice(target)}.",
        f"Use {chart.advice(target / 10)}.",
        f"Reference: {reference.source}; its error is {reference.error:.2g}.",
        f"No quadrature: {reference.refused}." if reference.refused else "",
    ]
    body = [
        f"<h1>{html.escape(chart.specimen)}</h1>",
        html_of_figure(plot_chart(chart, target=target)),
        *(f"<p>{html.escape(text)}</p>" for text in sentences if text),
        f"<h2>What a relative error of {target:g} costs</h2>",
        f"<pre>{html.escape(chart.table(target))}</pre>",
    ]
    with replacing(path) as stream:
        stream.write(html_page(f"Chart of {chart.specimen}", body).encode())

"""A chart as one figure: error over CPU seconds and over rays, and what to use."""

from __future__ import annotations

import html
from collections.abc import Mapping
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from ...array_types import Floats
from ...plots.figure import direction_text, finished, new_figure
from ...reports.page import (
    check_page,
    figure,
    picture_and_text,
    preformatted,
    save_page,
)
from ...results.statistics import student_quantile
from .curves import HEAD, Chart, Curve

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = {"independent": "tab:orange", "sobol": "tab:blue", "": "tab:green"}
OTHER_COLOURS = ("tab:purple", "tab:brown", "tab:pink", "tab:cyan", "tab:olive")
# Filled and solid for one estimator, hollow and dashed for the other.
STYLES = {
    "analog": ("o", "--", "w"),
    "weighted": ("o", "-", None),
    "next_event": ("^", "-.", None),
}
QUADRATURE_STYLE = ("*", "-", None)
FRONT_COLOUR = "0.82"
LEGEND = {"fontsize": "small", "frameon": False}
LEVEL = 0.95  # of the error bars


def plot_chart(
    chart: Chart, path: str | PathLike[str] | None = None, *, target: float = 0.01
) -> Figure:
    """Draw a chart, and write it if `path` is given.

    To the left the error over the CPU seconds of one measurement, with the Pareto front
    as a broad grey line; to the right over its rays, with the expectation for
    counted independent rays. Bars are 95 % intervals from the scatter between seeds.
    In the grey area the reference's own error contributes. Under both, what each
    method needs for the error `target`, cheapest first.

    Parameters
    ----------
    chart : Chart
    path : str or path, optional
        Ends in ``.pdf``, ``.png`` or ``.svg``; the errors are those of
        :func:`gonio_mi.plots.check_picture`.
    target : float
        Relative error in (0, 1).

    Returns
    -------
    matplotlib.figure.Figure
    """
    height = 0.25 * (1 + len(chart.curves))  # of the table, in inches
    drawn = new_figure(path, figsize=(10, 4.8 + height))
    above, below = drawn.subfigures(2, 1, height_ratios=(4.2, height))
    by_time, by_rays = above.subplots(1, 2, sharey=True)
    colours = _colours(chart)
    draw_by_time(by_time, chart, target)
    for curve in chart.curves:
        # integrals send no rays; their label is wanted all the same
        rays = np.where(curve.rays > 0, curve.rays, np.nan)
        _draw_curve(by_rays, chart, curve, rays, colours[curve.sampler])
    sent = np.concatenate([c.rays for c in chart.curves if c.sampler] or [np.ones(1)])
    ends = np.array([sent.min(), sent.max()])
    theory = r"theory, counted rays: $\sqrt{p(1-p)/N}$"
    errors = chart.independent / np.sqrt(ends)
    by_rays.plot(ends, errors, "k:", lw=1.2, label=theory)
    _finish(by_rays, chart, target)
    by_time.set_xlabel("CPU seconds of one measurement")
    by_time.set_ylabel("RMS error over the patches / mean BSDF; bars: 95 %")
    by_rays.set_xlabel("rays of one measurement")
    handles, labels = by_time.get_legend_handles_labels()
    by_time.legend(handles[:1], labels[:1], **LEGEND, loc="upper right")
    by_rays.legend(**LEGEND, loc="best")
    _draw_table(below.subplots(), chart, target, colours)
    return finished(drawn, path, _title(chart, target))


def save_chart_page(
    chart: Chart, path: str | PathLike[str], *, target: float = 0.01
) -> None:
    """Write a page of the figure of a chart, its costs for `target`, and what to use.

    Raises as :func:`~gonio_mi.reports.page.check_page`.
    """
    check_page(path)
    body = [
        f"<h1>{html.escape(chart.specimen)}</h1>",
        figure(plot_chart(chart, target=target)),
        *(f"<p>{html.escape(text)}</p>" for text in chart.findings(target)),
        f"<h2>What a relative error of {target:g} costs</h2>",
        preformatted(chart.table(target)),
    ]
    save_page(path, f"Chart of {chart.specimen}", body)


def chart_view(chart: Chart, target: float = 0.01) -> str:
    """Figure and numbers for notebooks; numbers alone without Matplotlib."""
    numbers = "\n".join([chart.table(target), *chart.findings(target)])
    return picture_and_text(lambda: plot_chart(chart, target=target), numbers)


def draw_by_time(axes: Axes, chart: Chart, target: float) -> None:
    """Draw the left part of :func:`plot_chart` on axes, without labels and legend."""
    colours = _colours(chart)
    front = [(point.cpu_seconds, point.error) for _, point in chart.pareto()]
    style = {"color": FRONT_COLOUR, "lw": 9, "solid_capstyle": "round", "zorder": 0}
    axes.plot(*zip(*front), label="Pareto front", **style)
    for curve in chart.curves:
        _draw_curve(axes, chart, curve, curve.cpu_seconds, colours[curve.sampler])
    _finish(axes, chart, target)


def _colours(chart: Chart) -> dict[str, str]:
    """Colour of each sampler."""
    others = [c.sampler for c in chart.curves if c.sampler not in COLOURS]
    return COLOURS | dict(zip(dict.fromkeys(others), OTHER_COLOURS))


def _draw_curve(axes: Axes, chart: Chart, curve: Curve, x: Floats, colour: str) -> None:
    """Points of one method with their error bars, of few seeds and so Student's t."""
    marker, line, face = STYLES.get(curve.estimator, QUADRATURE_STYLE)
    times = student_quantile(chart.settings.get("repeats", 2) - 1, LEVEL)
    bars = times * np.nan_to_num([point.error_std_err for point in curve.points])
    bars = np.minimum(bars, 0.9 * curve.error)
    style = {"marker": marker, "ms": 4 if marker == "o" else 8, "mfc": face, "ls": line}
    axes.errorbar(
        x, curve.error, bars, color=colour, lw=1.2, label=curve.label, **style
    )


def _finish(axes: Axes, chart: Chart, target: float) -> None:
    """Axes, the target, the reference's error."""
    errors = np.concatenate([curve.error for curve in chart.curves])
    low = min(errors[errors > 0].min(), target) / 2
    axes.set(xscale="log", yscale="log")
    _plain_ticks(axes)
    axes.axhline(target, c="tab:red", lw=0.8, zorder=0)
    axes.axhspan(low / 1e6, chart.least, color="0.9", lw=0, zorder=-1)
    axes.set_ylim(low, None)
    axes.grid(alpha=0.3, lw=0.5)
    axes.spines[["top", "right"]].set_visible(False)


def _plain_ticks(axes: Axes) -> None:
    """Numbers at 1, 2 and 5 of each decade if there are few, else at its beginning."""
    from matplotlib.ticker import LogLocator, NullFormatter

    low, high = axes.get_xlim()
    few = high < 300 * low
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if few else (1,)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    if few:
        axes.xaxis.set_major_formatter("{x:g}")


def _draw_table(
    axes: Axes, chart: Chart, target: float, colours: Mapping[str, str]
) -> None:
    """What each method needs for the target, cheapest first."""
    axes.axis("off")
    head = (f"to an RMS error of {target:g}", *HEAD[1:])
    rows = [[cell.replace("+-", "±") for cell in row] for row in chart.rows(target)]
    samplers = [curve.sampler for curve, _ in chart.ranking(target)]
    table = axes.table(
        rows, colLabels=head, loc="upper center", cellLoc="left", edges="horizontal"
    )
    table.auto_set_font_size(False)
    table.set_fontsize(9)
    table.auto_set_column_width(range(len(head)))
    for (row, column), cell in table.get_celld().items():
        cell.set(linewidth=0.3)
        if row and column == 0:
            cell.get_text().set_color(colours[samplers[row - 1]])
        if row == 1:
            cell.get_text().set_weight("bold")


def _title(chart: Chart, target: float) -> str:
    """Specimen and conditions; what to use; what is taken for true."""
    direction = "incident as the emitter"
    if not np.isnan(chart.theta_i):
        direction = direction_text(chart.theta_i, chart.phi_i)
    parts = [chart.specimen, direction, chart.collector]
    if chart.reference.values.shape[0] == 2:
        parts.append("BRDF and BTDF")
    if chart.settings.get("side") == "back":
        parts.append("back side")
    reference = f"reference: {chart.reference.source}"
    advice = f"{chart.advice(target)};  {chart.advice(target / 10)}"
    text = f"{', '.join(parts)}\n{advice}\n{reference}"
    text += f", error {chart.reference.error:.1g}"
    return text.encode("utf-8", "backslashreplace").decode()

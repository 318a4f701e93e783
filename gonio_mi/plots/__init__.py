"""Figures of records. matplotlib, the extra ``plot``, is imported when one is drawn."""

from ..results.record import Record
from .drawable import ANIMATION_ENDINGS, FIGURE_ENDINGS, check_picture
from .notebook_view import html_of_figure, notebook_view
from .record_figure import plot
from .stack_figure import animation, sheet

# a record's own methods draw it, and import nothing of what is above it
Record.plotter, Record.viewer = plot, notebook_view

__all__ = [
    "ANIMATION_ENDINGS",
    "FIGURE_ENDINGS",
    "animation",
    "check_picture",
    "html_of_figure",
    "plot",
    "sheet",
]

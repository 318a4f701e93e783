"""Figures of records. matplotlib, the extra ``plot``, is imported when one is drawn."""

from .record_figure import FIGURE_ENDINGS, plot

__all__ = ["FIGURE_ENDINGS", "plot"]

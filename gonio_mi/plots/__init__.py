"""Figures of records. matplotlib, the extra ``plot``, is imported when one is drawn."""

from .drawable import FIGURE_ENDINGS, check_picture
from .record_figure import plot

__all__ = ["FIGURE_ENDINGS", "check_picture", "plot"]

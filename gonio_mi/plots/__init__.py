"""Figures of records. matplotlib, the extra ``plot``, is imported when one is drawn."""

from .figure import ANIMATION_ENDINGS, FIGURE_ENDINGS, check_picture
from .gradients import plot_gradient
from .plot import animation, plot, sheet
from .polarisation import plot_mueller, plot_stokes

OFFERS = {"plot": "plot"}

__all__ = [
    "ANIMATION_ENDINGS",
    "FIGURE_ENDINGS",
    "animation",
    "check_picture",
    "plot",
    "plot_gradient",
    "plot_mueller",
    "plot_stokes",
    "sheet",
]

"""Comparison of a record with another record or with measured values."""

from .budget import Budget, aperture_effect, uncertainty_budget
from .compare import ALPHA, compare
from .comparison import Comparison
from .measure_like import measure_like

__all__ = [
    "ALPHA",
    "Budget",
    "Comparison",
    "aperture_effect",
    "compare",
    "measure_like",
    "uncertainty_budget",
]

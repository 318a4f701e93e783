"""Speed against accuracy for a specimen."""

from .charting import ESTIMATORS, SAMPLERS, chart
from .curves import Chart

__all__ = ["ESTIMATORS", "SAMPLERS", "Chart", "chart"]

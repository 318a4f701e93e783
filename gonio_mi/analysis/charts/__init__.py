"""Speed against accuracy for a specimen."""

from .chart import ESTIMATORS, SAMPLERS, chart
from .curves import Chart

__all__ = ["ESTIMATORS", "SAMPLERS", "Chart", "chart"]

"""Speed against accuracy for a specimen."""

from .chart import ESTIMATORS, SAMPLERS, chart
from .curves import Chart
from .figure import chart_view

# a chart's own method shows it, and imports nothing of what is above it
Chart.viewer = chart_view

__all__ = ["ESTIMATORS", "SAMPLERS", "Chart", "chart"]

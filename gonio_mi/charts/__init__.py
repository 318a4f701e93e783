"""Speed against accuracy for a specimen."""

from .charting import ESTIMATORS, SAMPLERS, chart

__all__ = ["ESTIMATORS", "SAMPLERS", "chart"]

"""Comparison of a record with another record or with measured values."""

from .comparing import ALPHA, Comparison, compare, measure_like

__all__ = ["ALPHA", "Comparison", "compare", "measure_like"]

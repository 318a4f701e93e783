"""Pages to look at results with: one self-contained HTML file, without a network."""

from .report import check_report, report

OFFERS = {"notebook_view": "report"}

__all__ = ["check_report", "report"]

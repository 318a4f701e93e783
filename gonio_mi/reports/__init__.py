"""Pages to look at results with: one self-contained HTML file, without a network."""

from ..results.record import Record
from .report import check_report, notebook_view, report

# a record's own method shows it, and imports nothing of what is above it
Record.viewer = notebook_view

__all__ = ["check_report", "report"]

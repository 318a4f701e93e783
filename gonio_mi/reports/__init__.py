"""Pages to look at records with: one self-contained HTML file, without a network."""

from .page import html_page
from .reporting import check_report, report

__all__ = ["check_report", "html_page", "report"]

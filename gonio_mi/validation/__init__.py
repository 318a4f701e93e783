"""Whether a BSDF plugin is right, and which of its functions is wrong.

One flat BSDF at one incident direction is all that is needed: its functions are asked
about the same directions, and what they answer is compared.
"""

from .evidence import POLARISED, PROPERTIES
from .numpy_bsdf import from_numpy
from .reproducer import reproducer
from .validate import validate
from .verdict import Property, Verdict
from .verdict_page import check_report, draw, save_report, verdict_view

Verdict.viewer = verdict_view

__all__ = [
    "POLARISED",
    "PROPERTIES",
    "Property",
    "Verdict",
    "check_report",
    "draw",
    "from_numpy",
    "reproducer",
    "save_report",
    "validate",
]

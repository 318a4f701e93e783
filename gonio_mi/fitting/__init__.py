"""From a record to the parameters of a BSDF, with uncertainties."""

from .fit_result import Fit
from .fits import fit

__all__ = ["Fit", "fit"]

"""From a record to the parameters of a BSDF, with uncertainties."""

from .fit import fit
from .result import Fit

__all__ = ["Fit", "fit"]

"""From a record to the parameters of a BSDF, with uncertainties."""

from .fit import Fit, fit

__all__ = ["Fit", "fit"]

"""From a record to the parameters of a BSDF, with uncertainties."""

from .fits import Fit, fit

__all__ = ["Fit", "fit"]

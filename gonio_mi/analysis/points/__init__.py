"""Values about directions with their covariance, of a record, a table or a fit."""

from .counted import CountedPoints
from .model import Model
from .points import Points

__all__ = ["CountedPoints", "Model", "Points"]

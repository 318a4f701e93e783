"""Values about directions with their covariance, of a record, a table or a fit."""

from .points import Points

__all__ = ["Points"]

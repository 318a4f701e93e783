"""What two installed versions of Mitsuba say of the same BSDF, function by function."""

from .differences import Difference, Differences
from .differing import diff

__all__ = ["Difference", "Differences", "diff"]

"""What two installed versions of Mitsuba say of the same BSDF, function by function."""

from .differing import Difference, Differences, diff

__all__ = ["Difference", "Differences", "diff"]

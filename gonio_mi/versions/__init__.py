"""What two installed versions of Mitsuba say of the same BSDF, function by function."""

from .differing import Difference, Differences, diff
from .saving import diff_saved, save_answers, saved

__all__ = ["Difference", "Differences", "diff", "diff_saved", "save_answers", "saved"]

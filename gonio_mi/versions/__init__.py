"""What two installed versions of Mitsuba say of the same BSDF, function by function."""

from .differences import Difference, Differences
from .differing import diff
from .saving import diff_saved, save_answers, saved

__all__ = ["Difference", "Differences", "diff", "diff_saved", "save_answers", "saved"]

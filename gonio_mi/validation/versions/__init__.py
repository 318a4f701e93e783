"""Answers of two installed versions of Mitsuba for the same BSDF, compared."""

from .differing import Difference, Differences, diff, diff_saved, save_answers, saved

__all__ = ["Difference", "Differences", "diff", "diff_saved", "save_answers", "saved"]

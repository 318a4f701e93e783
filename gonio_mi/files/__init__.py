"""Files that are read and written without a renderer."""

from .storage import ENDINGS, FORMATS, check_output, load, replacing, save

__all__ = ["ENDINGS", "FORMATS", "check_output", "load", "replacing", "save"]

"""Files that are read and written without a renderer."""

from .storage import ENDINGS, FORMATS, load, save
from .writing import check_output, replacing

__all__ = ["ENDINGS", "FORMATS", "check_output", "load", "replacing", "save"]

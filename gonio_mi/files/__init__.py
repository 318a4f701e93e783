"""Files that are read and written without a renderer."""

from ..results.record import Record
from .storage import ENDINGS, FORMATS, load, save
from .writing import check_output, replacing

# a record's own method writes files, and imports nothing of what is above it
Record.writer = save

__all__ = ["ENDINGS", "FORMATS", "check_output", "load", "replacing", "save"]

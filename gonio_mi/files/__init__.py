"""Files that are read and written without a renderer."""

from ..results.record import Record
from .netcdf import dataset
from .storage import ENDINGS, FORMATS, load, save
from .writing import check_output, replacing

# a record's own methods write and label it, and import nothing of what is above it
Record.writer, Record.labeller = save, dataset

__all__ = ["ENDINGS", "FORMATS", "check_output", "load", "replacing", "save"]

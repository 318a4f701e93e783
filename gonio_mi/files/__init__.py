"""Files that are read and written without a renderer."""

from ..results.record import Record
from .netcdf import dataset
from .storage import ENDINGS, FORMATS, load, load_added_up, save
from .writing import check_output, replacing

# methods of a record write and label it; its module imports none of those above it
Record.writer, Record.labeller = save, dataset

__all__ = [
    "ENDINGS",
    "FORMATS",
    "check_output",
    "load",
    "load_added_up",
    "replacing",
    "save",
]

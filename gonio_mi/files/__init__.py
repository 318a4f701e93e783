"""Files that are read and written without a renderer."""

from .storage import ENDINGS, load, load_added_up, save
from .writing import check_output, replacing

OFFERS = {"save": "storage", "dataset": "netcdf"}

__all__ = [
    "ENDINGS",
    "check_output",
    "load",
    "load_added_up",
    "replacing",
    "save",
]

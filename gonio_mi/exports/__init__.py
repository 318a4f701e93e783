"""Records as files of other programs, some of which need new measurements."""

from .exporting import ENDINGS, export
from .loss import Loss

__all__ = ["ENDINGS", "Loss", "export"]

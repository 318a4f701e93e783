"""Records as files of other programs, some of which need new measurements."""

from .exporting import ENDINGS, export

__all__ = ["ENDINGS", "export"]

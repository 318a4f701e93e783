"""Where a campaign without a folder keeps its parts until its file is written."""

from __future__ import annotations

import contextlib
import shutil
from argparse import Namespace
from pathlib import Path

from ..campaigns.known_directions import folder_name
from .arguments import say

__all__ = ["CampaignParts"]


class CampaignParts:
    """Folder beside the first output of a campaign that chooses its directions.

    It is there while the campaign is at work, and stays if that was interrupted or
    killed, so that the same command carries on. In its context the options name it,
    unless they name another, or there is nothing to write. Parts of other specimens
    stay, and the user is told.

    Attributes
    ----------
    finished : bool
        To be set when nothing of it is needed any more.
    """

    def __init__(self, options: Namespace) -> None:
        self.folder: Path | None = None
        if options.tolerance is not None and not options.folder and options.output:
            self.folder = Path(f"{options.output[0]}.parts")
        self.options = options
        self.name = folder_name(options.specimen)
        self.finished = False

    def __enter__(self) -> CampaignParts:
        self._was_there = self.folder is not None and self.folder.exists()
        if self.folder is not None:
            self.options.folder = str(self.folder)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self.folder is None:
            return
        interrupted = kind is not None and not issubclass(kind, Exception)
        refused = kind is not None and not interrupted and not self._was_there
        if self.finished or refused:
            shutil.rmtree(self.folder / self.name, ignore_errors=True)
            with contextlib.suppress(OSError):  # what else is in it is not ours
                self.folder.rmdir()
        others = sorted(path for path in self.folder.glob("*") if path.is_dir())
        if self.finished and others:
            say(
                f"{others[0]} holds parts of another specimen, whose "
                "campaign was not finished: remove it if they are not needed"
            )

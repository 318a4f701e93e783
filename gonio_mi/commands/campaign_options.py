"""Options of commands that measure in campaigns; their temporary folder and signals."""

from __future__ import annotations

import contextlib
import signal
import threading
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..errors import checked_count
from ..results.record import Record
from .arguments import INCOMPLETE, Group, add_number, add_text, say

# Fraction of the directions never used that must be within a tolerance.
MIN_WITHIN = 0.95

# Exit code of what SIGTERM has ended, as shells count: 128 and its number.
TERMINATED = 143


def add_campaign(group: Group, default: str = "none") -> None:
    """Add the options for processes and the folder of finished directions."""
    text = "Measure the incident directions in this many processes."
    add_number(group, "--workers", "N", text)
    text = "Folder of finished incident directions, from which the same command "
    text += f"resumes, also after a crash. Default: {default}."
    add_text(group, "--folder", "DIR", text)


def campaign_options(options: Namespace) -> dict[str, Any]:
    """Arguments of a campaign; none if it was not asked for."""
    workers, folder = options.workers, options.folder
    if workers is None and folder is None:
        return {}
    if workers is not None:
        workers = checked_count("workers", workers)
    return {"executor": workers, "folder": folder, "plugins": options.plugin}


def is_imprecise(record: Record) -> bool:
    """Whether a precision was asked for and not reached."""
    asked, campaign = record.asked.precision, record.provenance.campaign
    if record.back is not None and is_imprecise(record.back):
        return True
    if campaign is not None:
        return campaign.within < MIN_WITHIN
    return asked is not None and (record.provenance.reached or 0) > asked


def answered_by(answer: Any, number: int) -> Any:
    """Install a signal handler; return the previous one.

    Only in the main thread, where alone Python allows it: elsewhere None.
    """
    if threading.current_thread() is not threading.main_thread():
        return None
    return signal.signal(number, answer)


@contextmanager
def kept_after_ctrl_c(folder: str | None) -> Iterator[None]:
    """Context of a campaign in which Ctrl-C reports what is kept.

    So does SIGTERM, with an exit code of its own.
    """
    ended = []

    def end(*_: object) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # what is finished is being kept
        ended.append(TERMINATED)
        raise KeyboardInterrupt

    before = answered_by(end, signal.SIGTERM)
    try:
        yield
    except KeyboardInterrupt as pressed:
        kept = str(pressed) or "nothing was kept, because no --folder was given"
        if folder is not None:
            kept = f"{folder} holds what was finished; the same command carries on"
        say(f"interrupted: {kept}")
        raise SystemExit(ended[0] if ended else INCOMPLETE) from None
    finally:
        answered_by(before, signal.SIGTERM)


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
            from ..campaigns.folder import folder_name  # slow to import

            self.name = folder_name(options.specimen)
            self.folder = Path(f"{options.output[0]}.parts")
            self._was_there = self.folder.exists()
            options.folder = str(self.folder)
        self.finished = False

    def __enter__(self) -> CampaignParts:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self.folder is None:
            return
        interrupted = kind is not None and not issubclass(kind, Exception)
        refused = kind is not None and not interrupted and not self._was_there
        if self.finished or refused:
            import shutil  # slow to import

            shutil.rmtree(self.folder / self.name, ignore_errors=True)
            with contextlib.suppress(OSError):  # what else is in it is not ours
                self.folder.rmdir()
        others = sorted(path for path in self.folder.glob("*") if path.is_dir())
        if self.finished and others:
            say(
                f"{others[0]} holds parts of another specimen, whose "
                "campaign was not finished: remove it if they are not needed"
            )

"""Options of the commands that measure in campaigns, and what Ctrl-C leaves of one."""

import signal
import threading
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from ..errors import checked_count
from .arguments import INCOMPLETE, add_number, add_text, say

__all__ = ["add_campaign", "answered_by", "campaign_options", "kept_after_ctrl_c"]

# Exit code of what SIGTERM has ended, as shells count: 128 and its number.
TERMINATED = 143


def add_campaign(group: Any, kept: str = "") -> None:
    """Add where to measure, and where to keep what is finished.

    `kept` tells where that is without a folder.
    """
    add_number(
        group,
        "--workers",
        "N",
        "measure the incident directions in that many processes",
    )
    add_text(
        group,
        "--folder",
        "DIR",
        "keep finished incident directions there: the same command carries on, also"
        f" after a crash{kept}",
    )


def campaign_options(options: Namespace) -> dict[str, Any]:
    """Arguments of a campaign; none if it was not asked for."""
    workers, folder = options.workers, options.folder
    if workers is None and folder is None:
        return {}
    if workers is not None:
        workers = checked_count("workers", workers)
    return {"executor": workers, "folder": folder, "plugins": options.plugin}


def answered_by(answer: Any, number: int) -> Any:
    """Let a function answer a signal; return what did before.

    Only in the main thread, where alone Python allows it: elsewhere None.
    """
    if threading.current_thread() is not threading.main_thread():
        return None
    return signal.signal(number, answer)


@contextmanager
def kept_after_ctrl_c(folder: str | None) -> Iterator[None]:
    """Context of a campaign, that Ctrl-C leaves with a sentence on what is kept.

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
        kept = str(pressed) or "nothing was kept, for want of --folder"
        if folder is not None:
            kept = f"{folder} holds what was finished; the same command carries on"
        say(f"interrupted: {kept}")
        raise SystemExit(ended[0] if ended else INCOMPLETE) from None
    finally:
        answered_by(before, signal.SIGTERM)

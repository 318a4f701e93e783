"""Whether something fits into memory, asked before it is allocated."""

import os

from .errors import SettingError

__all__ = ["check_memory"]


def check_memory(what: str, needed: float, remedy: str) -> None:
    """Raise ValueError if `what` needs more bytes than the machine has.

    The message ends with `remedy`, in the imperative. Where the size of the memory
    cannot be found out, nothing is refused.
    """
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # not a POSIX system
        return
    if needed > memory:
        raise SettingError(
            f"{what} must fit into the {memory / 2**30:.3g} GiB of memory, "
            f"got {needed / 2**30:.3g} GiB: {remedy}"
        )

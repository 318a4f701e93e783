"""How the program ``gonio-mi`` starts: Ctrl-C in one line, and Mitsuba if needed.

Python scripts that import the package are left as they are.
"""

import os
import signal
import sys
from collections.abc import Sequence

PROGRAM = "gonio-mi"
# Commands that read records and tables only, and help: to load Mitsuba takes as long.
WITHOUT_MITSUBA = ("", "help", "show", "plot", "report")
INTERRUPTED = 130  # as shells count: 128 and the number of SIGINT


def begin() -> None:
    """Let Ctrl-C end the process while it imports; NumPy gets no threads.

    Raises
    ------
    FileNotFoundError, SystemExit
        If Mitsuba, which would abort the process, is to be loaded in a folder that was
        deleted; the latter for the program.
    """
    if needs_mitsuba():
        _check_folder()
    if not is_program():
        return
    # its matrices are small here, and threads that wait for them take CPU time
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)


def needs_mitsuba() -> bool:
    """Whether anything but the program with a command that only reads is started."""
    return not is_program() or command_of(sys.argv[1:]) not in WITHOUT_MITSUBA


def is_program() -> bool:
    """Whether the process is the program ``gonio-mi``."""
    name = os.path.basename(getattr(sys, "argv", [""])[0])
    return name.removesuffix(".exe") == PROGRAM


def command_of(arguments: Sequence[str]) -> str:
    """The first word that is no option; empty if there is none."""
    return next((word for word in arguments if not word.startswith("-")), "")


def end() -> None:
    """Let Ctrl-C raise KeyboardInterrupt again."""
    if signal.getsignal(signal.SIGINT) is _leave:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _check_folder() -> None:
    """Raise unless the working folder exists."""
    try:
        os.getcwd()
    except FileNotFoundError:
        text = "the working folder was deleted: change to another one"
        if is_program():
            sys.exit(f"{PROGRAM}: {text}")
        raise FileNotFoundError(text) from None


def _leave(*_: object) -> None:
    """End at once: half-imported libraries cannot be taken down in order."""
    os.write(2, f"{PROGRAM}: interrupted\n".encode())
    os._exit(INTERRUPTED)

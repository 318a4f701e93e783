"""How the program ``gonio-mi`` starts: Ctrl-C in one line, and Mitsuba if needed.

Python scripts that import the package are left as they are.
"""

import atexit
import gc
import os
import sys
from collections.abc import Sequence
from typing import NoReturn

PROGRAM = "gonio-mi"
# Commands that read records and tables only, and help: to load Mitsuba takes as long.
WITHOUT_MITSUBA = ("", "help", "show", "plot", "report")
HELP = ("-h", "--help", "--help-all")
INTERRUPTED = 130  # as shells count: 128 and the number of SIGINT

# Whether this process is the program, which searches for no garbage while it imports.
_begun = False


def begin() -> None:
    """Let Ctrl-C end the process while it imports; NumPy gets no threads.

    Nothing that is imported is garbage, nor is it searched for when the process ends.

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
    global _begun
    _begun = True
    import signal  # slow to import

    gc.disable()
    atexit.register(gc.freeze)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)


def needs_mitsuba() -> bool:
    """Whether anything but the program with a command that only reads is started."""
    words = _command_line()[1:]
    reads = command_of(words) in WITHOUT_MITSUBA or not {*HELP}.isdisjoint(words)
    return not (is_program() and reads)


def is_program() -> bool:
    """Whether the process is the program ``gonio-mi``."""
    name = os.path.basename(_command_line()[0])
    return name.removesuffix(".exe") == PROGRAM


def _command_line() -> list[str]:
    """Program and its words; Python within another program may have none."""
    return getattr(sys, "argv", None) or [""]


def command_of(arguments: Sequence[str]) -> str:
    """The first word that is no option; empty if there is none."""
    return next((word for word in arguments if not word.startswith("-")), "")


def end() -> None:
    """Let Ctrl-C raise KeyboardInterrupt again, and what follows be cleared away.

    A process that calls the command line itself keeps its garbage, and its search.
    """
    import signal

    if _begun:
        gc.freeze()
        gc.enable()
    if signal.getsignal(signal.SIGINT) is _leave:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def name_missing_library(error: NameError) -> None:
    """Say what Dr.Jit could not load: its own report of that raises NameError.

    Raises
    ------
    ImportError, SystemExit
        The latter for the program.
    """
    if isinstance(error.__context__, ImportError):
        remedy = "on Debian and Ubuntu `sudo apt install libatomic1` brings libatomic"
        _refuse(ImportError(f"Dr.Jit cannot be loaded: {error.__context__}; {remedy}"))


def _check_folder() -> None:
    """Raise unless the working folder exists."""
    try:
        os.getcwd()
    except FileNotFoundError:
        text = "the working folder was deleted: change to another one"
        _refuse(FileNotFoundError(text))


def _refuse(error: Exception) -> NoReturn:
    """Raise an error; the program ends with its sentence alone."""
    if is_program():
        sys.exit(f"{PROGRAM}: {error}")
    raise error from None


def _leave(*_: object) -> None:
    """End at once: half-imported libraries cannot be taken down in order."""
    os.write(2, f"{PROGRAM}: interrupted\n".encode())
    os._exit(INTERRUPTED)

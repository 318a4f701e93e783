"""Ctrl-C while the program ``gonio-mi`` starts: one line instead of a traceback."""

import os
import signal
import sys

PROGRAM = "gonio-mi"
INTERRUPTED = 130  # as shells count: 128 and the number of SIGINT


def begin() -> None:
    """Let Ctrl-C end the process while it imports, if it is that of the program."""
    program = os.path.basename(getattr(sys, "argv", [""])[0])
    python_answers = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if program.removesuffix(".exe") == PROGRAM and python_answers:
        signal.signal(signal.SIGINT, _leave)


def end() -> None:
    """Let Ctrl-C raise KeyboardInterrupt again."""
    if signal.getsignal(signal.SIGINT) is _leave:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _leave(*_: object) -> None:
    """End at once: half-imported libraries cannot be taken down in order."""
    os.write(2, f"{PROGRAM}: interrupted\n".encode())
    os._exit(INTERRUPTED)

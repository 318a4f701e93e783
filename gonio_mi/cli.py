"""The command line: ``gonio-mi COMMAND ...``, and how it fails.

Exit codes: 0 done, 1 the user's error, 2 the asked precision was not reached or the
measurement was interrupted, 3 a validation or comparison failed.
"""

import os
import re
import sys
import warnings
from collections.abc import Sequence
from importlib import metadata

from .commands import (
    chart,
    compare,
    doctor,
    export,
    measure,
    plan,
    plot,
    show,
    validate,
)
from .commands.arguments import (
    INCOMPLETE,
    PROGRAM,
    USER_ERROR,
    Parser,
    UsageError,
    say,
    sentence,
)
from .errors import (
    FileFormatError,
    LLVMError,
    LostRaysError,
    SpecimenError,
    VariantError,
    frames,
)

__all__ = ["main"]

COMMANDS = (measure, show, plot, validate, compare, export, plan, chart, doctor)

EXAMPLES = """\
examples:
  gonio-mi measure diffuse --theta-i 45
  gonio-mi measure scene.xml -D alpha=0.3 --rays 1e8 -o run.npz
  gonio-mi show run.npz
  gonio-mi plot run.npz -o run.png

exit codes: 0 done, 1 an error of yours (said in one line), 2 interrupted, or the asked
precision was not reached, 3 a validation or comparison failed
"""

# How Mitsuba begins what it says when a plugin gives up.
MITSUBA = re.compile(r"\[\w+\.(cpp|h):\d+\]")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Default: those of the process.
    """
    _open_standard_streams()
    with warnings.catch_warnings():
        warnings.simplefilter("always", RuntimeWarning)
        warnings.showwarning = _show_warning
        options = None
        try:
            options = _parser().parse_args(arguments)
            return options.run(options)
        except KeyboardInterrupt:
            say("interrupted: there is nothing to keep")
            return INCOMPLETE
        except Exception as error:
            if isinstance(error, BrokenPipeError) and error.filename is None:
                # the reader of our output has left; leave nothing to flush at exit
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
                return USER_ERROR
            place = _place(error, getattr(options, "plugin", ()))
            if not (place or _is_the_users(error)):
                raise
            say(place + sentence(error))
            return USER_ERROR


def _open_standard_streams() -> None:
    """Put nothing in place of the standard streams that were closed.

    Otherwise a file that is opened takes the number of a stream, and what a library
    writes there would go into it.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "r+"))  # noqa: SIM115


def _parser() -> Parser:
    parser = Parser(
        prog=PROGRAM,
        description="A virtual goniophotometer for Mitsuba 3.",
        epilog=EXAMPLES,
    )
    version = metadata.version("gonio-mi")
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {version}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for command in COMMANDS:
        command.add(commands)
    return parser


def _show_warning(message: object, *_: object, **__: object) -> None:
    say(f"warning: {' '.join(str(message).split())}")


def _is_the_users(error: BaseException) -> bool:
    """Whether an error is the user's to mend, and not a bug to trace.

    That is what the instrument itself raises, what files do, and what Mitsuba refuses.
    """
    own = (FileFormatError, LLVMError, LostRaysError, SpecimenError, VariantError)
    if isinstance(error, (*own, UsageError, OSError)):
        return True
    if isinstance(error, RuntimeError) and MITSUBA.search(str(error)):
        return True
    ours = (ImportError, TypeError, ValueError)
    return isinstance(error, ours) and frames(error)[-1].module.startswith("gonio_mi")


def _place(error: BaseException, plugins: Sequence[str]) -> str:
    """Where in the user's own plugin files an error arose; empty if it did not."""
    names = {os.path.abspath(plugin): os.fspath(plugin) for plugin in plugins}
    place = ""
    for frame in frames(error):
        name = names.get(os.path.abspath(frame.file))
        if name is not None:
            place = f"{name}, line {frame.line}, in {frame.function}: "
            place += f"{type(error).__name__}: "
    return place

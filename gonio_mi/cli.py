"""The command line: ``gonio-mi COMMAND ...``, and how it fails.

Exit codes: 0 done, 1 an error, 2 the asked precision was not reached or the
measurement was interrupted, 3 a validation or comparison failed, 4 a validation could
not decide, 130 interrupted before it had begun, 143 a campaign was ended by SIGTERM.
"""

import io
import os
import platform
import shlex
import sys
import tempfile
import traceback
import warnings
from argparse import Namespace
from collections.abc import Sequence
from importlib import metadata
from typing import NoReturn

from .commands import (
    bsdf,
    chart,
    compare,
    diff,
    doctor,
    export,
    fit,
    measure,
    plan,
    plot,
    report,
    show,
    surface,
    validate,
)
from .commands.arguments import (
    INCOMPLETE,
    PROGRAM,
    USER_ERROR,
    Parser,
    add_command,
    say,
    sentence,
)
from .errors import SettingError, is_the_users, own_frame
from .interrupts import end_start_up

__all__ = ["COMMANDS", "main", "parser"]

COMMANDS = (
    *(measure, show, plot, report, validate, diff, compare, fit, surface, bsdf),
    *(export, plan, chart, doctor),
)

EXAMPLES = """\
examples:
  gonio-mi measure diffuse --theta-i 45
  gonio-mi measure scene.xml -D alpha=0.3 --rays 1e8 -o run.npz
  gonio-mi show run.npz
  gonio-mi plot run.npz -o run.png

exit codes: 0 done, 1 an error (said in one line: yours, or a bug to report), 2
interrupted, or the asked precision was not reached, 3 a validation or comparison
failed, 4 a validation could not decide, 130 interrupted before it had begun, 143 a
campaign was ended by SIGTERM
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Default: those of the process.
    """
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    _open_standard_streams()
    with warnings.catch_warnings():
        warnings.simplefilter("always", RuntimeWarning)
        warnings.showwarning = _show_warning
        options = None
        try:
            end_start_up()
            options = parser().parse_args(arguments)
            return options.run(options)
        except KeyboardInterrupt:
            say("interrupted: there is nothing to keep")
            return INCOMPLETE
        except Exception as error:
            if isinstance(error, BrokenPipeError) and error.filename is None:
                # the reader of our output has left; leave nothing to flush at exit
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
                return USER_ERROR
            if "--debug" in arguments:
                traceback.print_exception(error)
            place = _place(error, getattr(options, "plugin", ()))
            if place or is_the_users(error):
                say(place + sentence(error))
            else:
                _say_of_bug(error, arguments)
            return USER_ERROR


def _open_standard_streams() -> None:
    """Put nothing in place of the standard streams that were closed.

    Otherwise a file that is opened takes the number of a stream, and what a library
    writes there would go into it. Characters that the output cannot encode are escaped.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "r+"))  # noqa: SIM115
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")


def parser() -> Parser:
    """Parser of the whole command line."""
    whole = Parser(
        prog=PROGRAM,
        description="A virtual goniophotometer for Mitsuba 3.",
        epilog=EXAMPLES,
    )
    version = metadata.version("gonio-mi")
    whole.add_argument("--version", action="version", version=f"{PROGRAM} {version}")
    commands = whole.add_subparsers(metavar="COMMAND")
    whole.set_defaults(run=_without_command)
    for command in COMMANDS:
        add_command(commands, command)
    return whole


def _without_command(_: Namespace) -> NoReturn:
    names = ", ".join(command.__name__.rpartition(".")[2] for command in COMMANDS)
    raise SettingError(
        f"a command must be given, one of {names}: {PROGRAM} --help tells what each "
        f"does, and {PROGRAM} COMMAND --help its options"
    )


def _show_warning(message: object, *_: object, **__: object) -> None:
    say(f"warning: {' '.join(str(message).split())}")


def _say_of_bug(error: Exception, arguments: Sequence[str]) -> None:
    """Say that an error is a bug of ours, and keep in a file what a report needs."""
    packages = (PROGRAM, "mitsuba", "drjit", "numpy")
    versions = [f"{package} {metadata.version(package)}" for package in packages]
    python = f"Python {platform.python_version()} on {platform.platform()}"
    words = shlex.join([PROGRAM, *arguments])
    trace = "".join(traceback.format_exception(error))
    report = "\n".join([", ".join([*versions, python]), words, "", trace])
    try:
        with tempfile.NamedTemporaryFile(
            "w",
            prefix=f"{PROGRAM}-",
            suffix=".txt",
            delete=False,
            encoding="utf-8",
            errors="backslashreplace",
        ) as stream:
            stream.write(report)
        place = f"the file {stream.name}"
    except OSError:  # nowhere to write
        print(report, file=sys.stderr)
        place = "what is above"
    say(
        f"this is a bug of {PROGRAM} and not an error of yours; please report it to "
        f"its maintainers with {place}: {type(error).__name__}: {sentence(error)}"
    )


def _place(error: BaseException, plugins: Sequence[str]) -> str:
    """Where in the user's own code an error arose; empty if it did not.

    That is in a plugin file, or in what it imports that is not installed.
    """
    frame = own_frame(error) if plugins else None
    if frame is None:
        return ""
    names = {os.path.abspath(plugin): os.fspath(plugin) for plugin in plugins}
    name = names.get(os.path.abspath(frame.file), os.path.basename(frame.file))
    return f"{name}, line {frame.line}, in {frame.function}: {type(error).__name__}: "

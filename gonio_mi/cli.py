"""The command line: ``gonio-mi COMMAND ...``, and how it fails.

examples:
  gonio-mi help measure
  gonio-mi measure diffuse --theta-i 45
  gonio-mi measure scene.xml -D alpha=0.3 --rays 1e8 -o run.npz
  gonio-mi show run.npz
  gonio-mi plot run.npz -o run.png

exit codes: 0 done, 1 an error (in one line: yours, or a bug to report), 2
interrupted, or the requested precision was not reached, 3 a validation or comparison
failed, 4 a validation could not decide, 130 interrupted during start-up, 143 a campaign
was ended by SIGTERM
"""

import argparse
import importlib
import io
import os
import sys
import traceback
import warnings
from argparse import Namespace
from collections.abc import Iterable, Sequence
from functools import cache, partial
from typing import Any, NoReturn

from . import start_up
from .annexes import doors
from .commands.arguments import INCOMPLETE, USER_ERROR, say, sentence
from .commands.parser import Parser
from .errors import SettingError, is_ctrl_c, is_the_users, own_frame
from .start_up import PROGRAM
from .version import __version__

# Commands of the core, each the module of this name in `commands`, imported when it is
# used; those of annexes follow.
CORE = {
    "measure": "Measure how a specimen scatters light.",
    "show": "Show the numbers of a record, or how a table is understood.",
    "plot": "Draw a record.",
    "report": "Write an interactive page of records.",
    "surface": "Print height, slope and micro-normal statistics.",
    "plan": "Estimate how many rays a measurement needs.",
    "doctor": "Check the installation.",
}
COMMANDS, PACKAGES = dict(CORE), dict.fromkeys(CORE, __package__)
for _name, _door in doors():
    COMMANDS |= _door.COMMANDS
    PACKAGES |= dict.fromkeys(_door.COMMANDS, _name)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Default: those of the process.
    """
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if arguments[:1] == ["help"]:
        arguments = [*arguments[1:], "--help"]
    _open_standard_streams()
    with warnings.catch_warnings():
        warnings.simplefilter("always", RuntimeWarning)
        # an error follows, which says the same
        warnings.filterwarnings("ignore", "nanobind: attempted to access an uninit")
        # a campaign, which loads its specimen many times, warns once
        warnings.showwarning = partial(_show_warning, cache(say))
        options = None
        try:
            command = start_up.command_of(arguments)
            # no help of the program can be asked for after a command
            alone = arguments[:1] == [command] and command in COMMANDS
            listed = [command] if alone else COMMANDS
            options = parser(command, listed).parse_args(arguments)
            start_up.end()
            return options.run(options)
        except (KeyboardInterrupt, Exception) as error:
            if is_ctrl_c(error):  # which Mitsuba and Dr.Jit may wrap
                say("interrupted: nothing was finished, nothing is kept")
                return INCOMPLETE
            if isinstance(error, BrokenPipeError) and error.filename is None:
                # the reader of our output has left; leave nothing to flush at exit
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
                return USER_ERROR
            if debug := "--debug" in arguments:
                traceback.print_exception(error)
            plugins = getattr(options, "plugin", ())
            place = _place(error, plugins)
            if place or is_the_users(error):
                cause = error.__cause__ if plugins else None
                own = place or (cause and own_frame(cause))
                more = " (--debug shows the traceback)" if own and not debug else ""
                say(place + sentence(error) + more)
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


def parser(command: str | None = None, listed: Iterable[str] = COMMANDS) -> Parser:
    """Parser of the command line.

    Parameters
    ----------
    command : str, optional
        The command whose options are added; no other one is imported. Default: all.
    listed : iterable of str, optional
        Commands that it knows. Each takes half a millisecond.
    """
    whole = Parser(
        prog=PROGRAM,
        description="A virtual goniophotometer for Mitsuba 3.",
        epilog=(__doc__ or "").strip().partition("\n\n")[2],
    )
    whole.add_argument("--version", action=_Version, nargs=0, help="Show the version.")
    commands = whole.add_subparsers(metavar="COMMAND", title="Commands")
    whole.set_defaults(run=_without_command)
    for name in listed:
        if command is None or command == name:
            _add_command(commands, name)
        else:
            commands.add_parser(name, help=COMMANDS[name])
    return whole


def _add_command(commands: Any, name: str) -> None:
    """Add the parser of one command.

    The docstring of its module is the help, after a first line. ``USAGE`` and ``RARE``
    are the module's own, if it has them.
    """
    module = importlib.import_module(f"{PACKAGES[name]}.commands.{name}")
    _, _, text = (module.__doc__ or "").strip().partition("\n")
    description, examples, more = text.partition("examples:\n")
    own = commands.add_parser(
        name,
        help=COMMANDS[name],
        usage=getattr(module, "USAGE", None),
        description=description.strip(),
        epilog=examples + more,
        rare=getattr(module, "RARE", ()),
    )
    own.set_defaults(run=module.run)
    module.add_options(own)
    for action in own._actions:
        if not action.choices:
            vars(action)["complete"] = "file"  # by shtab, in scripts for shells


class _Version(argparse.Action):
    """Prints the version, and ends the program."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        print(f"{PROGRAM} {__version__}")
        parser.exit()


def _versions(*packages: str) -> str:
    """Installed versions of packages."""
    from importlib import metadata  # slow to import

    return ", ".join(f"{package} {metadata.version(package)}" for package in packages)


def _without_command(_: Namespace) -> NoReturn:
    raise SettingError(
        f"a command must be given, one of {', '.join(COMMANDS)}: {PROGRAM} --help says "
        f"what each does, and {PROGRAM} COMMAND --help lists its options"
    )


def _show_warning(tell: Any, message: object, *_: object, **__: object) -> None:
    tell(f"warning: {' '.join(str(message).split())}")


def _say_of_bug(error: BaseException, arguments: Sequence[str]) -> None:
    """Say that an error is a bug of ours, and keep in a file what a report needs."""
    import platform
    import shlex
    import tempfile

    versions = _versions(PROGRAM, "mitsuba", "drjit", "numpy")
    python = f"Python {platform.python_version()} on {platform.platform()}"
    words = shlex.join([PROGRAM, *arguments])
    trace = "".join(traceback.format_exception(error))
    report = "\n".join([f"{versions}, {python}", words, "", trace])
    try:
        handle, path = tempfile.mkstemp(".txt", f"{PROGRAM}-")
        with open(handle, "wb") as stream:
            stream.write(report.encode("utf-8", "backslashreplace"))
        place = f"the file {path}"
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

"""What the commands share: exit codes, types of arguments, messages, the variant."""

import argparse
import contextlib
import inspect
import re
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

import mitsuba as mi

from .. import llvm
from ..errors import (
    SettingError,
    VariantError,
    did_you_mean,
    no_file,
    printable,
    shortened,
)
from ..instrument.loading import load_plugin_file
from ..instrument.specimen_text import parse_specimen
from ..transport.variants import usable_variants
from .file_kinds import check_kind
from .positionals import with_positionals_first

__all__ = [
    "DEFAULT_VARIANT",
    "DONE",
    "FAILED",
    "UNDECIDED",
    "INCOMPLETE",
    "PROGRAM",
    "USER_ERROR",
    "Parser",
    "UsageError",
    "add_command",
    "add_files",
    "add_json",
    "add_number",
    "add_output",
    "add_record",
    "add_scene_options",
    "add_specimen",
    "check_not_read",
    "add_text",
    "number",
    "number_or_word",
    "pair",
    "say",
    "sentence",
    "set_variant",
    "specimen_of",
    "tell",
]

PROGRAM = "gonio-mi"
DONE, USER_ERROR, INCOMPLETE, FAILED, UNDECIDED = 0, 1, 2, 3, 4

DEFAULT_VARIANT = "llvm_ad_mono"

# Options of other programs, and ours for the same.
ELSEWHERE = {
    **dict.fromkeys(("--angle", "--angles", "--theta", "--incidence"), "--theta-i"),
    **dict.fromkeys(("--azimuth", "--phi"), "--phi-i"),
    **dict.fromkeys(("--samples", "--spp", "--n-rays", "--photons"), "--rays"),
    **dict.fromkeys(("--out", "--file"), "--output"),
}


class _HelpFormatter(argparse.HelpFormatter):
    """Wraps paragraphs to the terminal, but for those with indented lines: examples."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        blocks = []
        for block in text.split("\n\n"):
            if "\n  " in block:
                blocks.append(textwrap.indent(block.rstrip(), indent))
            else:
                blocks.append(super()._fill_text(block, width, indent))
        return "\n\n".join(blocks)


class Parser(argparse.ArgumentParser):
    """Parser whose errors are exceptions, for one sentence and one exit code."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(
            formatter_class=_HelpFormatter,
            allow_abbrev=False,
            **kwargs,
        )
        self.add_argument(
            "--debug",
            action="store_true",
            help="show where in the program an error arose",
        )
        # -1e3 is a number too, before Python 3.14, and -z is an axis
        self._negative_number_matcher = re.compile(r"-(\.?\d|[xyz]$)")

    rare: Sequence[str] = ()
    """Options that ``--help-all`` shows and ``--help`` does not."""

    def print_help(self, file: Any = None) -> None:
        """Print the help, of rare options none and of the others a sentence each."""
        if not self.rare:
            return super().print_help(file)
        texts = [action.help or "" for action in self._actions]
        for action, text in zip(self._actions, texts):
            rare = not {*action.option_strings}.isdisjoint(self.rare)
            action.help = argparse.SUPPRESS if rare else _sentence_and_default(text)
        super().print_help(file)
        for action, text in zip(self._actions, texts):
            action.help = text
        return None

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[Any, list[str]]:
        """Parse, whatever stands before or after the options.

        An option that is none, but much like one, is told before what lacks without it.
        """
        words = sys.argv[1:] if args is None else args
        for word in () if self._subparsers else words:
            name = word.partition("=")[0]
            if name[:2] == "--" and name not in self._option_string_actions:
                known = self._option_string_actions
                ours = ELSEWHERE.get(name.lower().replace("_", "-"))
                # by their likeness a word of another program leads astray
                meant = did_you_mean(name, known)
                if ours in known:
                    meant = f"; did you mean {ours}?"
                if meant:
                    self.error(f"unrecognized arguments: {name}{meant}")
        words = with_positionals_first(self, words)
        found, rest = super().parse_known_args(words, namespace)
        self._check_json(found, rest)
        return found, rest

    def _check_json(self, found: argparse.Namespace, rest: Sequence[str]) -> None:
        """Say so if ``--json``, which prints, is given a file to write."""
        if not getattr(found, "json", False):
            return
        alone = (getattr(found, a.dest, None) for a in self._get_positional_actions())
        for word in (*alone, *rest):
            if not isinstance(word, str) or not word.endswith(".json"):
                continue
            if word in rest or not Path(word).is_file():
                self.error(
                    f"--json takes no file, for it prints: write --json > {word}"
                )

    def error(self, message: str) -> NoReturn:
        """Raise it."""
        choice = re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message)
        if choice:
            message += did_you_mean(choice[1], re.findall(r"[\w-]+", choice[2]))
        raise UsageError(re.sub(r"^argument (\S+): (?=must )", r"\1 ", message))


class _HelpAll(argparse.Action):
    """Prints all of the help, and ends the program."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        print(parser.format_help(), end="")
        parser.exit()


def _sentence_and_default(text: str) -> str:
    """The first sentence of a help text, and what it says of the default."""
    first = re.split(r"(?<=\.) (?=[A-Z0-9`])", text)[0]
    default = re.search(r"Default: .*", text)
    return first if default is None or default[0] in first else f"{first} {default[0]}"


class UsageError(SettingError):
    """Arguments that cannot be parsed."""


def add_command(commands: Any, module: ModuleType) -> None:
    """Add the parser of the command that a module of this package is.

    Its docstring is the help: after the command's name what it does in a line, and then
    the description. ``USAGE`` and ``EXAMPLES`` are the module's own, if it has them.
    """
    heading, _, description = inspect.cleandoc(module.__doc__ or "").partition("\n")
    parser = commands.add_parser(
        module.__name__.rpartition(".")[2],
        help=heading.rpartition("``: ")[2].rstrip("."),
        usage=getattr(module, "USAGE", None),
        description=description.strip(),
        epilog=getattr(module, "EXAMPLES", None),
    )
    parser.set_defaults(run=module.run)
    parser.rare = getattr(module, "RARE", ())
    if parser.rare:
        help_all = "show all options, and all about them, and exit"
        parser.add_argument("--help-all", nargs=0, action=_HelpAll, help=help_all)
    module.add_options(parser)


def add_record(parser: argparse.ArgumentParser) -> None:
    """Add the argument that is a file of a record."""
    parser.add_argument("record", metavar="RECORD", help="an .exr or .npz file")


def add_specimen(parser: argparse.ArgumentParser) -> None:
    """Add the argument that :func:`specimen_of` understands."""
    parser.add_argument(
        "specimen",
        metavar="SPECIMEN",
        help="a Mitsuba scene file, a file of heights (x3p, ...), a mesh (obj, ply, "
        "stl) with --bsdf, or a BSDF such as roughconductor:alpha=0.2",
    )


def add_number(
    group: Any, option: str, metavar: str, text: str, default: float | None = None
) -> None:
    """Add an option that is a number; its help ends with the default, if it has one."""
    if default is not None:
        text += f" (default: {default:g})"
    group.add_argument(option, type=number, default=default, metavar=metavar, help=text)


def add_text(group: Any, option: str, metavar: str, text: str, **how: Any) -> None:
    """Add an option or an argument that is a word, or several if `how` says so."""
    group.add_argument(option, metavar=metavar, help=text, **how)


def add_files(group: Any, *options: str, text: str) -> None:
    """Add an option that takes any number of files, and may be given again."""
    group.add_argument(
        *options, nargs="+", action="extend", default=[], metavar="FILE", help=text
    )


def add_output(group: Any, text: str, quiet: str = "print nothing") -> None:
    """Add the options of what becomes of a result: files, and silence."""
    add_files(group, "-o", "--output", text=text)
    group.add_argument("-q", "--quiet", action="store_true", help=quiet)


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add the option of printing JSON."""
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def add_scene_options(group: Any, variants: Sequence[str] = (DEFAULT_VARIANT,)) -> None:
    """Add the options that say what Mitsuba loads specimens with.

    The default of ``--variant`` is None where a command takes several `variants`.
    """
    group.add_argument(
        "--variant",
        default=variants[0] if len(variants) == 1 else None,
        metavar="V",
        help=f"Mitsuba variant (default: {' and '.join(variants)})",
    )
    plugins = "Python files that register Mitsuba plugins"
    add_files(group, "--plugin", text=plugins)
    group.add_argument(
        "-D",
        nargs="+",
        action="extend",
        default=[],
        type=pair,
        dest="parameters",
        metavar="KEY=VALUE",
        help="values of the $KEY parameters of the scene file",
    )


def check_not_read(specimen: Any, word: str, outputs: Sequence[str]) -> None:
    """Raise ValueError if an output is a file that the specimen is read from."""
    read = [word, *(specimen.values() if isinstance(specimen, dict) else ())]
    named = [one for one in read if isinstance(one, str) and Path(one).is_file()]
    for output in outputs:
        if Path(output).exists() and any(Path(output).samefile(one) for one in named):
            raise SettingError(
                f"the output must not be a file of the specimen, got {output}"
            )


def specimen_of(word: str, options: argparse.Namespace) -> tuple[Any, dict[str, Any]]:
    """Set the variant, run the plugin files, and read the specimen.

    Returns
    -------
    specimen : str or dict
        What ``gonio_mi.measure`` takes.
    parameters : dict
        Values for the ``$name`` parameters of a scene file.
    """
    set_variant(options.variant)
    for path in options.plugin:
        load_plugin_file(path)
    check_kind(word, "specimen")
    specimen = parse_specimen(word)
    if options.parameters and isinstance(specimen, dict):
        raise SettingError(f"-D goes with a scene file, got {word!r}")
    return specimen, dict(options.parameters)


def number(text: str) -> float:
    """Whole number or float; the measurement checks its range."""
    try:
        return int(text)
    except ValueError:
        pass
    try:
        return float(text)
    except ValueError:
        apart = " (numbers are parted by spaces: 0 15.5 30)" if "," in text else ""
        raise argparse.ArgumentTypeError(
            f"must be a number such as 45 or 1e7, got {text!r}{apart}"
        ) from None


def number_or_word(text: str) -> float | str:
    """Float, or the text as it is."""
    try:
        return float(text)
    except ValueError:
        return text


def set_variant(variant: str) -> None:
    """Set a Mitsuba variant that the instrument can use."""
    usable = usable_variants()
    if variant not in usable:
        raise SettingError(
            f"--variant must be one of {', '.join(usable)}, got {variant!r}"
        )
    if variant.startswith("llvm"):
        llvm.check()
    try:
        mi.set_variant(variant)
    except ImportError as error:
        raise VariantError(
            f"the variant {variant} does not work on this machine: {error}"
        ) from error


def pair(text: str) -> tuple[str, str]:
    """Name and value of ``name=value``."""
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise argparse.ArgumentTypeError(f"must look like key=value, got {text!r}")
    return name, value


def tell(result: object) -> None:
    """Print a result; what a file holds cannot command the terminal."""
    print(printable(str(result)), flush=True)


def say(text: str) -> None:
    """Print a line for the user, beside the results, if anyone reads it."""
    with contextlib.suppress(OSError, ValueError):
        print(shortened(f"{PROGRAM}: {text}"), file=sys.stderr)


def sentence(error: BaseException) -> str:
    """One line on an error."""
    if isinstance(error, FileNotFoundError) and error.filename is not None:
        return no_file(error.filename)
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return shortened(str(error))

"""The parser of a command: its help, its errors, and arguments in any order."""

import argparse
import re
import sys
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

from ..errors import SettingError, did_you_mean

# Options of other programs, and ours for the same.
ELSEWHERE = {
    **dict.fromkeys(("--angle", "--angles", "--theta", "--incidence"), "--theta-i"),
    **dict.fromkeys(("--azimuth", "--phi"), "--phi-i"),
    **dict.fromkeys(("--samples", "--spp", "--n-rays", "--photons", "-n"), "--rays"),
    **dict.fromkeys(("--out", "--file"), "--output"),
    "--level": "--effort",
}

# Options that nothing of ours is alike, and what does what they do.
HINTS = {
    "--pitch": "; --size is the extent in x: the pitch, times one less than the points",
    **dict.fromkeys(
        ("--threads", "--cores", "-j"),
        "; all cores are used: taskset -c 0-3 gonio-mi ... takes four of them",
    ),
}

# Parameters of BSDFs, which stand in the word of the specimen.
OF_SPECIMENS = (
    *("alpha", "alpha_u", "alpha_v", "distribution", "reflectance", "roughness"),
    *("int_ior", "ext_ior", "eta", "material"),
)


class UsageError(SettingError):
    """Arguments that cannot be parsed."""


class _HelpFormatter(argparse.HelpFormatter):
    """Wraps paragraphs to the terminal, except those with indented lines: examples."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        blocks = []
        for block in text.split("\n\n"):
            if "\n  " in block:
                blocks.append(textwrap.indent(block.rstrip(), indent))
            else:
                blocks.append(super()._fill_text(block, width, indent))
        return "\n\n".join(blocks)


class Parser(argparse.ArgumentParser):
    """Parser whose errors are exceptions, for one sentence and one exit code.

    Parameters
    ----------
    rare : sequence of str
        Options that ``--help-all`` shows and ``--help`` does not.
    **kwargs
        Of :class:`argparse.ArgumentParser`.
    """

    def __init__(self, rare: Sequence[str] = (), **kwargs: Any) -> None:
        kwargs |= {"formatter_class": _HelpFormatter, "add_help": False}
        super().__init__(allow_abbrev=False, **kwargs)
        self.rare = rare
        self._positionals.title, self._optionals.title = "Arguments", "Options"
        self.add_argument("-h", "--help", action="help", help="Show this help.")
        if rare:
            text = "Show the help of all options."
            self.add_argument("--help-all", nargs=0, action=_HelpAll, help=text)
        text = "Show the traceback of an error."
        self.add_argument("--debug", action="store_true", help=text)
        # -1e3 is a number too, before Python 3.14, and -z is an axis
        self._negative_number_matcher = re.compile(r"-(\.?\d|[xyz]$)")

    def print_help(self, file: Any = None) -> None:
        """Print the help, of rare options none and of the others a sentence each."""
        texts = [action.help or "" for action in self._actions] if self.rare else []
        for action, text in zip(self._actions, texts):
            rare = not {*action.option_strings}.isdisjoint(self.rare)
            action.help = argparse.SUPPRESS if rare else _sentence_and_default(text)
        super().print_help(file)
        for action, text in zip(self._actions, texts):
            action.help = text

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[Any, list[str]]:
        """Parse, whatever stands before or after the options."""
        words = sys.argv[1:] if args is None else args
        if not self._subparsers:
            self._check_options(words)
        words = _with_positionals_first(self, words)
        found, rest = super().parse_known_args(words, namespace)
        self._check_json(found, rest)
        return found, rest

    def _check_options(self, words: Sequence[str]) -> None:
        """Name the option that an unknown one resembles, before missing arguments."""
        known = self._option_string_actions
        for word, after in zip(words, [*words[1:], ""]):
            name, equals, value = word.partition("=")
            if not name.startswith("-") or name in known:
                continue
            if name[:2] != "--" and name not in (ELSEWHERE | HINTS):
                continue
            ours = ELSEWHERE.get(name.lower().replace("_", "-"))
            # the likeness of another program's word would mislead
            meant = did_you_mean(name, known)
            if ours in known:
                meant = f"; did you mean {ours}?"
            elif name != "--pitch" or "--size" in known:
                meant = HINTS.get(name, meant)
            role = (ours or name).removeprefix("--").replace("-", "_")
            metavars = {action.metavar for action in self._get_positional_actions()}
            for takes in metavars & {"SPECIMEN", "BSDF", "MODEL"}:
                if role in OF_SPECIMENS:
                    value = value if equals else after
                    meant = f"; say {takes}:{role}={value}"
            if role in ("theta_i", "phi_i") and "--columns" in known:
                meant = f"; for a table without this angle say --columns {role}=30"
            if meant:
                self.error(f"unrecognized arguments: {name}{meant}")

    def _check_json(self, found: argparse.Namespace, rest: Sequence[str]) -> None:
        """Refuse a file name after ``--json``, which prints."""
        if not getattr(found, "json", False):
            return
        alone = (getattr(found, a.dest, None) for a in self._get_positional_actions())
        words = [word for word in (*alone, *rest) if isinstance(word, str)]
        for word in (one for one in words if one.endswith(".json")):
            if word in rest or not Path(word).is_file():
                said = f"write --json > {word}"
                self.error(f"--json takes no file, for it prints: {said}")

    def error(self, message: str) -> NoReturn:
        """Raise it."""
        choice = re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message)
        if choice:
            message += did_you_mean(choice[1], re.findall(r"[\w-]+", choice[2]))
        raise UsageError(re.sub(r"^argument (\S+): (?=must )", r"\1 ", message))


class _HelpAll(argparse.Action):
    """Prints the help of all options, and ends the program."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        print(parser.format_help(), end="")
        parser.exit()


def _sentence_and_default(text: str) -> str:
    """First sentence of a help text, and its default."""
    first = re.split(r"(?<=\.) (?=[A-Z0-9`])", text)[0]
    default = re.search(r"Default: .*", text)
    return first if default is None or default[0] in first else f"{first} {default[0]}"


# ------------------------------------------- arguments before and after the options
#
# argparse gives an option of several values all words up to the next option. Where an
# argument is missing then, as in ``--theta-i 0 30 diffuse``, the last word of one of
# them is meant for it.


def _with_positionals_first(
    parser: argparse.ArgumentParser, words: Sequence[str]
) -> list[str]:
    """Arguments in an order that argparse understands.

    If fewer than the required arguments stand alone, the word that an option of several
    values cannot take, or else the last word of the last option that takes any, goes to
    the front. Values that convert stay with their option.
    """
    required = sum(
        not action.option_strings and action.nargs not in ("?", "*")
        for action in parser._actions
    )
    alone = 0
    # last words of options that have taken at least two
    misplaced, free = [], []
    for action, start, end in _pieces(parser, words):
        n = end - start
        if action is None:
            alone += n
        elif action.nargs != "+":
            alone += max(0, n - {None: 1, "?": 1, 0: 0}.get(action.nargs, n))
        elif n > 1:
            misplaced += [end - 1] if _refuses(action, words[end - 1]) else []
            free += [end - 1] if action.type is None else []
    places = (misplaced or free) if alone < required else []
    for at in places[-1:]:
        return [words[at], *words[:at], *words[at + 1 :]]
    return list(words)


def _refuses(action: argparse.Action, word: str) -> bool:
    """Whether a word cannot be a value of an option."""
    try:
        if callable(action.type):
            action.type(word)
    except (ValueError, TypeError, argparse.ArgumentTypeError):
        return True
    return False


def _pieces(
    parser: argparse.ArgumentParser, words: Sequence[str]
) -> Iterator[tuple[argparse.Action | None, int, int]]:
    """Options and the places of the words up to the next one; None at the beginning."""
    action, start = None, 0
    for number, word in enumerate(words):
        name, sign, _ = word.partition("=")
        found = parser._option_string_actions.get(name)
        if found is not None:
            yield action, start, number
            # a value after = leaves none to be taken from behind
            action, start = (None if sign else found), number + 1
    yield action, start, len(words)

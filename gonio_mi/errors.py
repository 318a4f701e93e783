"""The errors a caller would act on, and the checks that word them alike."""

from __future__ import annotations

import builtins
import contextlib
import functools
import itertools
import math
import operator
import os
import re
import sys
import traceback
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, NamedTuple, SupportsIndex, TypeVar

if TYPE_CHECKING:
    from pathlib import Path

# Characters of a message, of a word in it, and of a value that it repeats.
MAX_MESSAGE, MAX_WORD, MAX_VALUE = 400, 120, 80

# Characters of a specimen's name where two stand beside each other.
LABEL = 60


def printable(text: str) -> str:
    r"""Text in which what a terminal would obey is escaped, but for line breaks.

    A file may hold any text, and an escape sequence in it could do anything to the
    window of whoever looks at it. ``"\x1b[2J"`` becomes ``"\\x1b[2J"``.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)


def shortened(text: str) -> str:
    """One line of at most `MAX_MESSAGE` characters, without the middle of a longer."""
    line = " ".join(printable(" ".join(text.split())).split())
    words = (_without_middle(word, MAX_WORD) for word in line.split(" "))
    return _without_middle(" ".join(words), MAX_MESSAGE)


def abridged(text: str, longest: int) -> str:
    """Text of at most `longest` characters, cut after a parameter or else a word.

    Three dots say that more would follow.
    """
    if len(text) <= longest:
        return text
    head = text[: longest - 4]
    for ends in (",;", " "):
        end = 1 + max(head.rfind(one) for one in ends)
        if end > longest // 3:
            return f"{head[:end].rstrip()} ..."
    return f"{head}..."


def abridged_apart(texts: Sequence[str], longest: int) -> list[str]:
    """Texts of at most `longest` characters each, that differ where the texts do.

    What all begin with is left out where their ends tell them apart.
    """
    short = [abridged(text, longest) for text in texts]
    if len(set(short)) < len(set(texts)):
        ends = zip(min(texts), max(texts))  # what these begin with, all do
        alike = sum(1 for _ in itertools.takewhile(lambda pair: len({*pair}) < 2, ends))
        # from the parameter, or the middle of a long name
        start = max(texts[0].rfind(",", 0, alike) + 1, alike - longest // 2)
        short = [abridged(f"... {text[start:]}", longest) for text in texts]
    return short


def number_of(n: SupportsIndex, noun: str) -> str:
    """Number and noun: ``1 row``, ``2 rows``."""
    return f"{n} {noun}{'s' if n != 1 else ''}"


def shown(value: object, longest: int = MAX_VALUE) -> str:
    """How a message repeats a value: its ``repr``, shortened."""
    return _without_middle(printable(repr(value)), longest)


def no_file(path: str | os.PathLike[str]) -> str:
    """What every command and plugin says of a file that is not there."""
    name = printable(os.fspath(path))
    if os.path.isdir(path):
        return f"{name} is a folder, not a file"
    return f"there is no file {name}"


def check_regular(path: str | os.PathLike[str]) -> None:
    """Raise FileFormatError for a pipe or device, which may have no end."""
    if os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path)):
        name = printable(os.fspath(path))
        raise FileFormatError(f"{name} is a pipe or a device, not a file to read")


def _without_middle(text: str, longest: int) -> str:
    """Beginning and end of a text, which tell more than its middle."""
    if len(text) <= longest:
        return text
    head = (longest - 3) * 2 // 3
    return f"{text[:head]}...{text[head + 3 - longest :]}"


Choice = TypeVar("Choice", bound=str)


class VariantError(RuntimeError):
    """No Mitsuba variant is set, or one that the instrument cannot use."""


class LLVMError(RuntimeError):
    """Dr.Jit would find no LLVM library that it can use."""


class LostRaysError(RuntimeError):
    """A measurement whose ledger does not hold all rays that were sent."""


class LostLightWarning(RuntimeWarning):
    """More light than chance would take is in no patch, or missed the specimen."""


class FinerPatchesWarning(RuntimeWarning):
    """The collector is finer than the patches in which the material was measured."""


class SettingError(ValueError):
    """What a user gave is not what it must be; other ValueErrors are bugs of ours.

    Its message may quote what others wrote: see :func:`shortened`.
    """

    def __init__(self, message: object) -> None:
        super().__init__(shortened(str(message)))


class SettingTypeError(SettingError, TypeError):
    """What a user gave has the wrong type."""


class PackageError(ImportError):
    """A package is missing that only some of the instrument needs."""


def to_install(extra: str) -> str:
    """How to install the packages of an extra: gonio-mi is in no index of packages."""
    return f'run pip install ".[{extra}]" in a checkout of gonio-mi'


class SpecimenError(SettingError):
    """A specimen or scene that cannot be loaded or is not measurable."""


class FileFormatError(SettingError):
    """A file that is not one of ours, is damaged, or is of an unknown version."""


# How Mitsuba begins what it says when a plugin gives up, and Dr.Jit where memory ends.
_MITSUBA = r"\[\w+\.(cpp|h):\d+\]|jit_malloc\(\): out of memory"

# Lines of a traceback in a text, with the first file, and the class of its error.
_TRACED = r'(?m)^  File "(.+)", .*\n(?:  .*\n)*(?:\w+\.)*(\w+)'

# How such a text ends after Ctrl-C.
_PRESSED = r"(?m)^KeyboardInterrupt\b.*\s*\Z"

_USERS = (
    *(LLVMError, LostRaysError, PackageError, SettingError, VariantError),
    *(MemoryError, OSError),
)


def is_the_users(error: BaseException) -> bool:
    """Whether an error is the user's to mend, and not a bug of ours.

    That is what the checks of the instrument raise, what files and the memory do, and
    what Mitsuba refuses.
    """
    refused = isinstance(error, RuntimeError) and re.search(_MITSUBA, str(error))
    return isinstance(error, _USERS) or bool(refused and not tells_of_our_bug(error))


def is_ctrl_c(error: BaseException | None) -> bool:
    """Whether Ctrl-C is at the bottom of it.

    Dr.Jit wraps what a loop raises; of what a plugin raises while it is loaded, only
    Mitsuba's text survives.
    """
    seen: list[BaseException] = []
    while error is not None and error not in seen:  # errors may be their causes' causes
        if isinstance(error, KeyboardInterrupt):
            return True
        if isinstance(error, RuntimeError) and re.search(_PRESSED, str(error)):
            return True
        seen.append(error)
        error = error.__cause__ or error.__context__
    return False


def tells_of_our_bug(error: BaseException) -> bool:
    """Whether the text of an error tells of a bug in one of our plugins.

    Of what a plugin raises while it is loaded, only Mitsuba's text about it survives.
    The traceback in it shows the plugin's file first, after what loads it.
    """
    traced = re.search(_TRACED, str(error).rpartition(", in loaded\n")[2])
    if traced is None or os.path.dirname(__file__) not in traced[1]:
        return False
    kind = globals().get(traced[2], getattr(builtins, traced[2], Exception))
    # the last two are Mitsuba's, the latter of a property that is no text
    return not issubclass(kind, (*_USERS, RuntimeError, UnicodeDecodeError))


class OpenQuestionsError(FileFormatError):
    """A text that leaves questions open."""

    def __init__(self, message: str, place: str, questions: Sequence[str]) -> None:
        super().__init__(message)
        self.place, self.questions = place, list(questions)


def check_nothing_open(place: str, questions: Sequence[str]) -> None:
    """Raise OpenQuestionsError with all questions on the text at `place`.

    Several questions leave no room for the folder: a long message loses its middle.
    """
    if not questions:
        return
    message = f"{place}: {questions[0]}"
    if len(questions) > 1:
        each = "; ".join(f"({i}) {one}" for i, one in enumerate(questions, 1))
        message = f"{os.path.basename(place)} leaves open: {each}"
    raise OpenQuestionsError(message, place, questions)


class Frame(NamedTuple):
    """A line of a traceback."""

    file: str
    line: int
    function: str


def frames(error: BaseException) -> list[Frame]:
    """Lines that an error came through, the innermost last.

    Those of another process follow, if they are in its attribute `frames`.
    """
    here = []
    for frame, line in traceback.walk_tb(error.__traceback__):
        here.append(Frame(frame.f_code.co_filename, line, frame.f_code.co_name))
    return here + getattr(error, "frames", [])


# What an installer manages, and this package; others' packages may be a user's own, or
# those of the Python beneath a virtual environment.
_PACKAGES = {"site-packages", "dist-packages"}


@functools.cache
def _installed() -> tuple[Path, ...]:
    """Folders of this package and of what is installed."""
    import sysconfig  # with the other slow to import
    from pathlib import Path

    names = ("stdlib", "platstdlib", "purelib", "platlib")
    folders = (Path(sysconfig.get_paths()[name]).resolve() for name in names)
    return Path(__file__).resolve().parent, *folders


def is_installed(path: Path) -> bool:
    """Whether a file belongs to this package or to one that is installed."""
    ours = any(path.is_relative_to(folder) for folder in _installed())
    return ours or not _PACKAGES.isdisjoint(path.parts)


def own_frame(error: BaseException) -> Frame | None:
    """The innermost line of the user's own code that an error came through, if any."""
    from pathlib import Path

    for frame in reversed(frames(error)):
        path = Path(frame.file).resolve()
        if path.is_file() and not is_installed(path):
            return frame
    return None


def own_place(error: BaseException) -> str:
    """File and line of :func:`own_frame`, in brackets behind a space; or nothing."""
    frame = own_frame(error)
    return f" ({os.path.basename(frame.file)}, line {frame.line})" if frame else ""


# Warnings of this package so far, those that are left out included.
_warned = [0]

# How warnings begin that are left out, as a regular expression.
_muted: ContextVar[str | None] = ContextVar("_muted", default=None)


@contextlib.contextmanager
def muted(pattern: str) -> Iterator[None]:
    """Context without those warnings of this package that begin like a pattern.

    The filters of :mod:`warnings` are the user's, and one for all threads.
    """
    before = _muted.set(pattern)
    try:
        yield
    finally:
        _muted.reset(before)


def warned() -> int:
    """Return the number of calls of :func:`warn` so far, in any thread."""
    return _warned[0]


def warn(message: str, category: type[Warning] = RuntimeWarning) -> None:
    """Warn at the line that called this package."""
    _warned[0] += 1
    pattern = _muted.get()
    if pattern is not None and re.match(pattern, message):
        return
    package = os.path.dirname(__file__) + os.sep
    frame, level, outermost = sys._getframe(1), 2, 2
    while frame.f_back is not None:
        frame, level = frame.f_back, level + 1
        if frame.f_code.co_filename.startswith(package):
            outermost = level
    warnings.warn(message, category, stacklevel=outermost + 1)


def checked_count(
    name: str,
    value: Any,
    minimum: int = 1,
    maximum: int | None = None,
    reason: str = "",
) -> int:
    """Return `value` as an int, or say which of `name`'s conditions it violates.

    Whole floats such as ``1e6`` are accepted; booleans, fractions, NaN are not. The
    message has the `reason` of the minimum, if one is given.
    """
    try:
        if isinstance(value, bool):
            raise TypeError
        number = (
            int(value)
            if isinstance(value, float) and value.is_integer()
            else operator.index(value)
        )
    except TypeError:
        raise SettingTypeError(
            f"{name} must be a whole number, got {shown(value)}"
        ) from None
    if number < minimum:
        least = f"{minimum}, {reason}" if reason else str(minimum)
        raise SettingError(f"{name} must be at least {least}, got {shown(value)}")
    if maximum is not None and number > maximum:
        raise SettingError(f"{name} must be at most {maximum:.3g}, got {shown(value)}")
    return number


def checked_number(
    name: str, value: Any, low: float, high: float, condition: str
) -> float:
    """Return `value` as a float in ``[low, high)``, or say what it must be.

    A boolean, NumPy's too, is no number.
    """
    try:
        if isinstance(value, bool) or str(getattr(value, "dtype", "")) == "bool":
            raise TypeError
        number = float(value)
    except OverflowError:
        number = math.inf  # a whole number beyond all floats
    except (TypeError, ValueError):
        raise SettingTypeError(
            f"{name} must be {condition}, got {shown(value)}"
        ) from None
    if not math.isfinite(number) or not low <= number < high:
        raise SettingError(f"{name} must be {condition}, got {shown(value)}")
    return number


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """End of a message on a word that is not `known`: the one that is most like it.

    Empty if none is.
    """
    import difflib  # slow to import

    similar = difflib.get_close_matches(word, list(known), 1, 0.8)
    return f"; did you mean {similar[0]}?" if similar else ""


def checked_choice(name: str, value: Choice, choices: Iterable[Choice]) -> Choice:
    """Return `value` if it is one of `choices`."""
    if value not in choices:
        raise SettingError(
            f"{name} must be one of {', '.join(choices)}, got {shown(value)}"
        )
    return value


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

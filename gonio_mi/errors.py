"""The errors a caller would act on, and the checks that word them alike."""

import math
import operator
import traceback
from typing import NamedTuple

__all__ = [
    "FileFormatError",
    "Frame",
    "LLVMError",
    "SpecimenError",
    "VariantError",
    "checked_choice",
    "checked_count",
    "checked_number",
    "frames",
]


class VariantError(RuntimeError):
    """No Mitsuba variant is set, or one that the instrument cannot use."""


class LLVMError(RuntimeError):
    """Dr.Jit would find no LLVM library that it can use."""


class SpecimenError(ValueError):
    """A specimen or scene that cannot be loaded or is not measurable."""


class FileFormatError(ValueError):
    """A file that is not one of ours, is damaged, or is of an unknown version."""


class Frame(NamedTuple):
    """A line of a traceback."""

    file: str
    line: int
    function: str
    module: str


def frames(error: BaseException) -> list[Frame]:
    """Lines that an error came through, the innermost last.

    Those of another process follow, if they are in its attribute `frames`.
    """
    here = []
    for frame, line in traceback.walk_tb(error.__traceback__):
        code, module = frame.f_code, frame.f_globals.get("__name__", "")
        here.append(Frame(code.co_filename, line, code.co_name, module))
    return here + getattr(error, "frames", [])


def checked_count(name, value, minimum=1, maximum=None):
    """Return `value` as an int, or say which of `name`'s conditions it violates.

    Whole floats such as ``1e6`` are accepted; booleans, fractions, NaN are not.
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
        raise TypeError(f"{name} must be a whole number, got {value!r}") from None
    if number < minimum:
        raise ValueError(f"{name} must be at least {minimum}, got {value!r}")
    if maximum is not None and number > maximum:
        raise ValueError(f"{name} must be at most {maximum:.3g}, got {value!r}")
    return number


def checked_number(name, value, low, high, condition):
    """Return `value` as a float in ``[low, high)``, or say what it must be."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be {condition}, got {value!r}") from None
    if not math.isfinite(number) or not low <= number < high:
        raise ValueError(f"{name} must be {condition}, got {value!r}")
    return number


def checked_choice(name, value, choices):
    """Return `value` if it is one of `choices`."""
    if value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(choices)}, got {value!r}")
    return value

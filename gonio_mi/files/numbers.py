"""Numbers in text, as instruments and spreadsheets write them."""

import re
from collections.abc import Sequence

import numpy as np

from ..array_types import Floats
from ..errors import SettingError, shown

DECIMAL = re.compile(
    r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?|[+-]?(nan|inf|infinity)",
    re.ASCII | re.IGNORECASE,
)

# What most numbers are written with: all that Python reads of it is a DECIMAL.
DECIMAL_LETTERS = "0123456789+-.eE "

# More characters than any number needs.
MAX_DIGITS = 100


def without_degrees(text: str) -> str:
    """Text without one sign of degrees at its end, as angles may have it."""
    return text.strip().removesuffix("°").rstrip()


def is_decimal(text: str) -> bool:
    """Whether `text` is a number as :func:`decimal` takes it."""
    word = text.strip()
    return len(word) <= MAX_DIGITS and DECIMAL.fullmatch(word) is not None


def decimal(text: str) -> float:
    """Return the number that `text` is, as instruments and spreadsheets write them.

    Python's ``float`` takes ``0_3`` for 3, and digits of other scripts.

    Raises
    ------
    ValueError
        If it is no number.
    """
    if not is_decimal(text):
        raise SettingError(f"must be a number, got {shown(text)}")
    return float(text)


def decimals(cells: Sequence[str]) -> Floats | None:
    """Numbers of many cells, as of :func:`decimal`; None where one is unusual."""
    longest = max(map(len, cells), default=0)
    if longest > MAX_DIGITS or not set("".join(cells)) <= set(DECIMAL_LETTERS):
        return None
    try:
        return np.array(list(map(float, cells)))
    except ValueError:
        return None

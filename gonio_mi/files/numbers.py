"""Numbers in text files."""

import re

from ..errors import SettingError, shown

__all__ = ["decimal", "is_decimal"]

DECIMAL = re.compile(
    r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?|[+-]?(nan|inf|infinity)",
    re.ASCII | re.IGNORECASE,
)

# More digits than any number needs.
LONGEST = 100


def is_decimal(text: str) -> bool:
    """Whether `text` is a number as :func:`decimal` takes it."""
    word = text.strip()
    return len(word) <= LONGEST and DECIMAL.fullmatch(word) is not None


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

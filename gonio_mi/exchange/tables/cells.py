"""Numbers in the cells of a text, and what stands for none."""

import re
from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np

from ...array_types import Flags, Floats
from ...errors import FileFormatError, shown
from ...files.numbers import decimal, decimals, is_decimal, without_degrees
from .names import ANGLES, Column

# What stands for no value, in cells, and in columns of angles and uncertainties.
MISSING = re.compile(r"|nan|--?|n/?a|null|-9{2,}(\.[09]*)?", re.IGNORECASE)
MISSING_CODES = (-99, -999, -9999)


def without_value(cells: Iterable[str]) -> tuple[Flags, set[str]]:
    """Which cells hold no value, and the texts that say so."""
    missing = [MISSING.fullmatch(cell.strip()) for cell in cells]
    return np.array(missing, dtype=bool), {match[0] for match in missing if match}


def column_numbers(
    place: str, column: Column, lines: Iterable[int], cells: Any
) -> Floats:
    """Numbers of a column, or FileFormatError if one is none or not finite."""
    numbers = decimals(cells)
    if numbers is not None and np.isfinite(numbers).all():
        return numbers
    each = zip(lines, cells)
    return np.array([_number(place, column, line, cell) for line, cell in each])


def _number(place: str, column: Column, line: int, cell: str) -> float:
    """Number in a cell, or FileFormatError if it is none or not finite."""
    in_degrees = column.role in ANGLES and column.unit != "rad"
    text = without_degrees(cell) if in_degrees else cell
    number = decimal(text) if is_decimal(text) else None
    if number is not None and np.isfinite(number):
        return number
    finite, got = ("", shown(cell)) if number is None else ("finite ", cell.strip())
    raise FileFormatError(
        f"{place}, line {line}, column {column.name}: must be a {finite}number"
        f", got {got}"
    )


def without_number(
    arrays: Mapping[str, Floats], roles: Collection[str]
) -> tuple[Flags, set[str], dict[str, Floats]]:
    """Rows with a missing-value code in columns of these roles, the codes, azimuths.

    At the normal a direction needs no azimuth: there it is 0.
    """
    gone, found, azimuths = np.zeros(len(arrays["value"]), dtype=bool), set(), {}
    for role in roles:
        column = arrays[role]
        none = np.isin(column, MISSING_CODES)
        if role in ANGLES and (column[~none] < 0).any():
            none &= column < -180  # beside other negative angles, -99 is one
        if role in ("phi_i", "phi_o"):
            normal = none & (arrays[role.replace("phi", "theta")] == 0)
            azimuths[role] = np.where(normal, 0.0, column)
            none &= ~normal
        found |= {f"{code:g}" for code in column[none]}
        gone |= none
    return gone, found, azimuths

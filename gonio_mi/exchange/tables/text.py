"""Text of tables as programs, instruments and spreadsheets write it: lines and cells.

Tabs, semicolons, commas or blanks between the cells; commas or points in the numbers;
a byte-order mark; comments; lines of a title above the names of the columns.
"""

import contextlib
import csv
import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path

from ...errors import FileFormatError, shown
from ...files.numbers import decimal, is_decimal, without_degrees
from .names import ANGLES, recognised, unit_of

# Characters of a line; no table has more, and an image in text has.
MAX_LINE = 10_000

# Lines of a title, at most, above the names of the columns.
MAX_TITLES = 200

# Line above a scan in the own text of REFLET instruments (their export "LightTools").
# Ansys's converter scales these with a reflectance from another file.
REFLET_HEAD = "Theta Lighting"

DELIMITERS = {"\t": "tabs", ";": "semicolons", ",": "commas", " ": "blanks"}
COMMENTS = ("#", "%", "!", "//")

# A line number and its text, or its cells.
Line = tuple[int, str]
Row = tuple[int, list[str]]


@dataclass
class TextTable:
    """A text cut into its parts.

    Attributes
    ----------
    place : str
        The file, for messages.
    number : int
        Line of the names.
    names : list of str
        Of the columns.
    rows : list of (int, list of str)
        Lines of values, one for each name, numbers with a decimal point.
    decimal_comma : bool
        Whether the text has commas instead.
    comments, titles : list of (int, str)
        Lines of comments without their marks, and lines above the names of columns.
    """

    place: str
    number: int
    names: list[str]
    rows: list[Row]
    decimal_comma: bool
    comments: list[Line] = field(default_factory=list)
    titles: list[Line] = field(default_factory=list)


def split_text(
    path: str | PathLike[str], known: Callable[[str], bool], wanted: str
) -> TextTable:
    """Parts of the text of a file.

    Parameters
    ----------
    path : str or path
    known : callable
        Whether a name is that of a column. The line with most of them, at least two,
        before the first row of numbers names the columns.
    wanted : str
        What to ask for if no line names any.

    Raises
    ------
    OSError
        If it cannot be opened.
    FileFormatError
        If it is no text, or has no names or no rows.
    """
    comments, lines = _comments_and_lines(path)
    place = str(path)
    if not lines:
        raise FileFormatError(f"{path} is empty: it has no line of column names")
    first = next((i for i, (_, text) in enumerate(lines) if is_row(text)), len(lines))
    candidates = [*comments, *lines[: min(first, MAX_TITLES)]]
    row = lines[first : first + 1]
    n_known, number, delimiter = _best_names(candidates, row, known)
    for i in range(min(first, len(lines) - 1, MAX_TITLES)):
        if matrix := _matrix(place, lines[i:]):
            return replace(matrix, comments=comments, titles=lines[:i])
    if n_known < 2:
        if any(text.startswith(REFLET_HEAD) for _, text in lines):
            raise FileFormatError(
                f"{path} is a scan of a REFLET goniophotometer, whose values have no "
                "stated scale: export it for Zemax, .bsdf, with the reflectance"
            )
        number, text = lines[0]
        raise FileFormatError(
            f"{path}, line {number}: must name the columns {wanted}, got "
            f"{shown(text)}; where other names stand for them, say each: --columns "
            "theta_i=NAME theta_o=NAME value=NAME"
        )
    text = dict(candidates)[number]
    rows = [line for line in lines if line[0] > number]
    if not rows:
        raise FileFormatError(f"{path} has no values: nothing follows line {number}")
    names = [cell.strip() for cell in cut(text, delimiter)]
    units = [cell.strip().strip("[]()") for cell in cut(rows[0][1], delimiter)]
    has_units = len(units) == len(names) and all(map(unit_of, units))
    # units that are all 1 look like a row of values
    if len(rows) > 1 and has_units and not is_row(rows[0][1]):
        names = [f"{name} [{unit}]" for name, unit in zip(names, units)]
        rows = rows[1:]
    comments = [line for line in comments if line[0] != number]
    titles = [line for line in lines if line[0] < number]
    whole = _rows(place, rows, delimiter, len(names))
    return TextTable(place, number, names, *whole, comments, titles)


def _matrix(place: str, lines: Sequence[Line]) -> TextTable | None:
    """Table of three columns from a matrix, whose first cell names its angles.

    That of the rows, or of rows and columns: ``theta_o/theta_i``.
    """
    number, head = lines[0]
    for delimiter in DELIMITERS:
        corner, *across = cut(head, delimiter)
        first = cut(lines[1][1], delimiter)
        alike = len(across) > 1 and len(first) == 1 + len(across)
        angles = [_number(cell) for cell in (corner, first[0], *across)]
        if not alike or angles[0] is not None or None in angles[1:]:
            continue
        whole = recognised(corner)
        parts = [corner] if whole else re.split(r"[\\/|]", corner)
        found = [column for column in map(recognised, parts) if column]
        roles = [column.role for column in found]
        if len(roles) < 2 and any(abs(angle or 0) > 90 for angle in angles[2:]):
            continue  # wavelengths
        if roles in (["theta_o"], ["theta_i"]):
            roles += {"theta_o", "theta_i"} - set(roles)
        if len(roles) != 2 or not set(roles) < {*ANGLES}:
            raise FileFormatError(
                f"{place}, line {number}: the first cell of a matrix must name the "
                f"angles of its rows and columns, as theta_o/theta_i, got {corner!r}"
            )
        unit = next((f" [{one.unit}]" for one in found if one.unit), "")
        cells, commas = _rows(place, lines[1:], delimiter, 1 + len(across))
        rows = [
            (n, [row[0], str(angle), value])
            for n, row in cells
            for angle, value in zip(angles[2:], row[1:])
        ]
        names = [*(role + unit for role in roles), "value"]
        return TextTable(place, number, names, rows, commas)
    return None


def _rows(
    place: str, lines: Sequence[Line], delimiter: str, n: int
) -> tuple[list[Row], bool]:
    """Rows of `n` cells, numbers with a decimal point; whether the text has commas.

    That is where numbers are written with commas, and none with a point.
    """
    rows = [(number, cut(line, delimiter)) for number, line in lines]
    for number, cells in rows:
        if len(cells) != n:
            raise FileFormatError(
                f"{place}, line {number}: must have {n} values separated by "
                f"{DELIMITERS[delimiter]}, got {len(cells)}"
            )
    numbers = [without_degrees(cell) for _, cells in rows for cell in cells]
    commas = any("," in one and _number(one) is not None for one in numbers)
    commas = commas and not any("." in one for one in numbers if is_decimal(one))
    if commas:
        rows = [(n, [cell.replace(",", ".", 1) for cell in row]) for n, row in rows]
    return rows, commas


def _number(cell: str) -> float | None:
    """Number of a cell with a decimal point or comma; None if it is none."""
    text = cell.replace(",", ".", 1)
    return decimal(text) if is_decimal(text) else None


def _comments_and_lines(path: str | PathLike[str]) -> tuple[list[Line], list[Line]]:
    """Comments without their marks, and the other lines that are not empty."""
    comments: list[Line] = []
    lines: list[Line] = []
    for number, line in enumerate(io.StringIO(decoded(path), newline=None), 1):
        text = line.strip(" \r\n\f\v").rstrip("\t")
        if len(text) > MAX_LINE:
            raise FileFormatError(
                f"{path}, line {number}: must have at most {MAX_LINE} characters, "
                f"got {len(text)}"
            )
        if text.startswith(COMMENTS):
            comments.append((number, text.lstrip("#%!/ ")))
        elif text.strip():
            lines.append((number, text))
    return comments, lines


def _best_names(
    candidates: Sequence[Line], row: Sequence[Line], known: Callable[[str], bool]
) -> tuple[int, int, str]:
    """Number of names that are known, the line that holds most, and its delimiter.

    One that cuts the line into as many cells as the first row, if there is one, wins.
    """
    best = False, 0, 0, 0, ","
    for order, delimiter in enumerate(DELIMITERS):
        n_cells = [len(cut(text, delimiter)) for _, text in row]
        for number, text in candidates:
            cells = cut(text, delimiter)
            n_known = sum(map(known, cells))
            fits = n_known > 0 and len(cells) > 1 and [len(cells)] == n_cells
            best = max(best, (fits, n_known, -order, number, delimiter))
    return best[1], best[3], best[4]


def decoded(path: str | PathLike[str]) -> str:
    """Text of a file in UTF-8, or UTF-16 with its mark, or else as Windows has it."""
    content = Path(path).read_bytes()
    marks = (b"\xff\xfe", b"\xfe\xff")
    encodings = ("utf-16",) if content.startswith(marks) else ("utf-8-sig", "cp1252")
    for encoding in encodings:
        with contextlib.suppress(ValueError):
            text = content.decode(encoding)
            if not re.search(r"[\0-\x08\x0e-\x1f\x7f-\x9f]", text):
                return text.replace("\N{MINUS SIGN}", "-")
    raise FileFormatError(f"{path} is not a table of values: it is not text")


def cut(line: str, delimiter: str) -> list[str]:
    """Cells of a line."""
    if delimiter == " ":
        return line.split()
    if '"' in line:
        line = re.sub(f'{re.escape(delimiter)}[ ]+"', f'{delimiter}"', line)
        return next(csv.reader([line], delimiter=delimiter))
    return line.split(delimiter)


def is_row(line: str) -> bool:
    """Whether a line holds at least two numbers and nothing else."""
    for delimiter in DELIMITERS:
        cells = [without_degrees(cell) for cell in cut(line, delimiter)]
        if len(cells) > 1 and None not in map(_number, cells):
            return True
    return False

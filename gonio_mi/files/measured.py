"""Tables of measured values from files: plain CSV, and text after ASTM E1392."""

import csv
import difflib
import io
import math
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import (
    FileFormatError,
    SettingError,
    checked_choice,
    checked_number,
    shown,
)
from . import astm
from .measured_table import (
    COLUMNS,
    NUMBERS,
    QUANTITIES,
    TEXTS,
    UNITS,
    MeasuredTable,
    fits,
)
from .numbers import decimal, is_decimal

__all__ = ["MeasuredTable", "read_measured"]

# Characters of a line; no table has more, and an image in text has.
LONGEST_LINE = 10_000


def read_measured(
    path: str | PathLike[str], channel: str | None = None
) -> MeasuredTable:
    """Read measured values from a plain CSV file, or from text after ASTM E1392.

    A CSV file has comment lines ``# key: value``, one line with the names of the
    columns, and one line for each value, separated by commas::

        # units: 1/sr
        # quantity: brdf
        # uncertainty: 0.005
        # aperture_half_angle: 0.75
        # emitter_half_angle: 0.25
        theta_i,phi_i,theta_o,phi_o,value,sigma
        45,0,30,180,0.3181,0.0004

    The columns, in any order, and their ranges are those of :class:`MeasuredTable`;
    `sigma` may be left out. The keys, all optional, are its settings, with ``units``,
    which must be ``1/sr``, and ``aperture_solid_angle`` in sr instead of
    ``aperture_half_angle``. Further keys are kept as text in `header`, comment lines
    without a colon are skipped, and so are empty lines. A key that looks like a
    misspelt one is refused.

    For the other format, of which a table is one channel, see
    :mod:`gonio_mi.files.astm`.

    Parameters
    ----------
    path : str or path
        Ends in ``.astm`` for that format; any other ending is CSV.
    channel : str, optional
        Of a file ``.astm`` that has several, such as ``"550nm"``.

    Returns
    -------
    MeasuredTable

    Raises
    ------
    OSError
        If the file cannot be opened.
    ValueError
        If the channel must be given, or is not there.
    FileFormatError
        If it is not such a table: one sentence with the file, the line, the column and
        the value.
    """
    if Path(path).suffix.lower() == ".astm":
        return _read_astm(path, channel)
    if channel is not None:
        raise SettingError(f"channel goes with a file .astm, got {str(path)!r}")
    if Path(path).suffix.lower() == ".xml":
        raise FileFormatError(
            f"{path} is no table of values: measure it as a material, "
            f"goniometric:filename={path}, and compare the records"
        )
    return _read_csv(path)


def _read_astm(path: str | PathLike[str], channel: str | None) -> MeasuredTable:
    """One channel of a file after ASTM E1392."""
    with open(path, "rb") as stream:
        try:
            angles, values, names, header = astm.read(stream)
        except FileFormatError as error:
            raise FileFormatError(f"{path}: {error}") from None
    if channel is None and len(names) == 1:
        channel = names[0]
    if channel is None or channel not in names:
        raise SettingError(
            f"channel must be one of {', '.join(names)[:80]} for {path}, got "
            f"{shown(channel)}"
        )
    try:
        theta_i, phi_i, theta_o, phi_o = np.degrees(angles.T)
        return MeasuredTable(
            theta_i,
            phi_i,
            theta_o,
            phi_o,
            values[:, names.index(channel)],
            channel=channel if len(names) > 1 or channel.endswith("nm") else None,
            header=header,
            name=str(path),
        )
    except ValueError as error:
        raise FileFormatError(f"{path}: {error}") from None


def _read_csv(path: str | PathLike[str]) -> MeasuredTable:
    """Table of a CSV file."""
    try:
        text = Path(path).read_bytes().decode("utf-8-sig")
        if "\0" in text:
            raise ValueError
    except ValueError:
        raise FileFormatError(f"{path} is not a CSV file: it is not text") from None
    settings: dict[str, Any] = {}
    header: dict[str, str] = {}
    rows: list[tuple[int, str]] = []
    for number, line in enumerate(io.StringIO(text, newline=None), 1):
        line = line.strip()
        if len(line) > LONGEST_LINE:
            raise FileFormatError(
                f"{path}, line {number}: must have at most {LONGEST_LINE} characters, "
                f"got {len(line)}"
            )
        if line.startswith("#"):
            _read_key(f"{path}, line {number}", line.lstrip("# "), settings, header)
        elif line:
            rows.append((number, line))
    if not rows:
        raise FileFormatError(f"{path} is empty: it has no line of column names")
    quantity = settings.get("quantity", "brdf")
    columns: dict[str, Any] = _read_columns(path, rows, quantity)
    solid_angle = settings.pop("aperture_solid_angle", None)
    if solid_angle is not None:
        if "aperture_half_angle" in settings:
            raise FileFormatError(
                f"{path} must have either aperture_half_angle or aperture_solid_angle"
            )
        # solid angle of a cone: 4 pi sin^2(a / 2)
        half = 2 * math.asin(math.sqrt(solid_angle / (4 * math.pi)))
        settings["aperture_half_angle"] = math.degrees(half)
    settings.pop("units", None)
    try:
        return MeasuredTable(**columns, **settings, header=header, name=str(path))
    except ValueError as error:
        raise FileFormatError(f"{path}: {error}") from None


def _read_key(
    place: str, comment: str, settings: dict[str, Any], header: dict[str, str]
) -> None:
    """Take ``key: value`` from a comment line into `settings` or `header`."""
    key, colon, text = (part.strip() for part in comment.partition(":"))
    if not colon:
        return
    known = (*NUMBERS, *TEXTS)
    if key in settings or key in header:
        raise FileFormatError(f"{place}: the key {key} must occur once, got it again")
    if key not in known:
        similar = difflib.get_close_matches(
            key.lower().replace(" ", "_"), known, 1, 0.8
        )
        if similar:
            raise FileFormatError(
                f"{place}: unknown key {shown(key)}; {similar[0]} is one"
            )
        header[key] = text
        return
    try:
        if key in NUMBERS:
            if not is_decimal(text):
                condition = NUMBERS[key][2]
                raise SettingError(f"{key} must be {condition}, got {shown(text)}")
            settings[key] = checked_number(key, text, *NUMBERS[key])
            return
        if key == "units":
            checked_choice(key, text, UNITS)
        elif key == "quantity":
            checked_choice(key, text, QUANTITIES)
    except (TypeError, ValueError) as error:
        raise FileFormatError(f"{place}: {error}") from None
    settings[key] = text


def _read_columns(
    path: str | PathLike[str], rows: Sequence[tuple[int, str]], quantity: str
) -> dict[str, list[float]]:
    """Columns as lists, from numbered lines of which the first names them."""
    number, line = rows[0]
    names = [cell.strip() for cell in line.split(",")]
    place = f"{path}, line {number}"
    allowed = (*COLUMNS, "sigma")
    known = [name for name in names if name in allowed]
    if not known:
        raise FileFormatError(
            f"{place}: must name the columns {', '.join(COLUMNS)}, got {shown(line)}"
        )
    for name in names:
        if name not in allowed:
            raise FileFormatError(
                f"{place}: a column must be one of {', '.join(allowed)}, "
                f"got {shown(name)}"
            )
        if names.count(name) > 1:
            raise FileFormatError(f"{place}: the column {name} must occur once")
    for name in COLUMNS:
        if name not in names:
            raise FileFormatError(f"{place}: the column {name} is missing")
    if len(rows) == 1:
        raise FileFormatError(f"{path} has no values: nothing follows line {number}")
    columns: dict[str, list[float]] = {name: [] for name in names}
    for number, line in rows[1:]:
        cells = next(csv.reader([line], skipinitialspace=True))
        if len(cells) != len(names):
            raise FileFormatError(
                f"{path}, line {number}: must have {len(names)} values separated by "
                f"commas, got {len(cells)}"
            )
        for name, cell in zip(names, cells):
            columns[name].append(
                _cell(f"{path}, line {number}, column {name}", name, cell, quantity)
            )
    return columns


def _cell(place: str, name: str, text: str, quantity: str) -> float:
    """One number, or a sentence that says where it is and what it should be."""
    try:
        value = decimal(text)
    except ValueError as error:
        raise FileFormatError(f"{place}: {error}") from None
    good, condition = fits(name, value, quantity)
    if not good:
        raise FileFormatError(f"{place}: must be {condition}, got {text.strip()}")
    return value

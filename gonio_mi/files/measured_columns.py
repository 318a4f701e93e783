"""Which columns of a text are which angles and values, and what they hold."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..array_types import Floats
from ..errors import FileFormatError, SettingError, abridged, shown, unknown_channel
from .column_names import ANGLES, COLOURS, ROLES, Column, recognised, unit_of
from .measured_table import COLUMNS, fits
from .numbers import decimal, is_decimal
from .open_questions import (
    angle_units,
    channel_question,
    check_nothing_open,
    missing_columns,
    quantity_question,
    quantity_said,
)
from .text_table import TextTable

__all__ = ["Columns", "parsed_columns"]

OWN = (*COLUMNS, "sigma")
DEGREES = {"deg": 1.0, "": 1.0, "rad": float(np.degrees(1.0))}
NM = {"nm": 1.0, "um": 1e3, "m": 1e9, "": 1.0}

# What stands for no value.
MISSING = ("", "nan", "-", "--", "n/a", "na", "null")

# A wavelength that is a column's is at most this far in nm from the one asked for.
SAME_WAVELENGTH = 1e-6


@dataclass
class Columns:
    """What the columns of a text hold.

    Attributes
    ----------
    own : bool
        Whether they have the names that we write.
    arrays : dict of ndarray
        By role: angles in degrees, values and uncertainties as they are written.
    value, sigma : Column
        That of the values, and of the uncertainties if there is one.
    channel : str or None
    notes : list of str
    open : list of str
        Questions that must be answered before anything here is of use.
    """

    own: bool
    arrays: dict[str, Floats]
    value: Column
    sigma: Column | None
    channel: str | None
    notes: list[str] = field(default_factory=list)
    open: list[str] = field(default_factory=list)


def parsed_columns(
    text: TextTable,
    quantity: str | None,
    channel: str | None,
    columns: Mapping[str, str] | None,
) -> Columns:
    """Columns of a text.

    Parameters
    ----------
    text : TextTable
    quantity : str or None
        If it is known; of the own names its ranges are checked at once.
    channel : str or None
        Which of several values.
    columns : mapping, optional
        Name of the column for a role, with ``:deg`` or ``:rad`` if its name does not
        say it, or a number in its place.

    Raises
    ------
    ValueError
        If something is missing or ambiguous.
    FileFormatError
        If a cell is no number, or of the own names out of range.
    """
    constants, known = _assigned(text, columns or {})
    bare = [name.partition(" [")[0] for name in text.names]
    if set(bare) >= set(COLOURS):
        known = [
            Column(name, "value", channel=colour) if colour in COLOURS else column
            for name, colour, column in zip(text.names, bare, known)
        ]
    own = set(text.names) >= set(COLUMNS) and not columns
    place = f"{text.place}, line {text.number}"
    if own:
        _check_own(place, text.names)
    questions: list[str] = []
    picked, channels, unclear = _picked(text, known, constants, channel, questions)
    unclear += missing_columns(known, constants)
    values = [column for column in known if column and column.role == "value"]
    if unclear and not (quantity or own or quantity_said(text, values)):
        unclear.append(quantity_question())
    if unclear:
        check_nothing_open(place, questions + unclear)
    if "value" in constants:
        raise SettingError(f"columns must name a column of values of {text.place}")
    cells, n_missing = _numbers(text, picked, (quantity or "brdf") if own else None)
    if not cells["value"]:
        raise FileFormatError(f"{text.place} has no row with a value")
    arrays = {role: np.array(values) for role, values in cells.items()}
    n = len(arrays["value"])
    arrays |= {role: np.full(n, value) for role, value in constants.items()}
    if "wavelength" in picked:
        arrays, channels = _one_wavelength(
            text.place, arrays, picked, channel, questions
        )
    notes = [] if own else _notes(text, picked, constants)
    if n_missing:
        notes.append(f"{n_missing} rows without a value are left out")
    _check_angle_units(text.place, picked)
    if not own:
        questions += angle_units(arrays, picked)
    for role in ANGLES:
        if role in picked:
            arrays[role] = arrays[role] * DEGREES[picked[role].unit]
    chosen = channels[0] if channels else None
    sigma = picked.get("sigma")
    return Columns(own, arrays, picked["value"], sigma, chosen, notes, questions)


def _assigned(
    text: TextTable, columns: Mapping[str, str]
) -> tuple[dict[str, float], list[Column | None]]:
    """Constants, and what each column holds, by its name or as `columns` says."""
    known = [recognised(name) for name in text.names]
    constants = {}
    for role, said in columns.items():
        if role not in ROLES:
            raise SettingError(
                f"columns must name {', '.join(ROLES)}, got {shown(role)}"
            )
        name, _, unit = str(said).partition(":")
        if unit not in ("", "deg", "rad"):
            raise SettingError(
                f"columns must give angles in deg or rad, got {shown(said)}"
            )
        known = [None if c and c.role == role else c for c in known]
        names = [own.lower() for own in text.names]
        if name.strip().lower() in names:
            index = names.index(name.strip().lower())
            own = text.names[index]
            before = recognised(own) or Column(own, role, unit_of(own))
            known[index] = replace(before, role=role, unit=unit or before.unit)
        elif is_decimal(name):
            constants[role] = decimal(name) * DEGREES[unit]
        else:
            raise SettingError(
                f"columns must name columns of {text.place} "
                f"({abridged(', '.join(text.names), 120)}), got {shown(name)}"
            )
    return constants, known


def _check_own(place: str, names: Sequence[str]) -> None:
    """Raise FileFormatError if names beside ours may be misspelt ones."""
    for name in names:
        if name not in OWN:
            raise FileFormatError(
                f"{place}: a column must be one of {', '.join(OWN)}, got {shown(name)}"
            )
        if names.count(name) > 1:
            raise FileFormatError(f"{place}: the column {name} must occur once")


def _picked(
    text: TextTable,
    known: Sequence[Column | None],
    constants: Mapping[str, float],
    channel: str | None,
    questions: list[str],
) -> tuple[dict[str, Column], list[str], list[str]]:
    """The one column of each role, the channel of the values, and what is unclear.

    Of several channels the first, beside a question: more may be open than that.
    """
    by_role: dict[str, list[Column]] = {}
    for column in known:
        if column is not None and column.role not in constants:
            by_role.setdefault(column.role, []).append(column)
    values = by_role.get("value", [])
    names = [column.channel for column in values if column.channel]
    if len(names) > 1 and channel is None:
        questions.append(channel_question(names))
        by_role["value"] = values[:1]
        by_role.pop("sigma", None)
        names = []
    elif names and channel is not None:
        wanted = channel if channel in names else f"{channel}nm"
        if wanted not in names:
            raise unknown_channel(text.place, names, channel)
        by_role["value"] = [c for c in values if c.channel == wanted]
        names = [wanted]
    elif channel is not None and "wavelength" not in by_role:
        raise SettingError(
            f"channel goes with a table of several, got {channel!r} for {text.place}"
        )
    if names:
        same = [c for c in by_role.get("sigma", []) if c.channel in ("", names[0])]
        by_role["sigma"] = same
    unclear = []
    for role, columns in by_role.items():
        if len(columns) > 1:
            several = ", ".join(repr(column.name) for column in columns)
            unclear.append(
                f"several columns may be {role} ({several:.150}); say --columns "
                f"{role}=NAME"
            )
    picked = {role: columns[0] for role, columns in by_role.items() if columns}
    return picked, names, unclear


def _numbers(
    text: TextTable, picked: Mapping[str, Column], quantity: str | None
) -> tuple[dict[str, list[float]], int]:
    """Numbers of the picked columns, and how many rows lack a value.

    Of our own names, where `quantity` is given, ranges are checked at once.
    """
    places = {role: text.names.index(column.name) for role, column in picked.items()}
    numbers: dict[str, list[float]] = {role: [] for role in places}
    n_missing = 0
    for number, cells in text.cells():
        if not quantity and cells[places["value"]].strip().lower() in MISSING:
            n_missing += 1
            continue
        for role, index in places.items():
            place = text.place, number, text.names[index]
            numbers[role].append(_number(place, role, cells[index], quantity))
    return numbers, n_missing


def _number(
    place: tuple[str, int, str], role: str, cell: str, quantity: str | None
) -> float:
    """One number, or a sentence that says where it is and what it should be."""
    where = "{}, line {}, column {}"
    try:
        value = decimal(cell)
    except ValueError as error:
        raise FileFormatError(f"{where.format(*place)}: {error}") from None
    good, condition = math.isfinite(value), "a finite number"
    if quantity:
        good, condition = fits(role, value, quantity)
    if not good:
        raise FileFormatError(
            f"{where.format(*place)}: must be {condition}, got {cell.strip()}"
        )
    return value


def _one_wavelength(
    place: str,
    arrays: dict[str, Floats],
    picked: Mapping[str, Column],
    channel: str | None,
    questions: list[str],
) -> tuple[dict[str, Floats], list[str]]:
    """Rows of one wavelength of a table that has it in a column, or a question."""
    nm = arrays.pop("wavelength") * NM.get(picked["wavelength"].unit, 1.0)
    names = {f"{one:.10g}nm": one for one in np.unique(nm)}
    if channel is None and len(names) == 1:
        channel = next(iter(names))
    if channel not in names and f"{channel}nm" in names:
        channel = f"{channel}nm"
    if channel is None:
        questions.append(channel_question(names))
        return arrays, []
    if channel not in names:
        raise unknown_channel(place, names, channel)
    here = np.abs(nm - names[channel]) <= SAME_WAVELENGTH
    return {role: array[here] for role, array in arrays.items()}, [channel]


def _notes(
    text: TextTable, picked: Mapping[str, Column], constants: Mapping[str, float]
) -> list[str]:
    """Sentences on what was inferred from the names."""
    said = [
        f"{role} is {column.name.strip()!r}"
        + (f" in {column.unit or 'deg'}" if role in ANGLES else "")
        for role, column in picked.items()
    ]
    said += [f"{role} is {value:g}" for role, value in constants.items()]
    used = {column.name for column in picked.values()}
    unused = [n for n in text.names if n and n not in used and recognised(n) is None]
    notes = [f"columns: {', '.join(said)}"]
    if unused:
        notes.append(f"not used: {abridged(', '.join(map(repr, unused)), 200)}")
    if text.decimal_comma:
        notes.append("numbers have decimal commas")
    return notes


def _check_angle_units(place: str, picked: Mapping[str, Column]) -> None:
    """Raise FileFormatError for angles in no unit of angles."""
    for role in (r for r in ANGLES if r in picked and picked[r].unit not in DEGREES):
        raise FileFormatError(
            f"{place}: the angle {role} must be in deg or rad, got "
            f"{shown(picked[role].name.strip(), 60)}"
        )

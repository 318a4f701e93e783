"""Plain tables: which column is what, and one question on all that is open."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import Any

import numpy as np

from ...array_types import Flags, Floats
from ...errors import (
    FileFormatError,
    SettingError,
    abridged,
    check_nothing_open,
    checked_choice,
    number_of,
    shown,
)
from ...files.measured_table import (
    COLUMNS,
    QUANTITIES,
    MeasuredTable,
    fits,
    parsed_keys,
)
from ...files.numbers import decimal, decimals, is_decimal, without_degrees
from ...results.record import chosen_channel
from .angles import (
    AZIMUTHS,
    DEGREES,
    azimuth_question,
    directions,
    in_degrees,
    unit_questions,
)
from .names import ANGLES, COLOURS, ROLES, Column, coverage_of, recognised, unit_of
from .text import TextTable, split_text

OWN_NAMES = (*COLUMNS, "sigma")

# Those of Mueller matrices in our own tables, which are compared by their light alone.
ELEMENT_COLUMN = re.compile(r"(sigma_)?M[0-3][0-3]")
NM = {"nm": 1.0, "um": 1e3, "m": 1e9}
KINDS = {"rel": "relative", "abs": "absolute"}

# What stands for no value, in cells, and in columns of angles and uncertainties.
MISSING = re.compile(r"|nan|--?|n/?a|null|-9{2,}(\.[09]*)?", re.IGNORECASE)
MISSING_CODES = (-99, -999, -9999)

# A wavelength that is a column's is at most this far in nm from the one asked for.
WAVELENGTH_ROUNDING = 1e-6

# Wavelengths below this without a unit are micrometres: no light has so few nm.
MIN_NM = 20

# A coverage factor in a title, and names of columns that hold one.
FACTOR = re.compile(r"(?<!\w)k\s*[=:]\s*([0-9]+(?:[.,][0-9]+)?)", re.IGNORECASE)
FACTOR_NAMES = ("k", "k factor", "coverage factor")

# What titles and names of files call the quantities.
QUANTITY_PATTERNS = (
    (r"\b(BRF|reflectance factors?|radiance factors?)\b", "reflectance_factor"),
    (r"\b(cosine.corrected BRDF|CCBRDF|BRDF ?[*x] ?cos)", "brdf_cos"),
    (r"\bBTDF\b", "btdf"),
    (r"\bBRDF\b", "brdf"),
)


@dataclass(frozen=True)
class Specified:
    """What the user says of a table; the parameters of :func:`gonio_mi.read_measured`.

    Attributes
    ----------
    channel, quantity, azimuth : str, optional
    columns : mapping
        Name of the column for a role, with a suffix such as ``:deg`` if its name has no
        unit, or a number in its place.
    """

    channel: str | None = None
    quantity: str | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    azimuth: str | None = None

    def __post_init__(self) -> None:
        for name, choices in (("quantity", QUANTITIES), ("azimuth", AZIMUTHS)):
            if getattr(self, name) is not None:
                checked_choice(name, getattr(self, name), choices)


def read_text(path: str | PathLike[str], specified: Specified) -> MeasuredTable:
    """Table of a text; see :func:`gonio_mi.read_measured`."""
    columns = specified.columns.values()
    names = {word.partition(":")[0].strip().lower() for word in columns}

    def known(name: str) -> bool:
        return recognised(name) is not None or name.strip().lower() in names

    text = split_text(path, known, ", ".join(COLUMNS))
    settings, header = parsed_keys(text.place, text.comments)
    if specified.quantity is not None:
        settings["quantity"] = specified.quantity
    reading = _Reading(text, specified, settings)
    reading.read_columns()
    arrays, picked, notes = reading.arrays, reading.picked, reading.notes
    if not (reading.own and settings):  # below our own header they are in degrees
        reading.questions += unit_questions(arrays, picked)
    settings["quantity"] = reading.quantity()
    values = reading.values()
    angles, more_notes, more_questions = directions(
        arrays | in_degrees(arrays, picked), specified.azimuth
    )
    check_nothing_open(text.place, reading.questions + more_questions)
    notes += more_notes
    if reading.own:
        reading.check_ranges(values | angles, settings["quantity"])
    elif settings["quantity"] == "btdf" and (angles["theta_o"] <= 90).all():
        angles["theta_o"] = 180 - angles["theta_o"]
        notes.append("theta_o of transmission counts from the normal of the other face")
    if reading.channel is not None:
        settings.setdefault("channel", reading.channel)
    try:
        return MeasuredTable(
            **values,
            **angles,
            **settings,
            header=header,
            name=text.place,
            notes=tuple(notes),
        )
    except ValueError as error:
        raise FileFormatError(f"{text.place}: {error}") from None


class _Reading:
    """A text that is being read: notes on what is understood, questions on what is not.

    Parameters
    ----------
    text : TextTable
    specified : Specified
    settings : dict
        Those of the header, and the quantity if it is specified.
    """

    def __init__(
        self, text: TextTable, specified: Specified, settings: dict[str, Any]
    ) -> None:
        self.text, self.place, self.settings = text, text.place, settings
        self.specified = specified
        self.here = f"{text.place}, line {text.number}"
        self.notes: list[str] = []
        self.questions: list[str] = []
        self.channel: str | None = None
        self.constants: dict[str, float] = {}
        # our own names: all five, nothing beside them
        self.own = set(text.names) >= set(COLUMNS) and not specified.columns
        self.known = [
            None if self.own and ELEMENT_COLUMN.fullmatch(name) else recognised(name)
            for name in text.names
        ]
        bare = [name.partition(" [")[0] for name in text.names]
        for colour in COLOURS if set(bare) >= set(COLOURS) else ():
            index = bare.index(colour)
            name = text.names[index]
            self.known[index] = Column(name, "value", unit_of(name), channel=colour)
        for role, word in specified.columns.items():
            self._assign(role, str(word))
        for name in text.names if self.own else ():
            if name not in OWN_NAMES and not ELEMENT_COLUMN.fullmatch(name):
                raise FileFormatError(
                    f"{self.here}: a column must be one of {', '.join(OWN_NAMES)}, got "
                    f"{shown(name)}"
                )
            if text.names.count(name) > 1:
                raise FileFormatError(f"{self.here}: the column {name} must occur once")

    def _assign(self, role: str, word: str) -> None:
        """Take a column, or a number, for the role that the user specifies."""
        if role not in ROLES:
            raise SettingError(
                f"columns must name {', '.join(ROLES)}, got {shown(role)}"
            )
        names = [own.strip().lower() for own in self.text.names]
        whole = word.strip().lower() in names
        name, _, suffix = (word, "", "") if whole else word.partition(":")
        if suffix not in ("", "deg", "rad", *KINDS):
            raise SettingError(
                f"columns must give angles in deg or rad, and sigma as rel or abs, got "
                f"{shown(word)}"
            )
        self.known = [None if c and c.role == role else c for c in self.known]
        if name.strip().lower() in names:
            index = names.index(name.strip().lower())
            own = self.text.names[index]
            column = recognised(own) or Column(own, role, unit_of(own))
            self.known[index] = replace(
                column,
                role=role,
                unit=suffix if suffix in ("deg", "rad") else column.unit,
                kind=suffix if suffix in KINDS else column.kind,
                # a specified sigma is a standard uncertainty unless its name says k
                coverage=1.0 if np.isnan(column.coverage) else column.coverage,
            )
        elif is_decimal(name):
            self.constants[role] = decimal(name) * DEGREES.get(suffix, 1.0)
        else:
            raise SettingError(
                f"columns must name columns of {self.place} "
                f"({abridged(', '.join(self.text.names), 120)}), got {shown(name)}"
            )

    # ------------------------------------------------------------------------- columns

    def read_columns(self) -> None:
        """Read the numbers of the one column of each role, `picked`, into `arrays`."""
        by_role: dict[str, list[Column]] = {}
        for column in self.known:
            if column is not None and column.role not in self.constants:
                by_role.setdefault(column.role, []).append(column)
        self._pick_channel(by_role)
        self._check_clear(by_role)
        if "value" in self.constants:
            raise SettingError(f"columns must name a column of values of {self.place}")
        self.picked = {role: columns[0] for role, columns in by_role.items() if columns}
        for role in ANGLES:
            if role in self.picked and self.picked[role].unit not in DEGREES:
                name = shown(self.picked[role].name.strip(), 60)
                raise FileFormatError(
                    f"{self.place}: the angle {role} must be in deg or rad, got {name}"
                )
        self.arrays = self._numbers()
        n = len(self.arrays["value"])
        for role, value in self.constants.items():
            self.arrays[role] = np.full(n, value)
        self._leave_out_missing()
        if "wavelength" in self.arrays:
            self._pick_wavelength()
        if not self.own:
            self._note_columns()

    def _check_clear(self, by_role: Mapping[str, Sequence[Column]]) -> None:
        """Raise OpenQuestionsError unless each role has one column, and none lacks."""
        unclear = [
            f"several columns may be {role} "
            f"({', '.join(repr(c.name) for c in columns):.150}); say --columns "
            f"{role}=NAME"
            for role, columns in by_role.items()
            if len(columns) > 1
        ]
        own = {column.role for column in self.known if column} - set(self.constants)
        unclear += self._missing(own)
        if not unclear:
            return
        values = [column for column in self.known if column and column.role == "value"]
        titled = any(column.quantity for column in values) or self._titled()
        if not (self.settings.get("quantity") or self.own or titled):
            unclear.append(_quantity_question())
        there = own | set(self.constants)
        # azimuths of exit without those of incidence
        relative = "delta_phi" in there or ("phi_o" in there and "phi_i" not in there)
        if relative and self.specified.azimuth is None:
            unclear.append(azimuth_question("azimuths"))
        check_nothing_open(self.here, self.questions + unclear)

    def _pick_channel(self, by_role: dict[str, list[Column]]) -> None:
        """Keep the values of one channel, the first beside a question if none is."""
        channel, values = self.specified.channel, by_role.get("value", [])
        names = [column.channel for column in values if column.channel]
        if len(names) > 1 and channel is None:
            self.questions.append(_channel_question(names))
            by_role["value"] = values[:1]
            by_role.pop("sigma", None)
            return
        if names and channel is not None:
            self.channel = chosen_channel(self.place, names, channel)
            by_role["value"] = [c for c in values if c.channel == self.channel]
        elif channel is not None and "wavelength" not in by_role:
            raise SettingError(
                f"channel applies to tables with several channels, got {channel!r} "
                f"for {self.place}; a wavelength that the table does not state is "
                "given by --columns wavelength=NM"
            )
        elif names:
            self.channel = names[0]
        if self.channel and "sigma" in by_role:
            own = ("", self.channel)
            by_role["sigma"] = [c for c in by_role["sigma"] if c.channel in own]

    def _missing(self, own: set[str]) -> list[str]:
        """Question about required columns that are missing among the `own` roles."""
        there = own | set(self.constants)
        needed = ["theta_i", "theta_o", "value", *(["phi_o"] if "phi_i" in own else [])]
        if "delta_phi" in there:
            there.add("phi_o")
        lacks = [role for role in needed if role not in there]
        if not lacks:
            return []
        what = f"the column {lacks[0]} is missing; if another name stands for it"
        if len(lacks) > 1:
            names = f"{', '.join(lacks[:-1])} and {lacks[-1]}"
            what = f"the columns {names} are missing; if other names stand for them"
        other = [n.strip() for n, c in zip(self.text.names, self.known) if n and not c]
        seen = f" ({abridged(', '.join(map(repr, other)), 80)})" if other else ""
        options = " ".join(f"{role}=NAME" for role in lacks)
        question = f"{what}{seen}, say --columns {options}"
        if lacks[0] == "theta_i":
            question += ", or a number for all rows, such as theta_i=30"
        return [question]

    def _numbers(self) -> dict[str, Floats]:
        """Numbers of the picked columns, in the rows with a value."""
        places = {
            role: self.text.names.index(column.name)
            for role, column in self.picked.items()
        }
        self.lines: list[int] = []
        kept: list[list[str]] = []
        missing: list[str] = []
        for number, cells in self.text.cells():
            cell = cells[places["value"]].strip()
            if MISSING.fullmatch(cell):
                missing.append(cell)
                continue
            self.lines.append(number)
            kept.append(cells)
        rows = [[cells[index] for index in places.values()] for cells in kept]
        numbers: Any = decimals([cell for row in rows for cell in row])
        if numbers is None or not np.all(np.isfinite(numbers)):
            numbers = [self._row(number, row) for number, row in zip(self.lines, rows)]
        if not self.lines:
            raise FileFormatError(f"{self.place} has no row with a value")
        if missing:
            codes = ", ".join(sorted({one for one in missing if one.startswith("-9")}))
            why = f": {codes} stands for none" if codes else ""
            rows_left_out = number_of(len(missing), "row")
            self.notes.append(f"{rows_left_out} without a value left out{why}")
        columns = np.reshape(numbers, (-1, len(places))).T
        return {role: column.copy() for role, column in zip(places, columns)}

    def _row(self, number: int, row: Sequence[str]) -> list[float]:
        """Numbers of a line, or FileFormatError for the first that is not finite."""
        values = []
        for (role, column), cell in zip(self.picked.items(), row):
            where = f"{self.place}, line {number}, column {column.name}"
            in_degrees = role in ANGLES and column.unit != "rad"
            text = without_degrees(cell) if in_degrees else cell
            if not is_decimal(text):
                raise FileFormatError(f"{where}: must be a number, got {shown(cell)}")
            if not np.isfinite(value := decimal(text)):
                raise FileFormatError(
                    f"{where}: must be a finite number, got {cell.strip()}"
                )
            values.append(value)
        return values

    def _leave_out_missing(self) -> None:
        """Leave out rows with a code for no number, except azimuths at the normal."""
        arrays = self.arrays
        normal = {side: arrays[f"theta_{side}"] % 180 == 0 for side in "io"}
        normal["d"] = normal["i"] | normal["o"]
        gone, found = np.zeros(len(arrays["value"]), dtype=bool), set()
        for role in set(arrays) - {"value"} - set(self.constants):
            column = arrays[role]
            none = np.isin(column, MISSING_CODES)
            if role in ANGLES and (column[~none] < 0).any():
                none &= column < -180  # beside other negative angles, -99 is one
            if "phi" in role:
                side = "d" if role == "delta_phi" else role[-1]
                arrays[role] = np.where(none & normal[side], 0.0, column)
                none &= ~normal[side]
            found |= set(column[none].tolist())
            gone |= none
        if not gone.any():
            return
        if gone.all():
            raise FileFormatError(f"{self.place} has no row without a missing number")
        codes = ", ".join(f"{code:g}" for code in sorted(found))
        self.notes.append(
            f"{number_of(np.count_nonzero(gone), 'row')} without another number than "
            f"the value left out: {codes} stands for none"
        )
        self._keep(~gone)

    def _keep(self, rows: Flags) -> None:
        """Keep some rows."""
        self.lines = [line for line, kept in zip(self.lines, rows) if kept]
        self.arrays = {role: column[rows] for role, column in self.arrays.items()}

    def _pick_wavelength(self) -> None:
        """Keep the rows of one wavelength of a column of them, or ask for it."""
        channel = self.specified.channel
        unit = self.picked["wavelength"].unit if "wavelength" in self.picked else ""
        nm = self.arrays.pop("wavelength") * NM.get(unit, 1.0)
        if not unit and nm.max() < MIN_NM:
            nm = nm * NM["um"]
            self.notes.append("wavelengths without a unit are taken for micrometres")
        names = {f"{one:.10g}nm": one for one in np.unique(nm)}
        if channel is None and len(names) > 1:
            self.questions.append(_channel_question(list(names)))
            return
        self.channel = chosen_channel(self.place, list(names), channel)
        self._keep(np.abs(nm - names[self.channel]) <= WAVELENGTH_ROUNDING)

    def _note_columns(self) -> None:
        """Note what the names were taken for."""
        columns = []
        for role, column in self.picked.items():
            unit = f" in {column.unit or 'deg'}" if role in ANGLES else ""
            columns.append(f"{role} is {column.name.strip()!r}{unit}")
        columns += [f"{role} is {value:g}" for role, value in self.constants.items()]
        self.notes.insert(0, f"columns: {', '.join(columns)}")
        used = {column.name for column in self.picked.values()} | {""}
        unused = [
            repr(n) for n in self.text.names if n not in used and not recognised(n)
        ]
        if unused:
            self.notes.append(f"not used: {abridged(', '.join(unused), 200)}")
        if self.text.decimal_comma:
            self.notes.append("numbers have decimal commas")

    # -------------------------------------------------------------------------- values

    def _titled(self) -> str | None:
        """The one quantity that the lines before the columns name, if they do."""
        lines = (*self.text.titles, *self.text.comments)
        title = "\n".join(line for _, line in lines).replace("_", " ")
        found = {q for p, q in QUANTITY_PATTERNS if re.search(p, title, re.IGNORECASE)}
        return found.pop() if len(found) == 1 else None

    def quantity(self) -> str | None:
        """Quantity as specified, as names or titles have it, or a question."""
        column, specified = self.picked["value"], self.settings.get("quantity")
        if specified is not None:
            if column.quantity and column.quantity != specified:
                self.notes.append(
                    f"the values are {specified}, as specified, although their name "
                    f"{column.name.strip()!r} says {column.quantity}"
                )
            return str(specified)
        found = column.quantity or self._titled()
        if self.own and found in (None, "", "brdf"):
            if not found:
                self.notes.append(
                    "no quantity is stated: taken as brdf in 1/sr, without cosine; "
                    "--quantity sets another"
                )
            return "brdf"
        if not found:
            self.questions.append(_quantity_question(column.name))
            return None
        source = "their name" if column.quantity else "the title"
        self.notes.append(f"the values are {found}, as {source} says")
        return found

    def values(self) -> dict[str, Any]:
        """Values and their absolute standard uncertainties."""
        unit = self.picked["value"].unit
        percent = 0.01 if unit.startswith("%") else 1.0
        if percent != 1:
            whole = "1/sr" if unit == "%/sr" else "1"
            self.notes.append(f"values in {unit}: 100 {unit} is {whole}")
        values = self.arrays["value"] * percent
        column = self.picked.get("sigma")
        if column is None:
            return {"value": values, "sigma": self.arrays.get("sigma")}
        coverage = self._coverage(column)
        name, sigma = column.name.strip(), self.arrays["sigma"] / coverage
        if np.isnan(coverage):
            self.questions.append(
                f"the uncertainty {name!r:.40} may be expanded: give its name the "
                f"factor, such as k=2, or say --columns sigma='{name}' if it is "
                "standard"
            )
        if not column.kind and column.unit in ("%", "1") and unit == column.unit:
            self.questions.append(
                f"the uncertainty {name!r:.40} and the values are in {unit}: say "
                f"--columns sigma='{name}:rel' if it is relative to each value (or "
                ":abs)"
            )
        kind = column.kind or ("rel" if column.unit in ("%", "1") else "abs")
        own = 0.01 if column.unit.startswith("%") else 1.0
        if kind == "rel":
            sigma = sigma * own * np.abs(values)
        else:
            sigma = sigma * (own if column.unit else percent)
        if not self.own:
            k = f", divided by k = {coverage:g}" if coverage != 1 else ""
            self.notes.append(f"{name!r}: {KINDS[kind]} uncertainty{k}")
        return {"value": values, "sigma": sigma}

    def _coverage(self, column: Column) -> float:
        """Coverage factor of uncertainties; NaN if another than theirs is stated."""
        if "sigma" in self.specified.columns or coverage_of(column.name):
            return column.coverage
        lines = (*self.text.titles, *self.text.comments)
        found = [FACTOR.search(line) for _, line in lines]
        stated = {float(match[1].replace(",", ".")) for match in found if match}
        names = [name.replace("_", " ").strip().lower() for name in self.text.names]
        other = stated - {column.coverage} or set(FACTOR_NAMES) & set(names)
        return float("nan") if other else column.coverage

    def check_ranges(self, columns: Mapping[str, Any], quantity: str) -> None:
        """Raise FileFormatError with line and column of the first that does not fit."""
        for name in (n for n in OWN_NAMES if columns[n] is not None):
            good, condition = fits(name, columns[name], quantity)
            if not good.all():
                row = int(np.argmin(good))
                raise FileFormatError(
                    f"{self.place}, line {self.lines[row]}, column {name}: must be "
                    f"{condition}, got {columns[name][row]:g}"
                )


def _quantity_question(name: str = "") -> str:
    """Question about the quantity of the values, of a column of that name if known."""
    called = f" ({name.strip()!r:.40})" if name else ""
    return (
        f"it does not say what its values{called} are: say --quantity "
        f"{', '.join(QUANTITIES[:-1])} or {QUANTITIES[-1]}"
    )


def _channel_question(names: Sequence[str]) -> str:
    """Question about the channel."""
    known = abridged(", ".join(names), 120)
    return f"channel must be one of {known}: say --channel"

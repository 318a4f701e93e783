"""Plain tables: which column is what, and one question on all that is open."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import Any

import numpy as np

from ...array_types import Flags
from ...errors import (
    FileFormatError,
    SettingError,
    abridged,
    check_nothing_open,
    checked_choice,
    checked_number,
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
from ...files.numbers import decimal, is_decimal
from ...results.record import chosen_channel
from .angles import (
    AZIMUTHS,
    azimuth_question,
    directions,
    in_degrees,
    unit_questions,
)
from .cells import column_numbers, without_number, without_value
from .names import (
    ANGLES,
    FACTOR_OF,
    ROLES,
    UNITS_OF,
    Column,
    coverage_of,
    recognised,
    unit_in,
    unit_of,
)
from .text import TextTable, split_text

KINDS = {"rel": "relative", "abs": "absolute"}

# Channels that columns of values may have for their whole name.
COLOURS = ("R", "G", "B")

# A wavelength that is a column's is at most this far in nm from the one asked for.
WAVELENGTH_ROUNDING = 1e-6

# Numbers below this are no wavelengths in nm, and need a unit.
MIN_NM = 20

# Degrees from 90 within which a direction is the horizon: that of 1.5708 rad is.
HORIZON = 1e-3

# Names of columns that hold a coverage factor.
FACTOR_NAMES = {"k", "k factor", "coverage factor"}

# What titles and names of files call the quantities.
QUANTITY_PATTERNS = (
    (r"\b(BRF|reflectance factors?|radiance factors?)\b", "reflectance_factor"),
    (r"\b(cosine.corrected BRDF|CCBRDF|BRDF ?[*x] ?cos)", "brdf_cos"),
    (r"\bBTDF\b", "btdf"),
    (r"\bBRDF\b", "brdf"),
)

# Least reflectance of a reference panel.
LEAST = 1e-9

# A line on the reflectance of the reference panel, with a number.
PANEL = re.compile(
    r"(?=.*\breflectance\b(?! factor))(?=.*\b(panel|reference|tile|plaque)\b).*[0-9]",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Specified:
    """What the user specifies of a table: parameters of `gonio_mi.read_measured`.

    Attributes
    ----------
    channel, quantity, azimuth : str, optional
    columns : mapping
        Name of the column for a role, with a suffix such as ``:deg`` if its name has no
        unit, or a number in its place.
    panel_reflectance : float, optional
    """

    channel: str | None = None
    quantity: str | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    azimuth: str | None = None
    panel_reflectance: float | None = None

    def __post_init__(self) -> None:
        for name, choices in (("quantity", QUANTITIES), ("azimuth", AZIMUTHS)):
            if getattr(self, name) is not None:
                checked_choice(name, getattr(self, name), choices)
        if self.panel_reflectance is not None:
            name, condition = "panel_reflectance", "a number above 0, below 2"
            checked_number(name, self.panel_reflectance, LEAST, 2, condition)


def read_text(path: str | PathLike[str], specified: Specified) -> MeasuredTable:
    """Table of a text; see :func:`gonio_mi.read_measured`."""
    columns = specified.columns.values()
    names = {word.partition(":")[0].strip().lower() for word in columns}

    def known(name: str) -> bool:
        return recognised(name) is not None or name.strip().lower() in names

    text = split_text(path, known, ", ".join(COLUMNS))
    return _Reading(text, specified).table()


class _Reading:
    """State of a text being read: notes on interpretations, questions on the rest."""

    def __init__(self, text: TextTable, specified: Specified) -> None:
        self.text, self.place, self.specified = text, text.place, specified
        self.settings, self.header = parsed_keys(text.place, text.comments)
        if specified.quantity is not None:
            self.settings["quantity"] = specified.quantity
        self.notes: list[str] = []
        self.questions: list[str] = []
        self.channel: str | None = None
        self.constants: dict[str, float] = {}
        lines = (*text.titles, *text.comments)
        self.titles = [line.replace("_", " ") for _, line in lines]
        # our own names: without a quantity it is the BRDF
        self.own = set(text.names) >= set(COLUMNS) and not specified.columns
        bare = [name.partition(" [")[0] for name in text.names]
        colours = COLOURS if {*COLOURS} <= {*bare} else ()
        self.known = [
            Column(name, "value", unit_in(name), channel=one)
            if one in colours
            else recognised(name)
            for name, one in zip(text.names, bare)
        ]
        for role, word in specified.columns.items():
            self._assign(role, str(word))

    def table(self) -> MeasuredTable:
        """The table, unless a question is open."""
        self._pick_columns()
        self._read_numbers()
        if not (self.own and self.settings):  # below our own header they are in degrees
            self.questions += unit_questions(self.arrays, self.picked)
        self.arrays |= in_degrees(self.arrays, self.picked)
        polar = np.abs([self.arrays["theta_i"], self.arrays["theta_o"]])
        self._leave_out("at 90 degrees", (np.abs(polar - 90) <= HORIZON).any(axis=0))
        quantity = self.settings["quantity"] = self._quantity()
        columns = self._values(quantity)
        angles, notes, questions = directions(self.arrays, self.specified.azimuth)
        check_nothing_open(self.place, self.questions + questions)
        self.notes += notes
        if not self.own and quantity == "btdf" and (angles["theta_o"] <= 90).all():
            angles["theta_o"] = 180 - angles["theta_o"]
            note = "theta_o of transmission counts from the normal of the other face"
            self.notes.append(note)
        self._check_ranges(columns | angles, quantity)
        if self.channel is not None:
            self.settings.setdefault("channel", self.channel)
        told: dict[str, Any] = {"header": self.header, "notes": tuple(self.notes)}
        try:
            return MeasuredTable(
                **columns, **angles, **self.settings, **told, name=self.place
            )
        except ValueError as error:
            raise FileFormatError(f"{self.place}: {error}") from None

    # ------------------------------------------------------------------------- columns

    def _assign(self, role: str, word: str) -> None:
        """Take a column, or a number, for the role that the user specifies."""
        if role not in ROLES:
            known = ", ".join(ROLES)
            raise SettingError(f"columns must name {known}, got {shown(role)}")
        names = [own.strip().lower() for own in self.text.names]
        whole = word.strip().lower() in names
        name, _, suffix = (word, "", "") if whole else word.partition(":")
        unit, factor = unit_of(suffix), re.fullmatch(r"k=([0-9]+(?:\.[0-9]+)?)", suffix)
        if suffix and not (unit or suffix in KINDS or factor):
            raise SettingError(
                "columns must give a unit such as deg or um, or of sigma rel, abs or "
                f"k=2, got {shown(word)}"
            )
        self.known = [None if c and c.role == role else c for c in self.known]
        if name.strip().lower() in names:
            index = names.index(name.strip().lower())
            own = self.text.names[index]
            column = recognised(own) or Column(own, role, unit_in(own))
            if column.kind == "?" and suffix == "abs":  # its % is that of a level
                column = replace(column, unit="")
            # a specified sigma is a standard uncertainty unless k is said
            coverage = 1.0 if np.isnan(column.coverage) else column.coverage
            self.known[index] = replace(
                column,
                role=role,
                unit=unit or column.unit,
                kind=suffix if suffix in KINDS else column.kind,
                coverage=float(factor[1]) if factor else coverage,
            )
        elif is_decimal(name) and role != "value":
            self.constants[role] = decimal(name) * FACTOR_OF[unit]
        else:
            raise SettingError(
                f"columns must name columns of {self.place} "
                f"({abridged(', '.join(self.text.names), 120)}), got {shown(name)}"
            )

    def _pick_columns(self) -> None:
        """Find the one column of each role, `picked`, or ask."""
        by_role: dict[str, list[Column]] = {}
        for column in filter(None, self.known):
            if column.role not in self.constants:
                by_role.setdefault(column.role, []).append(column)
        self._pick_channel(by_role)
        self._check_clear(by_role)
        self.picked = {role: columns[0] for role, columns in by_role.items() if columns}
        for role, column in self.picked.items():
            if column.unit not in ("", *UNITS_OF[role]):
                raise FileFormatError(
                    f"{self.place}: {role} must be in {' or '.join(UNITS_OF[role])}, "
                    f"got {shown(column.name.strip(), 60)}"
                )

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

    def _check_clear(self, by_role: Mapping[str, Sequence[Column]]) -> None:
        """Ask about missing and ambiguous columns."""
        there = {column.role for column in self.known if column} | set(self.constants)
        azimuth = "phi_i" in by_role and "delta_phi" not in there
        needed = ["theta_i", "theta_o", "value", *["phi_o"] * azimuth]
        unclear = [role for role in needed if role not in there]
        unclear += [role for role, columns in by_role.items() if len(columns) > 1]
        if not unclear:
            return
        names = [n.strip() for n, c in zip(self.text.names, self.known) if n and not c]
        names += [c.name for role in unclear for c in by_role.get(role, ())]
        seen = f" (it has {abridged(', '.join(map(repr, names)), 80)})" if names else ""
        options = " ".join(f"{role}=NAME" for role in unclear)
        number = ", or a number, such as theta_i=30" if "theta_i" in unclear else ""
        roles = ", one ".join(unclear)
        say = f"say --columns {options}{number}"
        questions = [f"one column must be {roles}{seen}: {say}"]
        if not self.own and not self._stated_quantity()[0]:
            questions.append(_quantity_question())
        # azimuths of exit without those of incidence
        relative = "delta_phi" in there or there & {"phi_i", "phi_o"} == {"phi_o"}
        if relative and self.specified.azimuth is None:
            questions.append(azimuth_question("azimuths"))
        here = f"{self.place}, line {self.text.number}"
        check_nothing_open(here, self.questions + questions)

    # ------------------------------------------------------------------------- numbers

    def _read_numbers(self) -> None:
        """Read the picked columns into `arrays`, and rows' numbers into `lines`."""
        table = self.text.rows
        self.lines = np.array([number for number, _ in table])
        self.arrays: dict[str, Any] = {}
        for role, column in self.picked.items():
            place = self.text.names.index(column.name)
            self.arrays[role] = np.array([row[place] for _, row in table], dtype=object)
        self._leave_out("without a value", *without_value(self.arrays["value"]))
        for role, column in self.picked.items():
            cells = self.lines, self.arrays[role]
            self.arrays[role] = column_numbers(self.place, column, *cells)
        n = len(self.lines)
        self.arrays |= {role: np.full(n, x) for role, x in self.constants.items()}
        gone, codes, azimuths = without_number(
            self.arrays, self.picked.keys() - {"value"}
        )
        self.arrays |= azimuths
        self._leave_out("without another number than the value", gone, codes)
        if "wavelength" in self.arrays:
            self._pick_wavelength()
        self._note_columns()

    def _leave_out(self, which: str, gone: Flags, codes: Iterable[str] = ()) -> None:
        """Keep the other rows, with a note, and which codes stand for no number."""
        n_gone = int(np.count_nonzero(gone))
        if n_gone == len(gone):
            raise FileFormatError(f"{self.place} has no row but those {which}")
        if n_gone:
            listed = ", ".join(sorted(one for one in codes if one.startswith("-9")))
            why = f": {listed} stands for none" if listed else ""
            rows = number_of(n_gone, "row")
            self.notes.append(f"{rows} {which} left out{why}")
        self._keep(~gone)

    def _keep(self, rows: Flags) -> None:
        """Keep some rows."""
        self.lines = self.lines[rows]
        self.arrays = {role: column[rows] for role, column in self.arrays.items()}

    def _pick_wavelength(self) -> None:
        """Keep the rows of one wavelength of a column of them, or ask for it."""
        channel = self.specified.channel
        unit = self.picked["wavelength"].unit if "wavelength" in self.picked else ""
        nm = self.arrays.pop("wavelength") * FACTOR_OF[unit]
        if not unit and nm.max() < MIN_NM:
            self.questions.append(
                f"wavelengths up to {nm.max():.4g} have no unit: say --columns "
                "wavelength=NAME:um"
            )
            return
        names = {f"{one:.10g}nm": one for one in np.unique(nm)}
        if channel is None and len(names) > 1:
            self.questions.append(_channel_question(list(names)))
            return
        self.channel = chosen_channel(self.place, list(names), channel)
        self._keep(np.abs(nm - names[self.channel]) <= WAVELENGTH_ROUNDING)

    def _note_columns(self) -> None:
        """Note the interpretation of column names, unless they are our own."""
        columns = []
        for role, column in self.picked.items():
            unit = f" in {column.unit or 'deg'}" if role in ANGLES else ""
            columns.append(f"{role} is {column.name.strip()!r}{unit}")
        columns += [f"{role} is {value:g}" for role, value in self.constants.items()]
        if not self.own:
            self.notes.insert(0, f"columns: {', '.join(columns)}")
        used = {column.name for column in self.known if column} | {""}
        if unused := [repr(name) for name in self.text.names if name not in used]:
            self.notes.append(f"not used: {abridged(', '.join(unused), 200)}")
        if self.text.decimal_comma:
            self.notes.append("numbers have decimal commas")

    # -------------------------------------------------------------------------- values

    def _stated_quantity(self) -> tuple[str, str]:
        """Quantity, and where it is from: as specified, of names, or of the title."""
        if "quantity" in self.settings:
            return self.settings["quantity"], "specified"
        for column in self.known:
            if column and column.quantity:
                return column.quantity, "their name says"
        title = "\n".join(self.titles)
        found = {q for p, q in QUANTITY_PATTERNS if re.search(p, title, re.IGNORECASE)}
        return (found.pop(), "the title says") if len(found) == 1 else ("", "")

    def _quantity(self) -> str:
        """Quantity with a note on where it is from, or a question."""
        column, (found, source) = self.picked["value"], self._stated_quantity()
        name = column.name.strip()
        if source == "specified":
            if column.quantity in ("", found):
                return found
            source += f", although their name {name!r} says {column.quantity}"
        if not found and self.own:
            found = "brdf"
            self.notes.append(
                "no quantity is stated: taken as brdf in 1/sr, without cosine; "
                "--quantity sets another"
            )
        elif not found:
            self.questions.append(_quantity_question(name))
        elif not (self.own and found == "brdf"):
            self.notes.append(f"the values are {found}, as {source}")
        return found

    def _panel(self, quantity: str) -> float:
        """Reflectance of a reference panel that values are multiplied with, or 1."""
        panel = self.specified.panel_reflectance
        if panel is not None:
            self.notes.append(f"values times {panel:g}, that of the reference panel")
            self.header = {  # a saved table holds it
                key: text
                for key, text in self.header.items()
                if not PANEL.match(f"{key.replace('_', ' ')}: {text}")
            }
        elif quantity == "reflectance_factor" and any(map(PANEL.match, self.titles)):
            self.questions.append(
                "its title states the reflectance of a reference panel: say "
                "--panel-reflectance, or 1 if the values hold it"
            )
        return panel or 1.0

    def _values(self, quantity: str) -> dict[str, Any]:
        """Values and their absolute standard uncertainties."""
        unit, panel = self.picked["value"].unit, self._panel(quantity)
        part = FACTOR_OF[unit]
        if part != 1:
            whole = "1" if unit == "%" else "1/sr"
            self.notes.append(f"values in {unit}: {1 / part:g} {unit} is {whole}")
        values = self.arrays["value"] * part * panel
        column, sigma = self.picked.get("sigma"), self.arrays.get("sigma")
        if sigma is None or column is None:
            return {"value": values} | ({} if sigma is None else {"sigma": sigma})
        coverage = self._coverage(column)
        name, sigma = column.name.strip(), sigma / coverage
        its = f"the uncertainty {name!r:.40}"
        say = f"say --columns sigma='{name}"
        if np.isnan(coverage):
            standard = f"or sigma='{name}' if it is standard"
            self.questions.append(f"{its} may be expanded: {say}:k=2', {standard}")
        both = column.unit in ("%", "1") and unit == column.unit
        if column.kind == "?" or (both and not column.kind):
            those = f"and the values are in {unit}" if both else "may be in %"
            relative = ":rel' if it is relative to each value (or :abs)"
            self.questions.append(f"{its} {those}: {say}{relative}")
        kind = column.kind or ("rel" if column.unit in ("%", "1") else "abs")
        own = FACTOR_OF[column.unit]
        if kind == "rel":
            sigma = sigma * own * np.abs(values)
        else:
            sigma = sigma * panel * (own if column.unit else part)
        if not self.own:
            k = f", divided by k = {coverage:g}" if coverage != 1 else ""
            self.notes.append(f"{name!r}: {KINDS.get(kind)} uncertainty{k}")
        return {"value": values, "sigma": sigma}

    def _coverage(self, column: Column) -> float:
        """Coverage factor of uncertainties; NaN if another than theirs is stated."""
        if "sigma" in self.specified.columns or coverage_of(column.name):
            return column.coverage
        lines = [line for line in self.titles if re.search(r"\bk\s*[=:]", line, re.I)]
        names = {name.replace("_", " ").strip().lower() for name in self.text.names}
        stated = {coverage_of(line) for line in lines} - {0, column.coverage}
        return float("nan") if stated or FACTOR_NAMES & names else column.coverage

    def _check_ranges(self, columns: Mapping[str, Any], quantity: str) -> None:
        """Raise FileFormatError with line and column of the first that does not fit."""
        for name, column in columns.items():
            good, condition = fits(name, column, quantity)
            if not good.all():
                row = int(np.argmin(good))
                raise FileFormatError(
                    f"{self.place}, line {self.lines[row]}, column {name}: must be "
                    f"{condition}, got {column[row]:g}"
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

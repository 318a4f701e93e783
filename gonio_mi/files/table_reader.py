"""Plain tables: which column is what, and one question on all that is open."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..array_types import Floats
from ..errors import (
    FileFormatError,
    SettingError,
    abridged,
    checked_choice,
    shown,
)
from .channels import chosen_channel
from .measured_table import COLUMNS, QUANTITIES, MeasuredTable, fits, parsed_keys
from .table_names import ANGLES, COLOURS, ROLES, Column, recognised, unit_of
from .table_text import TextTable, decimal, is_decimal, split_text

__all__ = ["AZIMUTHS", "OpenQuestionsError", "check_nothing_open", "read_text"]

# What azimuths of exit count from.
AZIMUTHS = ("specimen", "source", "mirror")

OWN = (*COLUMNS, "sigma")
DEGREES = {"deg": 1.0, "": 1.0, "rad": float(np.degrees(1.0))}
NM = {"nm": 1.0, "um": 1e3, "m": 1e9}
SAID_UNITS = ("", "deg", "rad", "rel", "abs")

# What stands for no value.
MISSING = re.compile(r"|nan|--?|n/?a|null|-9{2,}(\.[09]*)?", re.IGNORECASE)

# The same as numbers of angles, wavelengths and uncertainties.
CODES = (-99, -999, -9999)

# Angles that all are as small as in radians, in degrees; nothing is told apart below.
SILENT = {"polar angles": np.pi, "azimuths": 2 * np.pi}
NONE = 1e-3

# A wavelength that is a column's is at most this far in nm from the one asked for.
SAME_WAVELENGTH = 1e-6

# What titles and names of files call the quantities.
HINTS = (
    (r"\b(BRF|reflectance factors?|radiance factors?)\b", "reflectance_factor"),
    (r"\b(cosine.corrected BRDF|CCBRDF|BRDF ?[*x] ?cos)", "brdf_cos"),
    (r"\bBTDF\b", "btdf"),
    (r"\bBRDF\b", "brdf"),
)


class OpenQuestionsError(FileFormatError):
    """A text that leaves questions open."""

    def __init__(self, message: str, place: str, questions: Sequence[str]) -> None:
        super().__init__(message)
        self.place, self.questions = place, list(questions)


def check_nothing_open(place: str, questions: Sequence[str]) -> None:
    """Raise OpenQuestionsError with all that is to be said of the text at `place`.

    Several questions leave no room for the folder: a long message loses its middle.
    """
    if not questions:
        return
    said = f"{place}: {questions[0]}"
    if len(questions) > 1:
        each = "; ".join(f"({i}) {one}" for i, one in enumerate(questions, 1))
        said = f"{Path(place).name} leaves open: {each}"
    raise OpenQuestionsError(said, place, questions)


def read_text(
    path: str | PathLike[str],
    channel: str | None = None,
    quantity: str | None = None,
    columns: Mapping[str, str] | None = None,
    azimuth: str | None = None,
) -> MeasuredTable:
    """Table of a text; see :func:`gonio_mi.read_measured`."""
    columns = columns or {}
    names = {said.partition(":")[0].strip().lower() for said in columns.values()}

    def known(name: str) -> bool:
        return recognised(name) is not None or name.strip().lower() in names

    text = split_text(path, known, ", ".join(COLUMNS))
    settings, header = parsed_keys(text.place, text.comments)
    reading = _Reading(text, columns, in_degrees=bool(settings))
    if quantity is not None:
        settings["quantity"] = checked_choice("quantity", quantity, QUANTITIES)
    if azimuth is not None:
        checked_choice("azimuth", azimuth, AZIMUTHS)
    arrays, picked, chosen = reading.columns(channel, settings.get("quantity"), azimuth)
    reading.convert_angles(arrays, picked)
    settings["quantity"] = reading.quantity(picked["value"], settings.get("quantity"))
    value, sigma = reading.values(arrays, picked, settings)
    directions = reading.directions(arrays, azimuth)
    check_nothing_open(text.place, reading.open)
    if settings["quantity"] == "btdf" and not reading.own:
        directions["theta_o"] = reading.from_lit_side(directions["theta_o"])
    if chosen is not None:
        settings.setdefault("channel", chosen)
    made: dict[str, Any] = {**directions, "value": value, "sigma": sigma}
    if reading.own:
        reading.check_ranges(made, settings["quantity"])
    made |= {"header": header, "name": text.place, "notes": tuple(reading.notes)}
    try:
        return MeasuredTable(**made, **settings)
    except ValueError as error:
        raise FileFormatError(f"{text.place}: {error}") from None


class _Reading:
    """What is understood of a text, in notes, and what it leaves open, as questions.

    Parameters
    ----------
    text : TextTable
    said : mapping
        Name of the column for a role, with ``:deg`` and the like if its name does not
        say it, or a number in its place.
    in_degrees : bool
        Whether columns with our names are, as those below a header of ours.
    """

    def __init__(
        self, text: TextTable, said: Mapping[str, str], in_degrees: bool
    ) -> None:
        self.text, self.place = text, text.place
        self.here = f"{text.place}, line {text.number}"
        self.notes: list[str] = []
        self.open: list[str] = []
        self.constants: dict[str, float] = {}
        self.known = [recognised(name) for name in text.names]
        # our own names: in degrees, all five, nothing beside them
        self.own = set(text.names) >= set(COLUMNS) and not said
        self.in_degrees = in_degrees and self.own
        bare = [name.partition(" [")[0] for name in text.names]
        for colour in COLOURS if set(bare) >= set(COLOURS) else ():
            index = bare.index(colour)
            name = text.names[index]
            self.known[index] = Column(name, "value", unit_of(name), channel=colour)
        for role, word in said.items():
            self._assign(role, str(word))
        for name in text.names if self.own else ():
            if name not in OWN:
                raise FileFormatError(
                    f"{self.here}: a column must be one of {', '.join(OWN)}, got "
                    f"{shown(name)}"
                )
            if text.names.count(name) > 1:
                raise FileFormatError(f"{self.here}: the column {name} must occur once")

    def _assign(self, role: str, word: str) -> None:
        """Take a column, or a number, for what the user says that it is."""
        if role not in ROLES:
            raise SettingError(
                f"columns must name {', '.join(ROLES)}, got {shown(role)}"
            )
        names = [own.strip().lower() for own in self.text.names]
        whole = word.strip().lower() in names
        name, _, unit = (word, "", "") if whole else word.partition(":")
        if unit not in SAID_UNITS:
            raise SettingError(
                f"columns must give angles in deg or rad, and sigma as rel or abs, got "
                f"{shown(word)}"
            )
        self.known = [None if c and c.role == role else c for c in self.known]
        if name.strip().lower() in names:
            index = names.index(name.strip().lower())
            own = self.text.names[index]
            column = recognised(own) or Column(own, role, unit_of(own))
            kind = unit if unit in ("rel", "abs") else column.kind
            unit = unit if unit in ("deg", "rad") else column.unit
            # what is said to be sigma is a standard uncertainty unless its name says k
            k = 1.0 if np.isnan(column.coverage) else column.coverage
            self.known[index] = replace(
                column, role=role, unit=unit, kind=kind, coverage=k
            )
        elif is_decimal(name):
            self.constants[role] = decimal(name) * DEGREES.get(unit, 1.0)
        else:
            raise SettingError(
                f"columns must name columns of {self.place} "
                f"({abridged(', '.join(self.text.names), 120)}), got {shown(name)}"
            )

    # ------------------------------------------------------------------------- columns

    def columns(
        self, channel: str | None, quantity: str | None, azimuth: str | None
    ) -> tuple[dict[str, Floats], dict[str, Column], str | None]:
        """Numbers by role, the columns that they are of, and the channel."""
        picked, chosen, unclear = self._picked(channel)
        unclear += self._missing()
        values = [column for column in self.known if column and column.role == "value"]
        titled = any(column.quantity for column in values) or self._titled()
        if unclear and not (quantity or self.own or titled):
            unclear.append(_quantity_question())
        if unclear and azimuth is None and self._has_relative_azimuths():
            unclear.append(_azimuth_question("azimuths"))
        if unclear:
            check_nothing_open(self.here, self.open + unclear)
        if "value" in self.constants:
            raise SettingError(f"columns must name a column of values of {self.place}")
        for role in (r for r in ANGLES if r in picked):
            if picked[role].unit not in DEGREES:
                name = shown(picked[role].name.strip(), 60)
                raise FileFormatError(
                    f"{self.place}: the angle {role} must be in deg or rad, got {name}"
                )
        arrays = self._numbers(picked)
        n = len(arrays["value"])
        arrays |= {role: np.full(n, value) for role, value in self.constants.items()}
        arrays = self._without_codes(arrays)
        if "wavelength" in picked:
            chosen = self._one_wavelength(arrays, picked["wavelength"], channel)
        if not self.own:
            self._note_columns(picked)
        return arrays, picked, chosen

    def _picked(
        self, channel: str | None
    ) -> tuple[dict[str, Column], str | None, list[str]]:
        """The one column of each role, the channel of the values, and what is unclear.

        Of several channels the first, beside a question: more may be open than that.
        """
        by_role: dict[str, list[Column]] = {}
        for column in self.known:
            if column is not None and column.role not in self.constants:
                by_role.setdefault(column.role, []).append(column)
        values = by_role.get("value", [])
        names = [column.channel for column in values if column.channel]
        chosen = names[0] if len(names) == 1 else None
        if len(names) > 1 and channel is None:
            self.open.append(_channel_question(names))
            by_role["value"] = values[:1]
            by_role.pop("sigma", None)
        elif names and channel is not None:
            chosen = chosen_channel(self.place, names, channel)
            by_role["value"] = [c for c in values if c.channel == chosen]
        elif channel is not None and "wavelength" not in by_role:
            raise SettingError(
                f"channel goes with a table of several, got {channel!r} for "
                f"{self.place}"
            )
        if chosen:
            same = [c for c in by_role.get("sigma", []) if c.channel in ("", chosen)]
            by_role["sigma"] = same
        several = {r: ", ".join(repr(c.name) for c in of) for r, of in by_role.items()}
        unclear = [
            f"several columns may be {r} ({several[r]:.150}); say --columns {r}=NAME"
            for r, of in by_role.items()
            if len(of) > 1
        ]
        return {r: of[0] for r, of in by_role.items() if of}, chosen, unclear

    def _has_relative_azimuths(self) -> bool:
        """Whether azimuths of exit stand without those of incidence."""
        there = {column.role for column in self.known if column} | set(self.constants)
        return "delta_phi" in there or ("phi_o" in there and "phi_i" not in there)

    def _missing(self) -> list[str]:
        """Question for the columns that no text can do without."""
        own = {column.role for column in self.known if column} - set(self.constants)
        there = own | set(self.constants)
        needed = ["theta_i", "theta_o", "value", *(["phi_o"] if "phi_i" in own else [])]
        if "delta_phi" in there:
            there.add("phi_o")
        lacks = [role for role in needed if role not in there]
        if not lacks:
            return []
        said = " ".join(f"{role}=NAME" for role in lacks)
        what = f"the column {lacks[0]} is missing; if another name stands for it"
        if len(lacks) > 1:
            names = f"{', '.join(lacks[:-1])} and {lacks[-1]}"
            what = f"the columns {names} are missing; if other names stand for them"
        other = [n.strip() for n, c in zip(self.text.names, self.known) if n and not c]
        seen = f" ({abridged(', '.join(map(repr, other)), 80)})" if other else ""
        question = f"{what}{seen}, say --columns {said}"
        if lacks[0] == "theta_i":
            question += ", or a number for all rows, such as theta_i=30"
        return [question]

    def _numbers(self, picked: Mapping[str, Column]) -> dict[str, Floats]:
        """Numbers of the picked columns in rows with a value, and lines of the rows."""
        names = self.text.names
        places = {role: names.index(column.name) for role, column in picked.items()}
        numbers: dict[str, list[float]] = {role: [] for role in places}
        self.lines: list[int] = []
        missing: list[str] = []
        for number, cells in self.text.cells():
            cell = cells[places["value"]].strip()
            if MISSING.fullmatch(cell) and not (self.own and not cell.startswith("-9")):
                missing.append(cell)
                continue
            self.lines.append(number)
            for role, index in places.items():
                where = f"{self.place}, line {number}, column {names[index]}"
                try:
                    numbers[role].append(decimal(cells[index]))
                except ValueError as error:
                    raise FileFormatError(f"{where}: {error}") from None
                if not np.isfinite(numbers[role][-1]) and not self.own:
                    raise FileFormatError(
                        f"{where}: must be a finite number, got {cells[index].strip()}"
                    )
        if not self.lines:
            raise FileFormatError(f"{self.place} has no row with a value")
        if missing:
            marks = ", ".join(sorted({one for one in missing if one.startswith("-9")}))
            said = f": {marks} stands for none" if marks else ""
            self.notes.append(f"{len(missing)} rows without a value are left out{said}")
        return {role: np.array(values) for role, values in numbers.items()}

    def _without_codes(self, arrays: dict[str, Floats]) -> dict[str, Floats]:
        """Rows in which no number stands for none; azimuths at the normal may."""
        normal = {side: arrays[f"theta_{side}"] % 180 == 0 for side in "io"}
        normal["d"] = normal["i"] | normal["o"]
        gone, found = np.zeros(len(arrays["value"]), dtype=bool), set()
        for role in set(arrays) - {"value"} - set(self.constants):
            column = arrays[role]
            none = np.isin(column, CODES)
            if role in ANGLES and (column[~none] < 0).any():
                none &= column < -180  # beside other negative angles, -99 is one
            if "phi" in role:
                side = "d" if role == "delta_phi" else role[-1]
                arrays[role] = np.where(none & normal[side], 0.0, column)
                none &= ~normal[side]
            found |= set(column[none].tolist())
            gone |= none
        if not gone.any():
            return arrays
        if gone.all():
            raise FileFormatError(f"{self.place} has no row without a missing number")
        marks = ", ".join(f"{code:g}" for code in sorted(found))
        self.notes.append(
            f"{np.count_nonzero(gone)} rows that lack another number than the value "
            f"are left out: {marks} stands for none"
        )
        self.lines = [line for line, out in zip(self.lines, gone) if not out]
        return {role: column[~gone] for role, column in arrays.items()}

    def _one_wavelength(
        self, arrays: dict[str, Floats], column: Column, channel: str | None
    ) -> str | None:
        """Keep the rows of one wavelength of a column of them, or ask for it."""
        nm = arrays.pop("wavelength") * NM.get(column.unit, 1.0)
        names = {f"{one:.10g}nm": one for one in np.unique(nm)}
        if channel is None and len(names) > 1:
            self.open.append(_channel_question(list(names)))
            return None
        channel = chosen_channel(self.place, list(names), channel)
        here = np.abs(nm - names[channel]) <= SAME_WAVELENGTH
        for role in arrays:
            arrays[role] = arrays[role][here]
        return channel

    def _note_columns(self, picked: Mapping[str, Column]) -> None:
        """Say what was inferred from the names."""
        units = {r: f" in {c.unit or 'deg'}" for r, c in picked.items() if r in ANGLES}
        said = [
            f"{role} is {column.name.strip()!r}{units.get(role, '')}"
            for role, column in picked.items()
        ]
        said += [f"{role} is {value:g}" for role, value in self.constants.items()]
        self.notes.insert(0, f"columns: {', '.join(said)}")
        used = {column.name for column in picked.values()} | {""}
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
        found = {q for pattern, q in HINTS if re.search(pattern, title, re.IGNORECASE)}
        return found.pop() if len(found) == 1 else None

    def quantity(self, column: Column, said: str | None) -> str | None:
        """What the values are: as said, as names or titles have it, or a question."""
        if said is not None:
            if column.quantity and column.quantity != said:
                self.notes.append(
                    f"the values are taken for {said}, as is said, though the name "
                    f"{column.name.strip()!r} says {column.quantity}"
                )
            return said
        if self.own:
            return "brdf"
        found = column.quantity or self._titled()
        if not found:
            self.open.append(_quantity_question(column.name))
            return None
        said_by = "their name" if column.quantity else "the title"
        self.notes.append(f"the values are {found}, as {said_by} says")
        return found

    def values(
        self,
        arrays: Mapping[str, Floats],
        picked: Mapping[str, Column],
        settings: Mapping[str, Any],
    ) -> tuple[Floats, Floats | None]:
        """Values and their absolute standard uncertainties."""
        unit = picked["value"].unit
        percent = 0.01 if unit.startswith("%") else 1.0
        if percent != 1:
            whole = "1/sr" if unit == "%/sr" else "1"
            self.notes.append(f"values in {unit}: 100 {unit} is {whole}")
        values = arrays["value"] * percent
        column = picked.get("sigma")
        if column is None or "sigma" not in arrays:
            return values, arrays.get("sigma")
        sigma, kind = arrays["sigma"] / column.coverage, column.kind
        if np.isnan(column.coverage):
            self.open.append(
                f"the uncertainty {column.name.strip()!r:.40} may be expanded: give "
                "its name the factor, such as k=2, or say --columns "
                f"sigma='{column.name.strip()}' if it is standard"
            )
        if not kind and column.unit in ("%", "1") and unit == column.unit:
            self.open.append(
                f"the uncertainty {column.name.strip()!r:.40} and the values are in "
                f"{unit}: say --columns sigma='{column.name.strip()}:rel' if it is "
                "relative to each value (or :abs)"
            )
        kind = kind or ("rel" if column.unit in ("%", "1") else "abs")
        own = 0.01 if column.unit.startswith("%") else 1.0
        if kind == "rel":
            sigma = sigma * own * np.abs(values)
        else:
            sigma = sigma * (own if column.unit else percent)
        if not self.own:
            said = {"rel": "relative", "abs": "absolute"}[kind]
            k = f", divided by k = {column.coverage:g}" if column.coverage != 1 else ""
            self.notes.append(f"{column.name.strip()!r}: {said} uncertainty{k}")
        if settings.get("uncertainty"):
            self.notes.append(
                f"the header's uncertainty of {settings['uncertainty']:.3g} of each "
                "value adds to that in quadrature"
            )
        return values, sigma

    # ------------------------------------------------------------------------- angles

    def convert_angles(
        self, arrays: dict[str, Floats], picked: Mapping[str, Column]
    ) -> None:
        """Angles in degrees, or a question for those that may be in either unit."""
        kinds = {
            "polar angles": ("theta_i", "theta_o"),
            "azimuths": ("phi_i", "phi_o", "delta_phi"),
        }
        unsaid = []
        for kind, roles in kinds.items():
            silent = [r for r in roles if r in picked and not picked[r].unit]
            angles = np.concatenate([arrays[r] for r in silent] or [np.zeros(1)])
            angles = np.abs(angles[np.isfinite(angles)])
            whole = (np.abs(angles - np.round(angles)) < NONE).all()
            if not (whole or self.in_degrees) and angles.max() <= SILENT[kind]:
                unsaid.append((kind, silent[0], angles.max()))
        if unsaid:
            kind, role, _ = unsaid[0]
            kind = "angles" if len(unsaid) > 1 else kind
            largest = max(one[2] for one in unsaid)
            self.open.append(
                f"{kind} up to {largest:.4g} may be degrees or radians: say --columns "
                f"{role}='{picked[role].name.strip()}:rad' (or :deg), and so of each"
            )
        for role in ANGLES:
            if role in picked:
                arrays[role] = arrays[role] * DEGREES[picked[role].unit]

    def directions(
        self, arrays: Mapping[str, Floats], azimuth: str | None
    ) -> dict[str, Floats]:
        """Polar angles, and azimuths of the specimen, in degrees."""
        theta_i, theta_o = arrays["theta_i"], arrays["theta_o"]
        zero = np.zeros(len(theta_i))
        phi_i = arrays.get("phi_i", zero)
        signed = bool((theta_o < 0).any() or (theta_i < 0).any())
        absolute = "phi_o" in arrays and "phi_i" in arrays and "delta_phi" not in arrays
        if absolute and signed and azimuth != "specimen":
            # azimuths that are all the same tell no side
            phis = np.concatenate([phi_i, arrays["phi_o"]])
            absolute = bool((phis != phis[0]).any())
        relative = arrays.get("delta_phi")
        if relative is None:
            relative = arrays.get("phi_o", zero) - (phi_i if "phi_i" in arrays else 0)
        if absolute and azimuth in (None, "specimen"):
            phi_o = arrays["phi_o"]
        else:
            needed = (theta_o != 0).any() and (theta_i != 0).any()
            if needed and azimuth in (None, "specimen"):
                what = "angles" if signed else "azimuths"
                self.open.append(_azimuth_question(what))
            phi_o = phi_i + relative + (180 if azimuth == "mirror" else 0)
            self.notes.append(
                f"azimuths count from {azimuth or 'nothing that matters'}"
                + (", signed polar angles are on both sides" if signed else "")
            )
        if signed:
            # without azimuths the side of the source may have the minus sign
            if absolute or (theta_i > 0).any():
                phi_i = phi_i + 180.0 * (theta_i < 0)
            phi_o = phi_o + 180.0 * (theta_o < 0)
            theta_i, theta_o = np.abs(theta_i), np.abs(theta_o)
            if absolute and azimuth is None:
                self.notes.append(
                    "negative polar angles are positive ones half a turn on"
                )
        return {"theta_i": theta_i, "phi_i": phi_i, "theta_o": theta_o, "phi_o": phi_o}

    def from_lit_side(self, theta_o: Floats) -> Floats:
        """Polar angles of transmission from the normal of the lit face."""
        if (theta_o > 90).any():
            return theta_o
        self.notes.append(
            "theta_o of transmission counts from the normal of the other face"
        )
        return 180 - theta_o

    def check_ranges(self, columns: Mapping[str, Any], quantity: str) -> None:
        """Raise FileFormatError with line and column of the first that does not fit."""
        for name in (n for n in OWN if columns.get(n) is not None):
            good, condition = fits(name, columns[name], quantity)
            if not good.all():
                row = int(np.argmin(good))
                raise FileFormatError(
                    f"{self.place}, line {self.lines[row]}, column {name}: must be "
                    f"{condition}, got {columns[name][row]:g}"
                )


def _quantity_question(name: str = "") -> str:
    """Question what the values are, of the column of that name if it is known."""
    called = f" ({name.strip()!r:.40})" if name else ""
    return (
        f"it does not say what its values{called} are: say --quantity "
        f"{', '.join(QUANTITIES[:-1])} or {QUANTITIES[-1]}"
    )


def _azimuth_question(what: str) -> str:
    """Question where azimuths, or signed angles, are 0."""
    return (
        f"its {what} are relative to incidence: say --azimuth source or mirror, whose "
        "side is 0 (or positive), or --columns phi_i=0 if azimuths are the specimen's"
    )


def _channel_question(names: Sequence[str]) -> str:
    """Question which channel is meant."""
    known = abridged(", ".join(names), 120)
    return f"channel must be one of {known}: say --channel"

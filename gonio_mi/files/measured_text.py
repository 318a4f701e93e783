"""Tables of measured values in plain text: as we write them, and as others do."""

from collections.abc import Mapping
from os import PathLike
from typing import Any, NamedTuple

import numpy as np

from ..array_types import Floats
from ..errors import FileFormatError, checked_choice
from .column_names import recognised
from .measured_columns import Columns, parsed_columns
from .measured_header import parsed_keys
from .measured_table import COLUMNS, QUANTITIES, MeasuredTable
from .open_questions import check_nothing_open, quantity_question, titled_quantity
from .text_table import TextTable, split_text

__all__ = ["AZIMUTHS", "Said", "read_text"]

# What azimuths of exit count from.
AZIMUTHS = ("specimen", "source", "mirror")


class Said(NamedTuple):
    """What the user says of a text; see :func:`.measured.read_measured`."""

    channel: str | None
    quantity: str | None
    columns: Mapping[str, str] | None
    azimuth: str | None


def read_text(path: str | PathLike[str], said: Said) -> MeasuredTable:
    """Table of a text."""
    channel, quantity, columns, azimuth = said

    def known(name: str) -> bool:
        wanted = {said.partition(":")[0].lower() for said in (columns or {}).values()}
        return recognised(name) is not None or name.strip().lower() in wanted

    text = split_text(path, known, ", ".join(COLUMNS))
    settings, header = parsed_keys(text.place, text.comments)
    if quantity is not None:
        settings["quantity"] = checked_choice("quantity", quantity, QUANTITIES)
    if azimuth is not None:
        checked_choice("azimuth", azimuth, AZIMUTHS)
    parsed = parsed_columns(text, settings.get("quantity"), channel, columns)
    notes = parsed.notes
    quantity = _quantity(text, parsed, settings.get("quantity"), notes)
    arrays = parsed.arrays
    values, sigma = _values(arrays, parsed, settings, notes)
    directions: dict[str, Any] = _directions(arrays, parsed, azimuth)
    check_nothing_open(text.place, parsed.open)
    settings["quantity"] = quantity
    if settings["quantity"] == "btdf" and not parsed.own:
        directions["theta_o"] = _from_lit_side(directions["theta_o"], notes)
    if parsed.channel is not None:
        settings.setdefault("channel", parsed.channel)
    try:
        return MeasuredTable(
            **directions,
            value=values,
            sigma=sigma,
            **settings,
            header=header,
            name=text.place,
            notes=tuple(notes),
        )
    except ValueError as error:
        raise FileFormatError(f"{text.place}: {error}") from None


def _quantity(
    text: TextTable, parsed: Columns, said: str | None, notes: list[str]
) -> str | None:
    """What the values are: as said, as the names or titles have it, or asked for."""
    if said is not None:
        named = parsed.value.quantity
        if named and named != said:
            notes.append(
                f"the values are taken for {said}, as is said, though the name "
                f"{parsed.value.name.strip()!r} says {named}"
            )
        return said
    if parsed.own:
        return "brdf"
    if parsed.value.quantity:
        notes.append(f"the values are {parsed.value.quantity}, as their name says")
        return parsed.value.quantity
    titled = titled_quantity(text)
    if titled is None:
        parsed.open.append(quantity_question(parsed.value.name))
    else:
        notes.append(f"the values are {titled}, as the title says")
    return titled


def _values(
    arrays: Mapping[str, Floats],
    parsed: Columns,
    settings: Mapping[str, Any],
    notes: list[str],
) -> tuple[Floats, Floats | None]:
    """Values and their absolute standard uncertainties."""
    percent = 0.01 if parsed.value.unit == "%" else 1.0
    if percent != 1:
        notes.append("values in %: 100 % is 1")
    values = arrays["value"] * percent
    column = parsed.sigma
    if column is None or "sigma" not in arrays:
        return values, arrays.get("sigma")
    sigma = arrays["sigma"] / column.coverage
    if column.relative:
        sigma = sigma * np.abs(values) * (0.01 if column.unit == "%" else 1.0)
    else:
        sigma = sigma * percent
    if not parsed.own:
        kind = "relative" if column.relative else "absolute"
        k = f", divided by k = {column.coverage:g}" if column.coverage > 1 else ""
        notes.append(f"{column.name.strip()!r}: {kind} uncertainty{k}")
    if settings.get("uncertainty"):
        notes.append(
            f"the header's uncertainty of {settings['uncertainty']:.3g} of each value "
            "adds to that in quadrature"
        )
    return values, sigma


def _directions(
    arrays: Mapping[str, Floats], parsed: Columns, azimuth: str | None
) -> dict[str, Floats]:
    """Polar angles, and azimuths of the specimen, in degrees."""
    own, notes = parsed.own, parsed.notes
    theta_i, theta_o = arrays["theta_i"], arrays["theta_o"]
    zero = np.zeros(len(theta_i))
    phi_i = arrays.get("phi_i", zero)
    absolute = "phi_o" in arrays and "phi_i" in arrays
    relative = arrays.get("delta_phi", None if absolute else arrays.get("phi_o"))
    signed = not own and bool((theta_o < 0).any() or (theta_i < 0).any())
    if signed and relative is None and not absolute:
        relative = zero
    if absolute and azimuth in (None, "specimen") and "delta_phi" not in arrays:
        phi_o = arrays["phi_o"]
    else:
        if relative is None:
            relative = arrays["phi_o"] - phi_i if absolute else zero
        needed = (theta_o != 0).any() and (theta_i != 0).any()
        if needed and azimuth in (None, "specimen"):
            what = "angles" if signed else "azimuths"
            parsed.open.append(
                f"its {what} are relative to incidence: say --azimuth source or "
                "mirror, whose side is 0 (or positive)"
            )
        phi_o = phi_i + relative + (180 if azimuth == "mirror" else 0)
        notes.append(
            f"azimuths count from {azimuth or 'nothing that matters'}"
            + (", signed polar angles are on both sides" if signed else "")
        )
    if signed:
        if (theta_i > 0).any():  # else the side of the source has the minus sign
            phi_i = phi_i + 180.0 * (theta_i < 0)
        phi_o = phi_o + 180.0 * (theta_o < 0)
        theta_i, theta_o = np.abs(theta_i), np.abs(theta_o)
    return {"theta_i": theta_i, "phi_i": phi_i, "theta_o": theta_o, "phi_o": phi_o}


def _from_lit_side(theta_o: Floats, notes: list[str]) -> Floats:
    """Polar angles of transmission from the normal of the lit face."""
    if (theta_o > 90).any():
        return theta_o
    notes.append("theta_o of transmission counts from the normal of the other face")
    return 180 - theta_o

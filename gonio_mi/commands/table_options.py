"""Options on how a table of measured values is read, and what it says."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ..errors import FileFormatError, SettingError
from .arguments import add_number, add_text, given_options, pair
from .file_kinds import check_kind

if TYPE_CHECKING:
    from ..files.measured_table import MeasuredTable

TABLE_OPTIONS = ("channel", "quantity", "columns", "azimuth")


def add_table_options(group: Any) -> None:
    """Add the options on what a table of measured values leaves open."""
    add_text(group, "--channel", "NAME", "Channel of a table of several: 550nm.")
    add_text(
        group,
        "--quantity",
        "Q",
        "Quantity of the values, if the table does not state it: brdf, brdf_cos, btdf "
        "or reflectance_factor.",
    )
    group.add_argument(
        "--columns",
        nargs="+",
        action="extend",
        type=pair,
        metavar="ROLE=NAME",
        help="Column of theta_i, phi_i, theta_o, phi_o, delta_phi, value, sigma or "
        "wavelength. ROLE=NAME:rad for an angle in radians, ROLE=0 for a number that "
        "holds for all rows, such as theta_i=30.",
    )
    add_text(
        group,
        "--azimuth",
        "FROM",
        "Zero of azimuths of exit that are relative to incidence: source or mirror "
        "(the side of the mirror direction).",
    )


def add_uncertainties(group: Any, name: str) -> None:
    """Add the options on how well the values of a file are known, named so in help."""
    add_number(
        group,
        "--uncertainty",
        "X",
        f"Relative standard uncertainty of each value of {name}, independent between "
        "points: 0.005 is 0.5 %%. Default: as the table states.",
    )
    add_number(
        group,
        "--scale-uncertainty",
        "X",
        "Relative standard uncertainty of a factor common to all values: calibration. "
        "Default: as the table states.",
    )


def add_aperture(group: Any) -> None:
    """Add the option on the detector of a table that does not state it."""
    add_number(
        group,
        "--aperture-half-angle",
        "DEG",
        "Half-angle of the detector's aperture, if the table does not state it.",
    )


def check_no_table_options(
    path: str, options: Namespace, more: Sequence[str] = ()
) -> None:
    """Raise ValueError for an option of tables, or one `more`, of another file."""
    for name in given_options(options, (*TABLE_OPTIONS, *more)):
        option = name.replace("_", "-")
        raise SettingError(f"--{option} applies to tables only, got {path!r}")


def table_of(path: str, options: Namespace) -> MeasuredTable:
    """Table of a file, read as the options say."""
    from ..formats.reading import read_measured

    columns = dict(options.columns) if options.columns else None
    try:
        return read_measured(
            path,
            options.channel,
            quantity=options.quantity,
            columns=columns,
            azimuth=options.azimuth,
        )
    except FileFormatError:
        check_kind(path, "table")
        raise

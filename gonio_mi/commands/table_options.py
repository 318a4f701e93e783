"""Options on how a table of measured values is read, and what it says."""

from argparse import Namespace
from collections.abc import Sequence
from typing import Any

from ..errors import FileFormatError, SettingError
from ..files.measured_table import MeasuredTable
from ..formats.reading import read_measured
from .arguments import add_number, add_text, pair
from .file_kinds import check_kind

__all__ = [
    "TABLE_OPTIONS",
    "add_aperture",
    "add_table_options",
    "add_uncertainties",
    "check_no_table_options",
    "table_of",
]

TABLE_OPTIONS = ("channel", "quantity", "columns", "azimuth")


def add_table_options(group: Any) -> None:
    """Add the options on what a table of measured values leaves unsaid."""
    add_text(group, "--channel", "NAME", "of a table that has several, such as 550nm")
    add_text(
        group,
        "--quantity",
        "Q",
        "what the values of the table are, if it does not say it: brdf, brdf_cos, "
        "btdf or reflectance_factor",
    )
    group.add_argument(
        "--columns",
        nargs="+",
        action="extend",
        type=pair,
        metavar="ROLE=NAME",
        help="which column of the table is theta_i, phi_i, theta_o, phi_o, delta_phi, "
        "value, sigma or wavelength; ROLE=NAME:rad if an angle is in radians, and "
        "ROLE=0 for a number in its place",
    )
    add_text(
        group,
        "--azimuth",
        "FROM",
        "where azimuths of exit in the table are 0, if relative to incidence: on "
        "the side of the source or of the mirror direction (source, mirror)",
    )


def add_uncertainties(group: Any, name: str) -> None:
    """Add the options on how well the values of a file are known, named so in help."""
    add_number(
        group,
        "--uncertainty",
        "X",
        f"relative standard uncertainty of each value of {name}, 0.005 for 0.5 %%, "
        "independent between points (default: what the table says)",
    )
    add_number(
        group,
        "--scale-uncertainty",
        "X",
        "the same of a factor common to all values: calibration",
    )


def add_aperture(group: Any) -> None:
    """Add the option on the detector of a table that does not say it."""
    add_number(
        group,
        "--aperture-half-angle",
        "DEG",
        "of the detector, if the table does not say it",
    )


def check_no_table_options(
    path: str, options: Namespace, more: Sequence[str] = ()
) -> None:
    """Raise ValueError for an option of tables, or one `more`, that goes with none."""
    names = (*TABLE_OPTIONS, *more)
    told = [name for name in names if getattr(options, name) is not None]
    if told:
        option = told[0].replace("_", "-")
        raise SettingError(f"--{option} goes with a table, got {path!r}")


def table_of(path: str, options: Namespace) -> MeasuredTable:
    """Table of a file, read as the options say."""
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

"""``gonio-mi compare``: compare with another record or with measured values.

Compare a record with another record of the same collector, patch by patch, or with a
CSV table of measured values, whose columns are theta_i, phi_i, theta_o, phi_o, value
and, optional, sigma. A specimen in place of the record is measured at the solid angles
of the table and under its emitter.
"""

import json
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

from .. import files
from ..errors import SettingError
from .arguments import (
    DONE,
    FAILED,
    add_number,
    add_scene_options,
    add_text,
    pair,
    specimen_of,
    tell,
)
from .setting_options import add_setting

__all__ = ["add_options", "run"]

USAGE = "%(prog)s RECORD OTHER [options]"

EXAMPLES = """\
examples:
  gonio-mi compare run.npz another.npz
  gonio-mi compare run.npz measured.csv --uncertainty 0.005 -o compared.png
  gonio-mi compare roughconductor:alpha=0.2 measured.csv --rays 1e8 --json

The table's header holds lines such as `# quantity: brdf`, `# uncertainty: 0.005`,
`# aperture_half_angle: 0.75` and `# emitter_half_angle: 0.25`; angles are in degrees.
Exit code 3: they differ by more than chance explains.
"""

# Options on how a table is read.
TABLE_OPTIONS = ("channel", "quantity", "columns", "azimuth")


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add_text(
        parser,
        "record",
        "RECORD",
        "an .exr or .npz file; with a table also a specimen as of `measure`",
    )
    add_text(
        parser,
        "other",
        "OTHER",
        "an .exr or .npz file, or a table: CSV, or .astm",
    )
    _add_table_options(parser)
    add_number(
        parser, "--alpha", "P", "probability with which a right model fails", 1e-3
    )
    parser.add_argument("--json", action="store_true", help="for machines")
    parser.add_argument(
        "-o", "--output", metavar="FIG", help="picture of both curves, such as a.png"
    )
    specimen = parser.add_argument_group("for a specimen")
    for name in ("rays", "seed"):
        add_setting(specimen, name)
    add_number(
        specimen,
        "--aperture-half-angle",
        "DEG",
        "of the detector, if the table does not say it",
    )
    add_scene_options(specimen)


def _add_table_options(parser: ArgumentParser) -> None:
    """Add the options on what a table of measured values leaves unsaid."""
    add_text(
        parser,
        "--channel",
        "NAME",
        "of a table that has several, such as 550nm",
    )
    add_text(
        parser,
        "--quantity",
        "Q",
        "what the values of the table are, if it does not say it: brdf, brdf_cos, "
        "btdf or reflectance_factor",
    )
    parser.add_argument(
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
        parser,
        "--azimuth",
        "FROM",
        "where azimuths of exit in the table are 0, if relative to incidence: on "
        "the side of the source or of the mirror direction (source, mirror)",
    )
    add_number(
        parser,
        "--uncertainty",
        "X",
        "relative standard uncertainty of each value of OTHER, 0.005 for 0.5 %%, "
        "independent between points (default: what the table says)",
    )
    add_number(
        parser,
        "--scale-uncertainty",
        "X",
        "the same of a factor common to all values: calibration",
    )


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    from ..comparison import compare, measure_like
    from ..files.measured import read_measured
    from ..plots import check_picture

    def is_record(path: str) -> bool:
        return Path(path).suffix.lower() in files.ENDINGS

    if options.output is not None:
        check_picture(options.output)
    told = {name: getattr(options, name) for name in TABLE_OPTIONS}
    if is_record(options.other):
        for name, value in told.items():
            if value is not None:
                raise SettingError(f"--{name} goes with a table, got {options.other!r}")
        other: Any = files.load(options.other)
    else:
        told["columns"] = dict(told["columns"]) if told["columns"] else None
        other = read_measured(options.other, **told)
    if is_record(options.record):
        if options.aperture_half_angle is not None:
            raise SettingError(
                "--aperture-half-angle goes with a specimen, which is measured; "
                f"{options.record} was"
            )
        record: Any = files.load(options.record)
    elif is_record(options.other):
        raise SettingError(
            f"RECORD must be an .exr or .npz file if OTHER is one, got {options.record}"
        )
    else:
        specimen, parameters = specimen_of(options.record, options)
        record = measure_like(
            specimen,
            other,
            parameters=parameters,
            aperture_half_angle=options.aperture_half_angle,
            rays=options.rays,
            seed=options.seed or 0,
        )
    comparison = compare(
        record,
        other,
        uncertainty=options.uncertainty,
        scale_uncertainty=options.scale_uncertainty,
        alpha=options.alpha,
    )
    if options.output is not None:
        comparison.plot(options.output)
    if options.json:
        print(json.dumps(comparison.to_dict(), indent=2, allow_nan=False))
    else:
        tell(comparison)
    return DONE if comparison.passed else FAILED

r"""``gonio-mi compare``: compare with another record or with measured values.

Compare a record with another record of the same collector, patch by patch, or with a
table of measured values: text with columns, or a file of Zemax, Speos, FRED,
OpenMATERIAL or MERL. A specimen in place of the record is measured at the solid angles
of the table and under its emitter; a specimen in place of the other is measured as the
record was. Two tables are compared where they have the same directions.

examples:
  gonio-mi compare run.npz another.npz
  gonio-mi compare run.npz measured.csv --uncertainty 0.005 -o compared.png
  gonio-mi compare roughconductor:alpha=0.2 measured.csv --budget budget.csv
  gonio-mi compare diffuse panel.txt --channel 550nm \
      --quantity reflectance_factor --columns theta_i=src_z theta_o=view_z \
      --azimuth mirror --aperture-half-angle 1
  gonio-mi compare run.npz roughconductor:alpha=0.21
  gonio-mi compare ours.csv theirs.csv --uncertainty 0.01 -o both.png

The table's header holds lines such as `# quantity: brdf`, `# uncertainty: 0.005`,
`# aperture_half_angle: 0.75` and `# emitter_half_angle: 0.25`; angles are in degrees.
For a table of a wavelength the default variant is llvm_ad_spectral. Exit code 3: they
differ by more than chance explains; 2: patches cannot decide it.
"""

import re
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from math import hypot
from pathlib import Path
from typing import Any

from ... import files
from ...commands.arguments import (
    DONE,
    FAILED,
    INCOMPLETE,
    add_aperture,
    add_json,
    add_number,
    add_scene_options,
    add_setting,
    add_table_options,
    add_text,
    add_uncertainties,
    check_no_table_options,
    given_options,
    option_of,
    specimen_of,
    table_of,
    tell,
    tell_json,
    variant_of,
)
from ...commands.file_kinds import is_table, record_of
from ...errors import OpenQuestionsError, SettingError, check_nothing_open
from ...surfaces.meshes import MESHES

USAGE = "%(prog)s RECORD OTHER [options]"

# Settings with which a specimen is measured.
MEASURED = ("rays", "rel_err", "divergence", "period")

# What names a specimen, and no table.
SCENES = (".xml", *MESHES)
SPECIMEN = re.compile(r"[A-Za-z_]\w+(:.*)?")


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    text = "An .exr or .npz file, a table, or a specimen to be measured as OTHER was."
    add_text(parser, "record", "RECORD", text)
    text = "An .exr or .npz file, a table, or a specimen, if RECORD is a file."
    add_text(parser, "other", "OTHER", text)
    add_table_options(parser)
    add_uncertainties(parser, "OTHER")
    text = "Probability with which equal values are reported to differ."
    add_number(parser, "--alpha", "P", text, 1e-3)
    add_json(parser)
    text = "Picture of both curves, such as a.png."
    parser.add_argument("-o", "--output", metavar="FIG", help=text)
    add_text(
        parser,
        "--budget",
        "CSV",
        "Write the uncertainty of each point by source: rays, single precision, "
        "instrument, calibration and, of a specimen with a table, aperture.",
    )
    specimen = parser.add_argument_group("Specimen")
    for name in (*MEASURED, "seed"):
        add_setting(specimen, name)
    add_aperture(specimen)
    add_scene_options(parser)
    # that of the record, or what a table's channel needs
    parser.set_defaults(variant=None)


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    from ...plots import check_picture
    from ..comparison import compare, measure_like

    if options.output is not None:
        check_picture(options.output)
    if options.budget is not None:
        files.check_output(options.budget, (".csv",))
    other = _other(options)
    record, specimen, parameters = _record_and_specimen(options, other)
    settings = {
        "parameters": parameters,
        "aperture_half_angle": options.aperture_half_angle,
        "seed": options.seed,
        **given_options(options, MEASURED),
    }
    if specimen is not None:
        other = record if other is None else other
        record = measure_like(specimen, other, progress=True, **settings)
    comparison = compare(
        record,
        other,
        uncertainty=options.uncertainty,
        scale_uncertainty=options.scale_uncertainty,
        alpha=options.alpha,
    )
    if options.output is not None:
        comparison.plot(options.output)
    said: list[Any] = [comparison]
    try:
        if options.budget is not None:
            sides = record, other
            said.append(_budget(comparison, specimen, sides, settings, options))
            said[-1].save(options.budget)
    finally:  # also if the effect of the aperture cannot be told
        if options.json:
            tell_json(comparison.to_dict())
        else:
            for one in said:
                tell(one)
    if comparison.undecided:
        return INCOMPLETE
    return DONE if comparison.passed else FAILED


def names_specimen(word: str) -> bool:
    """Whether a word is a scene, a mesh or a BSDF, and no record, table or file."""
    is_word = SPECIMEN.fullmatch(word) and not Path(word).exists()
    return bool(is_word) or Path(word).suffix.lower() in SCENES


def check_not_measured(what: str, options: Namespace, names: Sequence[str]) -> None:
    """Raise ValueError for an option of specimens that are measured; nothing is."""
    given = [option_of(name) for name in given_options(options, names)]
    for option in given + ["-D"] * bool(options.parameters):
        raise SettingError(
            f"{option} applies to a specimen that is to be measured, got {what}"
        )


def _is_record(path: str) -> bool:
    return not names_specimen(path) and Path(path).suffix.lower() in files.ENDINGS


def _other(options: Namespace) -> Any:
    """Record or table that OTHER is; None if it is a specimen."""
    word = options.other
    first_is_data = _is_record(options.record) or is_table(options.record)
    if _is_record(word) or (names_specimen(word) and first_is_data):
        check_no_table_options(word, options)
        return record_of(word) if _is_record(word) else None
    try:
        return table_of(word, options)
    except OpenQuestionsError as error:
        if first_is_data or options.aperture_half_angle is not None:
            raise
        aperture = "unless its header states the aperture, say --aperture-half-angle"
        check_nothing_open(error.place, [*error.questions, aperture])


def _record_and_specimen(options: Namespace, other: Any) -> tuple[Any, Any, Any]:
    """What RECORD is, and the specimen to be measured with its parameters.

    None for what is not there.
    """
    word = options.record
    if is_table(word):
        if not is_table(options.other):
            raise SettingError(
                "RECORD must be an .exr or .npz file or a specimen, unless OTHER is a "
                f"table too, got the table {word}: a table comes second"
            )
        check_not_measured(
            f"the table {word}", options, ("aperture_half_angle", *MEASURED)
        )
        return table_of(word, options), None, None
    if not _is_record(word):
        if _is_record(options.other):
            raise SettingError(
                f"RECORD must be an .exr or .npz file if OTHER is one, got {word}"
            )
        options.variant = options.variant or variant_of(other)
        return None, *specimen_of(word, options)
    if other is None:
        record = record_of(word)
        options.variant = options.variant or variant_of(record)
        return record, *specimen_of(options.other, options)
    check_not_measured(
        f"the record {word}", options, ("aperture_half_angle", *MEASURED)
    )
    return record_of(word), None, None


def _budget(
    comparison: Any,
    specimen: Any,
    sides: tuple[Any, Any],
    settings: dict[str, Any],
    options: Namespace,
) -> Any:
    """Uncertainty budget of a comparison, with the aperture's effect if there is one.

    Common factors of two tables are one. The `settings` are those with which a specimen
    was measured.
    """
    from ...files.measured_table import MeasuredTable
    from ..comparison import aperture_effect, uncertainty_budget

    (record, other), aperture, scale = sides, None, options.scale_uncertainty
    if isinstance(other, MeasuredTable):
        scale = other.scale_uncertainty if scale is None else scale
        in_patches = options.aperture_half_angle is None and other.patches is not None
        if specimen is not None and not in_patches:
            aperture = aperture_effect(specimen, other, comparison, **settings)
    scale = scale or 0.0
    if isinstance(record, MeasuredTable):
        scale = hypot(scale, record.scale_uncertainty)
    return uncertainty_budget(comparison, scale, aperture)

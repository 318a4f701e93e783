"""``gonio-mi fit``: find the parameters of a BSDF from a record or a measured table.

Find the parameters with which a BSDF is closest to a record or to a table of measured
values, their uncertainties from the noise of the one or what the other states, and what
the model cannot follow. A rough model without its distribution is tried with both,
Beckmann and GGX, the closer one first.

examples:
  gonio-mi fit run.npz roughconductor
  gonio-mi fit run.npz roughconductor:distribution=ggx principled -o fits.png
  gonio-mi fit run.npz roughconductor:material=Al --free alpha_u alpha_v
  gonio-mi fit table.csv roughplastic --quantity brdf -o fit.png fit.csv
  gonio-mi fit table.csv diffuse --uncertainty 0.01 --aperture-half-angle 1
  gonio-mi fit run.npz mybsdf:tint=0.5 --free weight=0:1 --plugin mybsdf.py
"""

from argparse import ArgumentParser, Namespace
from collections.abc import Iterator

from ... import files
from ...commands.arguments import (
    DEFAULT_VARIANT,
    DONE,
    add_aperture,
    add_files,
    add_json,
    add_table_options,
    add_text,
    add_uncertainties,
    check_no_table_options,
    given_options,
    say,
    set_variant,
    table_of,
    tell,
    tell_json,
    variant_for,
)
from ...commands.file_kinds import record_of
from ...errors import SettingError
from ...files.measured_table import MeasuredTable
from ...results.record import Record

USAGE = "%(prog)s RECORD|TABLE MODEL ... [options]"

# What may be stated of a table beside how it is read.
STATED = ("uncertainty", "scale_uncertainty", "aperture_half_angle")

# Models that have a distribution of micro-normals to choose.
ROUGH = ("roughconductor", "roughdielectric", "roughplastic")


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    text = "An .exr or .npz file, or a table in any format of gonio-mi compare."
    add_text(parser, "record", "RECORD|TABLE", text)
    add_text(
        parser,
        "models",
        "MODEL",
        "A BSDF in one word with its known parameters, such as roughconductor, "
        "roughdielectric:int_ior=1.5, roughplastic, diffuse or principled.",
        nargs="+",
    )
    add_text(
        parser,
        "--free",
        "NAME",
        "Parameters to be found, or NAME=LOW:HIGH. Default: the usual ones of the "
        "model.",
        nargs="+",
    )
    add_files(parser, "--plugin", text="Python files that register Mitsuba plugins.")
    table = parser.add_argument_group("Table")
    add_table_options(table)
    add_uncertainties(table, "the table")
    add_aperture(table)
    add_json(parser)
    text = "A picture of record and models (.png, .pdf, .svg); the prediction of the "
    text += "closest model, a record (.npz, .exr) or a table (.csv)."
    add_files(parser, "-o", "--output", text=text)


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    from ...instrument.loading import load_plugin_file
    from ...plots.figure import FIGURE_ENDINGS, check_picture
    from ..fitting import fit
    from ..fitting.figure import fit_figure

    pictures = [path for path in options.output if path.endswith(FIGURE_ENDINGS)]
    predictions = [path for path in options.output if path not in pictures]
    for path in pictures:
        check_picture(path)
    is_record = options.record.lower().endswith(files.ENDINGS)
    for path in predictions:
        files.check_output(path, files.ENDINGS if is_record else (".csv",))
    record: Record | MeasuredTable
    if is_record:
        check_no_table_options(options.record, options, STATED)
        record = record_of(options.record)
        set_variant(record.provenance.variant or DEFAULT_VARIANT)
    else:
        record = table_of(options.record, options)
        set_variant(variant_for(record.channel))
    for path in options.plugin:
        load_plugin_file(path)
    stated = given_options(options, STATED)
    fits = [
        fit(record, model, options.free, progress=True, **stated)
        for given in options.models
        for model in _distributions(given)
    ]
    fits.sort(key=lambda one: (one.scatter, one.chi2))
    for path in pictures:
        fit_figure(fits, path)
    for path in predictions:
        fits[0].prediction.save(path)
    if options.json:
        found = [one.to_dict() for one in fits]
        tell_json(found)
    else:
        by = "chi-square" if fits[0].scatter is None else "scatter of the points"
        for i, one in enumerate(fits):
            if len(fits) > 1 and i < 2:
                closest = f"closest of {len(fits)} models, by {by}:"
                tell("further from it:" if i else closest)
            tell(one)
    write = say if options.json else tell
    for note in record.notes if isinstance(record, MeasuredTable) else ():
        write(f"note: {note}")
    return DONE


def _distributions(model: str) -> Iterator[str]:
    """A model with each distribution of micro-normals, if it says none."""
    name, _, rest = model.partition(":")
    if not name:
        raise SettingError(f"MODEL must be a BSDF in one word, got {model!r}")
    if name not in ROUGH or "distribution=" in rest:
        yield model
        return
    parameters = f"{rest}," if rest else ""
    for distribution in ("beckmann", "ggx"):
        yield f"{name}:{parameters}distribution={distribution}"

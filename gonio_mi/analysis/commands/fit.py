"""``gonio-mi fit``: find the parameters of a BSDF from a record, a table or a specimen.

Fit the parameters of a BSDF to a record, to a table of measured values, or to a
specimen that is measured first. Their uncertainties come from the noise of the record,
those of the table, or the misfit of the model, which is printed too. A rough model
without its distribution is tried with both, Beckmann and GGX, the closer one first.

examples:
  gonio-mi fit run.npz roughconductor
  gonio-mi fit principled:roughness=0.5 roughconductor
  gonio-mi fit run.npz roughconductor:distribution=ggx principled -o fits.png
  gonio-mi fit run.npz roughconductor:material=Al --free alpha_u alpha_v
  gonio-mi fit table.csv roughplastic --start alpha=0.005
  gonio-mi fit table.csv roughplastic --quantity brdf -o fit.png fit.csv
  gonio-mi fit table.csv diffuse --uncertainty 0.01 --aperture-half-angle 1
  gonio-mi fit run.npz mybsdf:tint=0.5 --free weight=0:1 --plugin mybsdf.py
  gonio-mi fit run.npz surface.xml --free top.alpha.value+base.alpha.value

The data come first, then the models to be fitted. The eval of a flat specimen without
delta components is integrated, unless --rays is given.
"""

from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from itertools import chain
from typing import Any

from ... import files
from ...commands.arguments import (
    DEFAULT_VARIANT,
    DONE,
    add_aperture,
    add_files,
    add_json,
    add_scene_options,
    add_setting,
    add_table_options,
    add_text,
    add_uncertainties,
    check_no_table_options,
    given_options,
    number,
    say,
    set_variant,
    specimen_of,
    table_of,
    tell,
    tell_json,
    variant_of,
)
from ...commands.file_kinds import record_of
from ...errors import SettingError
from ...files.measured_table import STATED
from .compare import check_not_measured, names_specimen

USAGE = "%(prog)s RECORD|TABLE|SPECIMEN MODEL ... [options]"

# What may be said of how a specimen is measured, beside its angles.
SETTINGS = ("collector", "rays", "rel_err", "estimator", "side", "wavelengths", "seed")
MEASURED = ("theta_i", "phi_i", *SETTINGS)
RAYS = "none where the specimen is flat and has no delta components, else 1e6"
DEFAULTS = {"rays": RAYS, "estimator": "quadrature where it needs no rays, or weighted"}

# Options of some measurements only, for --help-all.
RARE = ("--rel-err", "--estimator", "--side", "--wavelengths", "--seed")

# Models that have a distribution of micro-normals to choose.
ROUGH = ("roughconductor", "roughdielectric", "roughplastic")


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    text = "An .exr or .npz file, a table in any format of gonio-mi compare, or a "
    text += "scene file or a BSDF such as principled:roughness=0.5, to be measured."
    add_text(parser, "record", "RECORD|TABLE|SPECIMEN", text)
    text = "A BSDF in one word with its known parameters, such as roughconductor, "
    text += "roughdielectric:int_ior=1.5, roughplastic, diffuse or principled; or a "
    text += "scene file, with --free."
    add_text(parser, "models", "MODEL", text, nargs="+")
    text = "Parameters to fit, or NAME=LOW:HIGH. Default: the usual ones of the model."
    add_text(parser, "--free", "NAME", text, nargs="+")
    text = "Where the search for a parameter begins, such as alpha=0.01. Default: "
    text += "usual values, of a roughness several."
    add_text(parser, "--start", "NAME=VALUE", text, nargs="+", default=[])
    specimen = parser.add_argument_group("Specimen")
    several: dict[str, Any] = {"nargs": "+", "type": number}
    text = "Angles of incidence in [0, 90). Default: 24 45 66."
    add_text(specimen, "--theta-i", "DEG", text, **several)
    text = "Azimuths of incidence, each combined with each --theta-i. Default: 0."
    add_text(specimen, "--phi-i", "DEG", text, **several)
    for name in SETTINGS:
        add_setting(specimen, name, DEFAULTS.get(name))
    add_scene_options(parser)
    # that of the record, or what a table's channel needs
    parser.set_defaults(variant=None)
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
    from ...plots.figure import FIGURE_ENDINGS, check_picture
    from ...specimen.loading import load_plugin_file
    from ..fitting import fit
    from ..fitting.figure import fit_figure

    pictures = [path for path in options.output if path.endswith(FIGURE_ENDINGS)]
    predictions = [path for path in options.output if path not in pictures]
    for path in pictures:
        check_picture(path)
    word, told = options.record, given_options(options, (*STATED, *MEASURED))
    measured = names_specimen(word)
    is_table = not measured and not word.lower().endswith(files.ENDINGS)
    for path in predictions:
        files.check_output(path, (".csv",) if is_table else files.ENDINGS)
    if not is_table:
        check_no_table_options(word, options, STATED)
    record: Any
    if measured:
        options.variant = options.variant or DEFAULT_VARIANT
        record, told["parameters"] = specimen_of(word, options)
    else:
        check_not_measured(word, options, ("variant", *MEASURED))
        record = table_of(word, options) if is_table else record_of(word)
        set_variant(variant_of(record))
        for path in options.plugin:
            load_plugin_file(path)
    start, fits = dict(map(_start_of, options.start)), []
    for model in chain(*map(_distributions, options.models)):
        found = fit(record, model, options.free, start=start, progress=True, **told)
        fits.append(found)
        record, told = fits[-1].record, {}  # measured, or told, once
    fits.sort(key=lambda one: (one.scatter, one.chi2))
    for path in pictures:
        fit_figure(fits, path)
    for path in predictions:
        fits[0].prediction.save(path)
    if options.json:
        tell_json([one.to_dict() for one in fits])
    else:
        by = "chi-square" if fits[0].scatter is None else "scatter about the model"
        for i, one in enumerate(fits):
            if len(fits) > 1 and i < 2:
                closest = f"closest of {len(fits)} models, by {by}:"
                tell("further from it:" if i else closest)
            tell(one)
    write = say if options.json else tell
    for note in record.notes if is_table else [f"measured {record!r}"] * measured:
        write(f"note: {note}")
    return DONE


def _start_of(word: str) -> tuple[str, float]:
    """Name and value of a start, ``alpha=0.01``."""
    name, _, value = word.partition("=")
    try:
        return name, float(value)
    except ValueError:
        what = f"--start must be NAME=VALUE such as alpha=0.01, got {word!r}"
        raise SettingError(what) from None


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

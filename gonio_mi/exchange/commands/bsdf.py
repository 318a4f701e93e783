r"""``gonio-mi bsdf``: write the BSDF file of a window layer, blind or film.

Measure everything that a Radiance BSDF file contains, and write it: reflection and
transmission of both sides, each incident patch averaged over the patch, in the file's
own patches; of several wavelengths, visible and solar light. The specimen's face to
+z, the front, looks into the room, and its +y is up.

examples:
  gonio-mi bsdf blind.xml --period box --rel-err 0.01 -o blind_klems.xml
  gonio-mi bsdf slat.obj --unit mm --normal y --period 25,25 \
      --bsdf diffuse:reflectance=0.7 --solar-bsdf diffuse:reflectance=0.6 \
      -o blind.xml
  gonio-mi bsdf roughdielectric:alpha=0.1 --basis tensor3 -o film.xml
  gonio-mi bsdf diffuse:reflectance=0.7 --solar diffuse:reflectance=0.6 \
      -o both.xml
  gonio-mi bsdf film.xml --variant llvm_ad_spectral --wavelengths 300 320 340 \
      360 380 400 450 500 550 600 650 700 800 1000 1300 1600 2000 2500 \
      -o film_klems.xml
"""

from __future__ import annotations

import time
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping

import mitsuba as mi

from ...commands.arguments import (
    DONE,
    INCOMPLETE,
    add_json,
    add_number,
    add_quiet,
    add_scene_options,
    add_setting,
    add_specimen,
    add_text,
    check_not_read,
    given_settings,
    specimen_of,
    tell,
    tell_json,
)
from ...commands.campaign_options import (
    add_campaign,
    campaign_options,
    is_imprecise,
    kept_after_ctrl_c,
)
from ...commands.measure import RARE as RARE
from ...commands.surface import add_surface_options, prepared_surface, tell_mesh
from ...errors import SettingError
from ...files import check_output
from ...results.summary_text import aligned
from ...specimen.loading import load_specimen
from ...specimen.shapes import bounds
from ...specimen.specimen_text import SpecimenLike, parse_specimen
from ...surfaces.height_maps import is_height_map
from ...surfaces.meshes import is_mesh
from ...surfaces.topography import metres
from ..exports.bsdf_file import RAYS, bsdf, properties
from ..exports.daylight import VISIBLE_NM, luminous
from ..exports.loss import in_words
from ..formats.radiance import BLOCKS, Product
from ..formats.radiance_basis import BASES

WAVELENGTHS = f"{VISIBLE_NM[0]} to {VISIBLE_NM[-1]} by {VISIBLE_NM[1] - VISIBLE_NM[0]}"

SIZES = ("thickness", "width", "height")

USAGE = "%(prog)s SPECIMEN -o FILE.xml [options]"


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add_specimen(parser)
    group = parser.add_argument_group("File")
    text = "A file that ends in .xml."
    group.add_argument("-o", "--output", required=True, metavar="FILE", help=text)
    text = "Basis: klems, klems-half or klems-quarter, of 145, 77 or 41 patches in "
    text += "each hemisphere, or a tensor tree, tensor3 for isotropic or tensor4 for "
    text += "any specimens. Default: klems."
    add_text(group, "--basis", "BASIS", text, choices=BASES, default="klems")
    text = "Cells per axis of a tensor tree, a power of two. Default: 32 or 16."
    add_number(group, "--cells", "N", text)
    text = "Scene with solar-weighted material data, for the Solar block; not needed "
    text += "with wavelengths from 300 to 2500 nm."
    add_text(group, "--solar", "SPECIMEN", text)
    text = (
        "The same for a mesh or a height map: its BSDF for all sunlight, in one word."
    )
    add_text(group, "--solar-bsdf", "BSDF", text)
    product = parser.add_argument_group("Product")
    text = "Name of the product. Default: the specimen's."
    add_text(product, "--name", "NAME", text)
    text = "Manufacturer of the product. Default: gonio-mi."
    add_text(product, "--manufacturer", "NAME", text, default="gonio-mi")
    for name in SIZES:
        text = f"{name.capitalize()} of the product in metres."
        add_number(product, f"--{name}", "M", text)
    method = parser.add_argument_group("Method")
    add_setting(method, "rays", f"{RAYS}")
    for name in ("rel_err", "max_rays", "batches", "sampler", "seed", "estimator"):
        add_setting(method, name)
    light = parser.add_argument_group("Light and surface interactions")
    for name in ("footprint", "wavelengths", "max_depth", "rr_depth", "period"):
        add_setting(light, name, WAVELENGTHS if name == "wavelengths" else None)
    add_surface_options(parser)
    add_scene_options(parser)
    group = parser.add_argument_group("Campaign")
    add_campaign(group)
    add_quiet(group)
    add_json(parser)


def run(options: Namespace) -> int:
    """Measure, write, and return the exit code."""
    check_output(options.output, (".xml",))
    sizes = {name: _size(options, name) for name in SIZES}
    specimen, parameters = specimen_of(options.specimen, options)
    check_not_read(specimen, options.specimen, [options.output])
    solar = _solar(specimen, options)
    specimen = prepared_surface(specimen, options)
    if not (options.quiet or options.json):
        tell_mesh(specimen, options)
    if sizes["thickness"] is None and options.unit is not None:
        low, high = bounds(load_specimen(specimen, parameters).shapes())
        sizes["thickness"] = float(high[2] - low[2]) * metres(options.unit)

    product = Product(options.name or options.specimen, options.manufacturer, **sizes)
    started = time.perf_counter()
    where = specimen, options.output, options.basis
    settings = given_settings(options) | campaign_options(options)
    settings |= {"parameters": parameters, "progress": not options.quiet}
    settings |= {"solar": solar, "product": product, "cells": options.cells}
    with kept_after_ctrl_c(options.folder):
        records = bsdf(*where, **settings)
    seconds = time.perf_counter() - started
    found = properties({name: luminous(one) for name, one in records.items()})
    if options.json:
        tell_json(found)
    elif not options.quiet:
        from ..exports.radiance_export import READ_BACK, read_back

        tell(_table(found))
        sides = [records["front"], records["back"]]
        for line in in_words(read_back(sides, options.output)):
            tell(f"{READ_BACK}: {line}")
        # of wavelengths, visible and solar records are of the same rays
        sent = records if solar is not None else ("front", "back")
        rays = sum(records[name].ledger.emitted for name in sent)
        channels = records["front"].channels
        basis = options.basis
        if mi.is_spectral and channels != ("Y",):
            basis += f" as at {channels[0]}"
        if "solar front" not in records:
            basis += ", no block Solar"
        of_file = is_mesh(options.specimen) or is_height_map(options.specimen)
        if of_file and sizes["thickness"] is None:
            basis += ", Thickness 0 (give --thickness, or --unit if the file has none)"
        tell(
            f"{options.output}: {basis}, {rays:.3g} rays, {seconds:.0f} s; +- is one "
            f"standard error\nblocks: {BLOCKS}"
        )
    return INCOMPLETE if any(map(is_imprecise, records.values())) else DONE


def _solar(specimen: SpecimenLike, options: Namespace) -> SpecimenLike | None:
    """Specimen of the Solar block, or None."""
    if options.solar_bsdf is None:
        return None if options.solar is None else parse_specimen(options.solar)
    if options.solar is not None:
        raise SettingError("--solar and --solar-bsdf are mutually exclusive")
    if not (is_mesh(options.specimen) or is_height_map(options.specimen)):
        raise SettingError(
            f"--solar-bsdf applies to meshes and height maps, got {options.specimen}: "
            "name the whole specimen with --solar"
        )
    asked = Namespace(**vars(options) | {"bsdf": options.solar_bsdf})
    return prepared_surface(specimen, asked)


def _size(options: Namespace, name: str) -> float | None:
    """Size of the product in metres."""
    value = getattr(options, name)
    if value is not None and not 0 < value < 1e6:
        raise SettingError(f"--{name} must be a positive number of metres, got {value}")
    return None if value is None else float(value)


def _table(found: Mapping[str, Mapping[str, Mapping[str, float]]]) -> str:
    """Rows of sides and light, columns of properties, each with its standard error."""
    sides = [(side, *one) for side, lights in found.items() for one in lights.items()]
    keys = dict.fromkeys(key for *_, row in sides for key in row)
    names = [key for key in keys if not key.endswith("_std_err")]
    lines = []
    for side, light, row in sides:
        errors = {key: row.get(f"{key}_std_err", 0.0) for key in names}
        cells = (f"{row[n]:.4f} +- {errors[n]:.1g}" if n in row else "" for n in names)
        lines.append([f"{side}, {light}", *cells])
    return aligned(["", *names], lines)

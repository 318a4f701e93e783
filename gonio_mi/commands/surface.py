"""``gonio-mi surface``: print height, slope and micro-normal statistics.

Print units, heights, slopes and autocorrelation of a height map, and warnings about its
measurement; for any micro-geometry, the distribution of micro-normals, masking and
shadowing with error bars, compared with those of Beckmann and GGX.

examples:
  gonio-mi surface scan.x3p --form plane --fill nearest -o scan.png
  gonio-mi surface heights.png --size 100 --range 2.5 --unit um
  gonio-mi surface scenes/crossed_threads.xml
"""

from __future__ import annotations

import warnings
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

from ..annexes import ask
from ..errors import SettingError
from ..specimen.specimen_text import SpecimenLike, parse_specimen
from ..surfaces.height_maps import is_height_map
from ..surfaces.heights import FILLS, FORMS
from ..surfaces.meshes import NORMALS, is_mesh
from ..surfaces.topography import UNITS
from .arguments import (
    DONE,
    Group,
    add_number,
    add_scene_options,
    add_setting,
    add_specimen,
    add_text,
    given_options,
    option_of,
    say,
    specimen_of,
    tell,
)

USAGE = "%(prog)s SPECIMEN [options]"

# Options that are properties of the plugin `heightfield`.
HEIGHT_MAP = ("size", "size_y", "scale", "range", "unit", "form", "fill")
SURFACE = (*HEIGHT_MAP, "bsdf", "normal", "mean_plane")


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add_specimen(parser)
    add_surface_options(parser)
    group = parser.add_argument_group("Micro-normals")
    add_setting(group, "period")
    add_number(group, "--points", "N", "Random points of the surface.", 2**18)
    text = "Blocks along each axis for the standard errors."
    add_number(group, "--blocks", "N", text, 4)
    text = "Picture of the micro-normals, such as a.png."
    group.add_argument("-o", "--output", metavar="FIG", help=text)
    add_scene_options(parser)


def add_surface_options(parser: ArgumentParser) -> None:
    """Add the options of height maps and meshes, in a group."""
    axes = ", ".join(NORMALS)
    about = "For a height map, or a mesh (--bsdf, --unit, --normal, --mean-plane)."
    group = parser.add_argument_group("Surface", about)
    _add_height_map(group)
    text = "BSDF of the surface in one word, such as conductor:material=Al. Default: a "
    text += "mirror for a height map, diffuse for heightfield:..., none for a mesh."
    add_text(group, "--bsdf", "BSDF", text)
    text = f"Axis of a mesh file that becomes the specimen's normal, +z ({axes}): the "
    text += "specimen's normal, not the vertical. Default: z."
    add_text(group, "--normal", "AXIS", text, choices=tuple(NORMALS))
    text = "Height of the mean plane of a mesh along the normal axis. Default: middle."
    add_number(group, "--mean-plane", "Z", text)


def _add_height_map(group: Group) -> None:
    """Add the options of :data:`HEIGHT_MAP`."""
    text = (
        "Extent in x, from the first point of a row to the last; with --period, from "
    )
    text += "the first to its repetition, one cell further. "
    text += "Default: as the file states, else 2, with a warning."
    add_number(group, "--size", "X", text)
    text = "Extent in y. Default: as the file states, else by square cells."
    add_number(group, "--size-y", "Y", text)
    text = "Factor on the heights; of an image of integers, the height of a step of 1. "
    text += "Default: 1; such images have none."
    add_number(group, "--scale", "Z", text)
    text = "Height from black to white of an image of integers, instead of --scale."
    add_number(group, "--range", "Z", text)
    units = ", ".join(filter(str.isascii, UNITS))
    text = f"Unit of all lengths, if the file does not state it ({units}). It scales "
    text += "nothing, but lengths can be compared with wavelengths."
    add_text(group, "--unit", "UNIT", text, choices=tuple(UNITS))
    text = f"Form to remove: {', '.join(FORMS)}. Default: keep, which removes none."
    add_text(group, "--form", "FORM", text, choices=tuple(FORMS))
    text = (
        f"Interpolation of points that were not measured: {', '.join(FILLS)} (planes "
    )
    text += "through three points). Default: none, which refuses them."
    add_text(group, "--fill", "FILL", text, choices=FILLS)


def prepared_surface(specimen: SpecimenLike, options: Namespace) -> Any:
    """The specimen, or the shape of a height map or a mesh with the given options.

    The surface of a height map is finite, unless a period joins its last row and column
    to the first. In one word, ``heightfield:alpha=0.2``, it is as the plugin has it.

    Raises
    ------
    ValueError
        If something is given, and it is no such surface, or the word has it too.
    """
    given = given_options(options, HEIGHT_MAP)
    bsdf = None if options.bsdf is None else parse_specimen(options.bsdf)
    if isinstance(bsdf, str):
        raise SettingError(f"--bsdf must be a BSDF in one word, got {bsdf!r}")
    of_mesh = given_options(options, ("normal", "mean_plane"))
    if isinstance(specimen, str) and is_mesh(specimen):
        for name in given.keys() - {"unit"}:
            raise SettingError(f"{option_of(name)} applies to height maps, got a mesh")
        if bsdf is None:
            return specimen  # which is refused in the words of all commands
        from ..specimen.mesh import mesh

        return mesh(specimen, bsdf, **of_mesh)
    for name in of_mesh:
        raise SettingError(
            f"{option_of(name)} applies to meshes, got {options.specimen}"
        )
    if isinstance(specimen, str) and is_height_map(specimen):
        from ..specimen.loading import surface_specimen

        period = getattr(options, "period", None)
        return surface_specimen(specimen, bsdf, period, **given)
    if bsdf is not None:
        given["bsdf"] = bsdf
    if isinstance(specimen, dict) and specimen["type"] == "heightfield":
        for name in given.keys() & specimen.keys():
            raise SettingError(
                f"{option_of(name)} must not be given twice, got {options.specimen}"
            )
        return specimen | given
    for name in given:
        maps = "height maps" + " and meshes" * (name in ("bsdf", "unit"))
        raise SettingError(
            f"{option_of(name)} applies to {maps}, got {options.specimen}"
        )
    return specimen


def tell_mesh(specimen: Any, options: Namespace) -> None:
    """Print in one line how a mesh is understood; nothing of other specimens."""
    from ..specimen.loading import load_specimen
    from ..specimen.shapes import bounds

    if not is_mesh(options.specimen):
        return
    low, high = bounds(load_specimen(specimen, {}).shapes())
    extents = " x ".join(f"{extent:.4g}" for extent in high - low)
    normal = options.normal or "z"
    _, up, _ = NORMALS[normal]
    unit = options.unit or "of the file's unit"
    period = "none" if options.period is None else options.period
    tell(
        f"{options.specimen}: {extents} {unit} in x, y and along the normal, which is "
        f"the file's {normal}; up is its {'xyz'[up.index(1)]}; period {period}"
    )


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    micro_normals = ask("analysis", "micro_normals")
    from ..plots import check_picture
    from ..surfaces.height_maps import read_height_map
    from ..surfaces.images import image_heights
    from ..surfaces.topography import Preparation, topography

    if options.output is not None:
        check_picture(options.output)
    name, parameters = specimen_of(options.specimen, options)
    if options.bsdf is None and isinstance(name, str) and is_mesh(name):
        options.bsdf = "diffuse"  # facets are what they are of any material
    specimen = prepared_surface(name, options)
    joined, said = True, []
    if isinstance(name, str) and is_height_map(name):
        given = given_options(options, HEIGHT_MAP)
        given["height_range"] = given.pop("range", None)
        source = read_height_map(Path(name), image_heights)
        found = topography(source, Preparation(periodic=specimen["periodic"], **given))
        joined = found.periodic
        if found.width_guess:
            tell(found.summary())
            raise SettingError(found.concerns()[0])
        said.append(found.summary() + "\n")
        for concern in found.concerns():
            say(f"warning: {concern}")
    period = options.period or ("box" if joined else "none")
    with warnings.catch_warnings():
        concerns = "the (width|facets|heights|rms height) of"
        warnings.filterwarnings("ignore", concerns, RuntimeWarning)
        settings = given_options(options, ("points", "blocks"))
        normals = micro_normals(
            specimen, parameters=parameters, period=period, **settings
        )
    if options.output is not None:
        normals.plot(options.output)
    for text in [*said, normals]:
        tell(text)
    return DONE

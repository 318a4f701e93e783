"""``gonio-mi surface``: print height, slope and micro-normal statistics.

Of a file of heights, its units, heights, slopes and autocorrelation, and what would
make a measurement doubtful; of that and any other micro-geometry, the distribution of
micro-normals, masking and shadowing with error bars, beside Beckmann's and GGX's.
"""

from __future__ import annotations

import warnings
from argparse import ArgumentParser, Namespace
from pathlib import Path

from .arguments import (
    DONE,
    add_number,
    add_scene_options,
    add_specimen,
    say,
    specimen_of,
    tell,
)
from .setting_options import add_setting
from .surface_options import add_surface_options, given_surface, prepared_surface

__all__ = ["add_options", "run"]

USAGE = "%(prog)s SPECIMEN [options]"

EXAMPLES = """\
examples:
  gonio-mi surface scan.x3p --form plane --fill nearest -o scan.png
  gonio-mi surface heights.png --size 100 --range 2.5 --unit um
  gonio-mi surface scenes/crossed_threads.xml
"""


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add_specimen(parser)
    add_surface_options(parser)
    group = parser.add_argument_group("micro-normals")
    add_setting(group, "period")
    add_number(group, "--points", "N", "random points of the surface", 2**18)
    add_number(
        group, "--blocks", "N", "rows and columns of blocks that give the errors", 4
    )
    group.add_argument(
        "-o", "--output", metavar="FIG", help="picture of them, such as a.png"
    )
    add_scene_options(parser.add_argument_group("scene"))


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    from ..formats.height_maps import is_height_map, read_height_map
    from ..plots import check_picture
    from ..surfaces.images import image_heights
    from ..surfaces.micro_normals import micro_normals
    from ..surfaces.topography import topography

    if options.output is not None:
        check_picture(options.output)
    specimen, parameters = specimen_of(options.specimen, options)
    name = specimen
    specimen = prepared_surface(specimen, options)
    joined = True
    if isinstance(name, str) and is_height_map(name):
        given = given_surface(options)
        given["height_range"] = given.pop("range", None)
        source = read_height_map(Path(name), image_heights)
        found = topography(source, periodic=specimen["periodic"], **given)
        joined = found.periodic
        tell(found.summary() + "\n")
        for concern in found.concerns():
            say(f"warning: {concern}")
    period = options.period or ("box" if joined else "none")
    with warnings.catch_warnings():
        told = "the (width|facets|heights|rms height) of"
        warnings.filterwarnings("ignore", told, RuntimeWarning)
        normals = micro_normals(
            specimen,
            parameters=parameters,
            period=period,
            points=options.points,
            blocks=options.blocks,
        )
    tell(normals)
    if options.output is not None:
        normals.plot(options.output)
    return DONE

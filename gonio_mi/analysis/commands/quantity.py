r"""``gonio-mi quantity``: state gloss, haze, retroreflection and so on.

Measure what an instrument would print of a specimen, under the source and receptor
apertures of the standard, with standard uncertainties and 95 % intervals. Of a table of
measured values these are interpolated within the receptors; the interval holds the
table's uncertainty and what its directions leave open.

examples:
  gonio-mi quantity gloss roughplastic:alpha=0.1
  gonio-mi quantity haze transmittance roughdielectric:alpha=0.05 --rays 1e7
  gonio-mi quantity R_A:entrance=-30 scenes/corner_cubes.xml --json
  gonio-mi quantity gloss60 table.csv --scale-uncertainty 0.01

Names: gloss20, gloss60, gloss85 (gloss: all three), reflection_haze, haze,
transmittance, direct, diffuse, openness, tis, dhr, brf, 45/0, 0/45, 8/di, 8/de, di/8,
de/8, R_A, R_L, lobe_inner, lobe_outer, lobe_asymmetry (lobe: all three). Parameters
follow a colon: brf:theta_i=60,theta_o=20,phi_o=90,receptor=2. Quantities of the same
light share their rays.
"""

import sys
import warnings
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from typing import Any

from ...commands import arguments
from ...commands.file_kinds import is_table
from ...commands.surface import SURFACE, add_surface_options, prepared_surface
from ...files.measured_table import STATED
from .compare import check_not_measured

USAGE = "%(prog)s NAME... SPECIMEN|TABLE [options]"


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    text = "Quantities, such as gloss60 or R_A:observation=0.33."
    arguments.add_text(parser, "names", "NAME", text, nargs="+")
    arguments.add_specimen(parser)
    arguments.add_json(parser)
    arguments.add_quiet(parser)
    light = parser.add_argument_group("Light")
    text = "Azimuth of the plane of incidence."
    arguments.add_number(light, "--phi-i", "DEG", text, 0)
    arguments.add_setting(light, "side")
    arguments.add_setting(light, "footprint")
    arguments.add_setting(light, "wavelengths", "16 from 400 to 700")
    for title in ("method", "events on the surface"):
        arguments.add_settings_group(parser, title)
    add_surface_options(parser)
    arguments.add_scene_options(parser)
    table = parser.add_argument_group("Table")
    arguments.add_table_options(table)
    arguments.add_uncertainties(table, "the table")
    arguments.add_aperture(table)


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    from ..quantities.quantity import quantities

    if is_table(options.specimen):
        return _of_table(options)
    arguments.check_no_table_options(options.specimen, options, STATED)
    specimen, parameters = arguments.specimen_of(options.specimen, options)
    specimen = prepared_surface(specimen, options)
    settings = arguments.given_settings(options) | {"parameters": parameters}
    progress = not options.quiet and sys.stderr.isatty()
    # said below, of all that is printed
    warnings.filterwarnings("ignore", "interrupted: ", RuntimeWarning)
    given = options.names, specimen, options.phi_i, progress, settings
    found, stopped = quantities(*given)
    _tell(found, options)
    if stopped:
        arguments.say("interrupted: the numbers are of what was finished until then")
    return arguments.INCOMPLETE if stopped else arguments.DONE


def _of_table(options: Namespace) -> int:
    """State quantities of a table, of which nothing is measured."""
    from ..quantities.quantity import of_table

    unused = *arguments.given_settings(options), *SURFACE
    check_not_measured(options.specimen, options, unused)
    table = arguments.table_of(options.specimen, options)
    told = arguments.given_options(options, STATED)
    found = of_table(options.names, table, options.phi_i, told)
    _tell(found, options)
    for note in () if options.quiet or options.json else table.notes:
        arguments.tell(f"note: {note}")
    return arguments.DONE


def _tell(found: Sequence[Any], options: Namespace) -> None:
    """Print quantities, as text or as JSON."""
    if options.json:
        arguments.tell_json([one.to_dict() for one in found])
    elif not options.quiet:
        arguments.tell("\n".join(map(str, found)))

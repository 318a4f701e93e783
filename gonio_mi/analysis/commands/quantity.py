r"""``gonio-mi quantity``: state gloss, haze, retroreflection and so on.

Measure what an instrument would print of a specimen, under the source and receptor
apertures of the standard, with standard uncertainties and 95 % intervals.

examples:
  gonio-mi quantity gloss roughplastic:alpha=0.1
  gonio-mi quantity haze transmittance roughdielectric:alpha=0.05 --rays 1e7
  gonio-mi quantity R_A:entrance=-30 scenes/corner_cubes.xml --json

Names: gloss20, gloss60, gloss85 (gloss: all three), reflection_haze, haze,
transmittance, direct, diffuse, openness, tis, brf, 45/0, 0/45, 8/di, 8/de, di/8, de/8,
R_A, R_L, lobe_inner, lobe_outer, lobe_asymmetry (lobe: all three). Parameters follow a
colon: brf:theta_i=60,theta_o=20,phi_o=90,receptor=2. Quantities of the same light share
their rays.
"""

import sys
import warnings
from argparse import ArgumentParser, Namespace

from ...commands import arguments
from ...commands.surface import add_surface_options, prepared_surface

USAGE = "%(prog)s NAME... SPECIMEN [options]"


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


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    from ..quantities.quantity import quantities

    specimen, parameters = arguments.specimen_of(options.specimen, options)
    specimen = prepared_surface(specimen, options)
    settings = arguments.given_settings(options) | {"parameters": parameters}
    progress = not options.quiet and sys.stderr.isatty()
    # said below, of all that is printed
    warnings.filterwarnings("ignore", "interrupted: ", RuntimeWarning)
    given = options.names, specimen, options.phi_i, progress, settings
    found, stopped = quantities(*given)
    if options.json:
        arguments.tell_json([one.to_dict() for one in found])
    elif not options.quiet:
        arguments.tell("\n".join(map(str, found)))
    if stopped:
        arguments.say("interrupted: the numbers are of what was finished until then")
    return arguments.INCOMPLETE if stopped else arguments.DONE

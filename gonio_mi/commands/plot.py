"""``gonio-mi plot``: draw a record.

Draw a record: polar map, and profile in the plane of incidence with error bars. A stack
is drawn as a sheet of the maps of its incident directions, on one colour scale, or as
an animation; --index chooses one of them.

examples:
  gonio-mi plot run.npz -o run.png
  gonio-mi plot stack.npz -o lobe.gif
  gonio-mi plot polarised.npz --stokes 1 1 0 0 -o along_s.png
  gonio-mi plot run.npz --gradient alpha.value -o slope.png
"""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from ..errors import SettingError
from .arguments import DONE, add_number, add_stokes, add_text
from .file_kinds import record_of


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add_text(parser, "record", "RECORD", "An .exr or .npz file.")
    text = "A .png, .pdf or .svg file, or a .gif: an animation of a stack."
    parser.add_argument("-o", "--output", required=True, metavar="FIG", help=text)
    add_stokes(
        parser, "Draw the polarisation of light scattered from this Stokes vector."
    )
    text = "Draw all elements of the Mueller matrices of a polarised record."
    parser.add_argument("--mueller", action="store_true", help=text)
    text = "Draw the derivative by this parameter, of a record with gradients."
    add_text(parser, "--gradient", "NAME", text)
    text = "Number of the incident direction of a stack, from 0. Default: all."
    add_number(parser, "--index", "J", text)


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    record = record_of(options.record)
    from .. import plots  # slow to import

    animated = Path(options.output).suffix.lower() in plots.ANIMATION_ENDINGS
    index, vector = options.index or 0, options.stokes
    if options.mueller + bool(vector) + (options.gradient is not None) > 1:
        raise SettingError(
            "--mueller, --stokes and --gradient are mutually exclusive, got several"
        )
    if options.gradient is not None:
        plots.plot_gradient(record, options.gradient, options.output, index=index)
    elif options.mueller:
        plots.plot_mueller(record, options.output, index=index)
    elif vector:
        plots.plot_stokes(record, options.output, stokes=vector, index=index)
    elif animated:
        if options.index is not None:
            raise SettingError("--index must not be given for an animation of them all")
        plots.animation(record, options.output, progress=True)
    elif options.index is None and len(record) > 1:
        plots.sheet(record, options.output)
    else:
        plots.plot(record, options.output, index=index)
    return DONE

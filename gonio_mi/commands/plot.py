"""``gonio-mi plot``: draw a record.

Draw a record: polar map, and profile in the plane of incidence with error bars. A stack
is drawn as a sheet of the maps of its incident directions, on one colour scale, or as
an animation; --index chooses one of them.
"""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from ..errors import SettingError
from .arguments import DONE, add_number, add_record
from .file_kinds import record_of

EXAMPLES = """\
examples:
  gonio-mi plot run.npz -o run.png
  gonio-mi plot stack.npz -o lobe.gif
"""


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add_record(parser)
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="FIG",
        help="A .png, .pdf or .svg file, or a .gif: an animation of a stack.",
    )
    text = "Number of the incident direction of a stack, from 0. Default: all."
    add_number(parser, "--index", "J", text)


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    record = record_of(options.record)
    from ..plots import ANIMATION_ENDINGS, animation, plot, sheet  # slow to import

    if Path(options.output).suffix.lower() in ANIMATION_ENDINGS:
        if options.index is not None:
            raise SettingError("--index must not be given for an animation of them all")
        animation(record, options.output, progress=True)
    elif options.index is None and len(record) > 1:
        sheet(record, options.output)
    else:
        plot(record, options.output, index=options.index or 0)
    return DONE

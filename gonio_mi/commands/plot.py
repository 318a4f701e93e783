"""``gonio-mi plot``: draw a record.

Draw a record: polar map, and profile in the plane of incidence with error bars.
"""

from argparse import ArgumentParser, Namespace

from .. import files
from .arguments import DONE, add_record, number

__all__ = ["add_options", "run"]

EXAMPLES = """\
example:
  gonio-mi plot run.npz -o run.png
"""


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add_record(parser)
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="FIG",
        help="a .png, .pdf or .svg file",
    )
    parser.add_argument(
        "--index",
        type=number,
        default=0,
        metavar="J",
        help="number of the incident direction of a stack (default: 0, the first)",
    )


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    record = files.load(options.record)
    from ..plots import plot  # matplotlib is an extra, and slow to import

    plot(record, options.output, index=options.index)
    return DONE

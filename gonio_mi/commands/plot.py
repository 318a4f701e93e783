"""``gonio-mi plot``: a picture of a record."""

from argparse import Namespace
from typing import Any

from .. import files
from .arguments import DONE, number

__all__ = ["add", "run"]


def add(commands: Any) -> None:
    """Add the parser of the command."""
    parser = commands.add_parser(
        "plot",
        help="draw a record",
        description="Draw a record: polar map, and profile in the plane of incidence "
        "with error bars.",
        epilog="example:\n  gonio-mi plot run.npz -o run.png",
    )
    parser.set_defaults(run=run)
    parser.add_argument("record", metavar="RECORD", help="an .exr or .npz file")
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

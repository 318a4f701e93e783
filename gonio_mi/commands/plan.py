"""``gonio-mi plan``: how many rays for which reliability.

Say how many rays a measurement needs: by the bounds of Krishnaswamy and others (2004)
on the absolute error of the flux, and for a relative error of all patches at once.
"""

import json
from argparse import ArgumentParser, Namespace
from dataclasses import asdict

from .. import files
from .arguments import DONE, number, tell

__all__ = ["add_options", "run"]

EXAMPLES = """\
examples:
  gonio-mi plan
  gonio-mi plan --collector projected:100x100 --rel-err 0.005
  gonio-mi measure principled --theta-i 30 --rays 1e5 -o pilot.npz
  gonio-mi plan pilot.npz --level 0.99

Without a pilot a white Lambertian specimen is assumed, which lights every patch. The
numbers are for independent rays; the sampler sobol needs fewer.
"""


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    parser.add_argument(
        "pilot",
        nargs="?",
        metavar="PILOT",
        help="a first record of the specimen at one incident direction",
    )
    parser.add_argument(
        "--collector",
        default="projected:30x30",
        metavar="KIND:NTxNP",
        help="patches, without a pilot (default: projected:30x30)",
    )
    parser.add_argument(
        "--epsilon",
        type=number,
        default=0.005,
        metavar="E",
        help="absolute error of a flux fraction, for the bounds (default: 0.005)",
    )
    parser.add_argument(
        "--delta",
        type=number,
        default=0.01,
        metavar="D",
        help="probability of exceeding it (default: 0.01)",
    )
    parser.add_argument(
        "--rel-err",
        type=number,
        default=0.01,
        metavar="X",
        help="relative error of every patch worth reporting (default: 0.01)",
    )
    parser.add_argument(
        "--level",
        type=number,
        default=0.95,
        metavar="P",
        help="probability that no patch exceeds it (default: 0.95)",
    )
    parser.add_argument(
        "--floor",
        type=number,
        default=0.1,
        metavar="F",
        help="patches below this fraction of the mean are not worth reporting "
        "(default: 0.1)",
    )
    parser.add_argument("--json", action="store_true", help="for machines")


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    from ..results.ray_density import plan  # SciPy's statistics are slow to import

    planned = plan(
        None if options.pilot is None else files.load(options.pilot),
        collector=options.collector,
        epsilon=options.epsilon,
        delta=options.delta,
        rel_err=options.rel_err,
        level=options.level,
        floor=options.floor,
    )
    tell(json.dumps(asdict(planned), indent=2) if options.json else planned)
    return DONE

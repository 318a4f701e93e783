"""``gonio-mi plan``: how many rays for which reliability.

Say how many rays a measurement needs: by the bounds of Krishnaswamy and others (2004)
on the absolute error of the flux, and for a relative error of all patches at once.
"""

import json
from argparse import ArgumentParser, Namespace
from dataclasses import asdict

from .arguments import DONE, add_json, add_number, add_text, tell
from .file_kinds import record_of

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
    add_text(
        parser,
        "pilot",
        "PILOT",
        "a first record of the specimen at one incident direction",
        nargs="?",
    )
    add_text(
        parser,
        "--collector",
        "KIND:NTxNP",
        "patches, without a pilot (default: projected:30x30)",
        default="projected:30x30",
    )
    add_number(
        parser,
        "--epsilon",
        "E",
        "absolute error of a flux fraction, for the bounds",
        0.005,
    )
    add_number(parser, "--delta", "D", "probability of exceeding it", 0.01)
    add_number(
        parser, "--rel-err", "X", "relative error of every patch worth reporting", 0.01
    )
    add_number(parser, "--level", "P", "probability that no patch exceeds it", 0.95)
    add_number(
        parser,
        "--floor",
        "F",
        "patches below this fraction of the mean are not worth reporting",
        0.1,
    )
    add_json(parser)


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    from ..results.planning import plan  # SciPy's statistics are slow to import

    pilot = None if options.pilot is None else record_of(options.pilot)
    names = ("collector", "epsilon", "delta", "rel_err", "level", "floor")
    planned = plan(pilot, **{name: getattr(options, name) for name in names})
    tell(json.dumps(asdict(planned), indent=2) if options.json else planned)
    return DONE

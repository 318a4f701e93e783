"""``gonio-mi show``: the numbers of a record."""

import json
from argparse import Namespace
from typing import Any

from .. import files
from ..results.summary import summarize, summary_text
from .arguments import DONE, tell

__all__ = ["add", "run"]


def add(commands: Any) -> None:
    """Add the parser of the command."""
    parser = commands.add_parser(
        "show",
        help="show the numbers of a record",
        description="Show the numbers of a record: reflectance and transmittance with "
        "their intervals, where every ray went, and the worst patches.",
        epilog="example:\n  gonio-mi show run.npz --json | jq .directions[0].dhr",
    )
    parser.set_defaults(run=run)
    parser.add_argument("record", metavar="RECORD", help="an .exr or .npz file")
    parser.add_argument("--json", action="store_true", help="for machines")


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    numbers = summarize(files.load(options.record))
    if options.json:
        print(json.dumps(numbers, indent=2, allow_nan=False))
    else:
        tell(summary_text(numbers))
    return DONE

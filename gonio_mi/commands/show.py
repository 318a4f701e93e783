"""``gonio-mi show``: show the numbers of a record.

Show the numbers of a record: reflectance and transmittance with their intervals, where
every ray went, and the worst patches.
"""

import json
from argparse import ArgumentParser, Namespace

from .. import files
from ..results.summary import summarize, summary_text
from .arguments import DONE, add_record, tell

__all__ = ["add_options", "run"]

EXAMPLES = """\
example:
  gonio-mi show run.npz --json | jq .directions[0].dhr
"""


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add_record(parser)
    parser.add_argument("--json", action="store_true", help="for machines")


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    numbers = summarize(files.load(options.record))
    if options.json:
        print(json.dumps(numbers, indent=2, allow_nan=False))
    else:
        tell(summary_text(numbers))
    return DONE

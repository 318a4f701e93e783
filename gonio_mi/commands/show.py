"""``gonio-mi show``: show the numbers of a record, or how a table is understood.

Show the numbers of a record: reflectance and transmittance with their intervals, where
every ray went, and the worst patches. Of a table of measured values, in text with
columns or a file of another program, show what it holds and what was inferred.
"""

import json
import os
import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from .. import files
from ..errors import SettingError, no_file
from ..results.summary import summarize
from ..results.summary_text import summary_text
from .arguments import DONE, add_json, add_record, tell
from .file_kinds import record_of
from .table_options import (
    add_table_options,
    check_no_table_options,
    table_of,
)

__all__ = ["add_options", "run"]

EXAMPLES = """\
examples:
  gonio-mi show run.npz --json | jq .directions[0].dhr
  gonio-mi show panel.txt --channel 550nm
"""


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add_record(parser)
    add_json(parser)
    parser.add_argument(
        "--all", action="store_true", help="the totals of all incident directions"
    )
    add_table_options(parser.add_argument_group("for a table"))


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    path = options.record
    if Path(path).suffix.lower() not in files.ENDINGS:
        if not os.path.exists(path):
            raise FileNotFoundError(no_file(path))
        if options.json:
            raise SettingError(f"--json goes with a record, got {path!r}")
        tell(table_of(path, options))
        return DONE
    check_no_table_options(path, options)
    summary = summarize(record_of(options.record))
    if options.json:
        print(json.dumps(summary.as_mapping(), indent=2, allow_nan=False))
    else:
        rows = {"most_rows": sys.maxsize} if options.all else {}
        tell(summary_text(summary, **rows))
    return DONE

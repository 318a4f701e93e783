"""``gonio-mi show``: show the numbers of a record, or how a table is understood.

Show the numbers of a record: reflectance and transmittance with their intervals, where
every ray went, and the worst patches. Of a table of measured values, in text with
columns or a file of another program, show what it holds and what was inferred.

examples:
  gonio-mi show run.npz --json | jq .directions[0].dhr
  gonio-mi show panel.txt --channel 550nm
  gonio-mi show polarised.npz --stokes 1 1 0 0
"""

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from ..errors import SettingError, no_file
from .arguments import (
    DONE,
    add_json,
    add_stokes,
    add_table_options,
    add_text,
    check_no_table_options,
    table_of,
    tell,
    tell_json,
)
from .file_kinds import record_of


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    text = "An .exr or .npz file, or a table in any format of gonio-mi compare."
    add_text(parser, "record", "RECORD|TABLE", text)
    add_json(parser)
    text = "Show the totals of all incident directions."
    parser.add_argument("--all", action="store_true", help=text)
    add_stokes(parser, "Show how incident light of this Stokes vector is scattered.")
    add_table_options(parser.add_argument_group("Table"))


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    from .. import files
    from ..results.summary import summarize
    from ..results.summary_text import summary_text

    path = options.record
    if not path.lower().endswith(files.ENDINGS):
        if not Path(path).exists():
            raise FileNotFoundError(no_file(path))
        for name in ("stokes", "json"):
            if getattr(options, name):
                raise SettingError(f"--{name} applies to records only, got {path!r}")
        tell(table_of(path, options))
        return DONE
    check_no_table_options(path, options)
    summary = summarize(record_of(path))
    if options.json and options.stokes:
        raise SettingError(
            "--stokes and --json are mutually exclusive: dhr_mueller is of any light"
        )
    if options.json:
        tell_json(summary.as_mapping())
    else:
        rows = {"most_rows": sys.maxsize} if options.all else {}
        tell(summary_text(summary, **rows, stokes=options.stokes))
    return DONE

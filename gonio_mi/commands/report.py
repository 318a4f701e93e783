"""``gonio-mi report``: write an interactive page of records.

Write one HTML page that opens from disk, without a network: maps with the value under
the pointer, sliders over incident directions, cuts, lobes, totals and ledger; two
records beside each other, with their difference in standard errors. Needs plotly: pip
install ".[report]" in a checkout.

examples:
  gonio-mi report run.npz -o run.html
  gonio-mi report before.npz after.npz -o both.html
"""

from argparse import ArgumentParser, Namespace

from .arguments import DONE, add_text
from .file_kinds import record_of


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add_text(parser, "records", "RECORD", "An .exr or .npz file.", nargs="+")
    text = "An .html file."
    parser.add_argument("-o", "--output", required=True, metavar="PAGE", help=text)


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    from ..reports import report  # plotly is an extra, and large

    report([record_of(one) for one in options.records], options.output, progress=True)
    return DONE

"""``gonio-mi export``: a record in the files of other tools."""

from .. import files
from .arguments import DONE, set_variant

__all__ = ["add", "run"]


def add(commands):
    """Add the parser of the command."""
    parser = commands.add_parser(
        "export",
        help="write a record for other tools",
        description="Write a record for other tools: .csv, a Radiance .xml in the\n"
        "Klems full basis, a .bsdf for Mitsuba's plugin measured, or NetCDF .nc.\n"
        "What was written is read back, and what was lost is said.",
        epilog="example:\n  gonio-mi export run.npz -o run.xml run.bsdf",
    )
    parser.set_defaults(run=run)
    parser.add_argument("record", metavar="RECORD", help="an .exr or .npz file")
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        nargs="+",
        metavar="OUT",
        help="files that end in .csv, .xml, .bsdf or .nc",
    )


def run(options):
    """Run the command and return the exit code."""
    record = files.load(options.record)
    from ..exports import ENDINGS, export  # which needs a renderer

    for path in options.output:
        files.check_output(path, ENDINGS)
    set_variant("llvm_ad_rgb")
    for path in options.output:
        print(path)
        for loss in export(record, path):
            print(f"  {loss}")
    return DONE

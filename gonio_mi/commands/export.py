"""``gonio-mi export``: write a record for other tools.

Write a record for other tools: a table .csv or .astm (after ASTM E1392), a Radiance
.xml, a .bsdf for Mitsuba's plugin measured, or NetCDF .nc. What was written is read
back, and what was lost is said.
"""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from .. import files
from ..errors import SettingError
from ..files.channels import wavelengths_nm
from .arguments import DONE, add_record, set_variant, tell

__all__ = ["add_options", "run"]

EXAMPLES = """\
examples:
  gonio-mi export run.npz -o run.xml run.bsdf
  gonio-mi export run.npz -o run.xml --basis tensor3
"""


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add_record(parser)
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        nargs="+",
        metavar="OUT",
        help="files that end in .csv, .astm, .xml, .bsdf or .nc",
    )
    parser.add_argument(
        "--basis",
        choices=("klems", "tensor3", "tensor4"),
        help="of .xml: the Klems full basis (default), or a tensor tree for isotropic "
        "(3) or any (4) materials",
    )


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    record = files.load(options.record)
    from ..exports.exporting import ENDINGS, export  # which needs a renderer

    for path in options.output:
        files.check_output(path, ENDINGS)
    endings = {Path(path).suffix.lower() for path in options.output}
    if options.basis and ".xml" not in endings:
        raise SettingError(
            f"--basis goes with a file .xml, got {', '.join(options.output)}"
        )
    spectral = wavelengths_nm(record.channels) is not None
    set_variant("llvm_ad_spectral" if spectral else "llvm_ad_rgb")
    for path in options.output:
        tell(path)
        for loss in export(record, path, options.basis or "klems"):
            tell(f"  {loss}")
    return DONE

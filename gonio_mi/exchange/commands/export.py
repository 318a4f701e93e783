"""``gonio-mi export``: write a record for other tools.

Write a record for other tools: a table .csv, a Radiance .xml, a .bsdf for Mitsuba's
plugin measured, NetCDF .nc, HDF5 .h5, a .zemax.bsdf for Zemax, a .brdf or
.anisotropicbsdf for Speos, OpenMATERIAL .json or .xompt, or a .binary as the MERL
database has them. What was written is read back, and what was lost is said.

examples:
  gonio-mi export run.npz -o run.xml run.bsdf run.zemax.bsdf run.brdf
  gonio-mi export run.npz -o run.xml --basis tensor3
  gonio-mi export front.npz back.npz -o both.xml
"""

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

from ... import files
from ...commands.arguments import DONE, add_text, set_variant, tell
from ...commands.file_kinds import record_of
from ...errors import SettingError
from ...results.record import wavelengths_nm
from ..formats.radiance import BLOCKS
from ..formats.radiance_basis import BASES
from ..formats.reading import endings_of, lost_in_each

USAGE = "%(prog)s RECORD [RECORD] -o OUT ... [options]"

__doc__ = f"{__doc__}\nwhat a file cannot hold:\n{lost_in_each()}\n"

# Fraction of the flux in other patches above which a finer basis is named.
MAX_MISPLACED = 0.05


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    text = "An .exr or .npz file; two for .xml, of the front and of the back."
    add_text(parser, "record", "RECORD", text, nargs="+")
    text = f"Files that end in {', '.join(endings_of('writes', 'writes'))}."
    how: Any = {"required": True, "nargs": "+", "metavar": "OUT"}
    parser.add_argument("-o", "--output", help=text, **how)
    text = "Basis of .xml: klems, klems-half, klems-quarter, or a tensor tree, "
    text += "tensor3 for isotropic or tensor4 for any materials. Default: klems."
    add_text(parser, "--basis", "BASIS", text, choices=BASES)
    text = "Report the loss at every incident direction."
    parser.add_argument("--every", action="store_true", help=text)


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    records = [record_of(path) for path in options.record]
    # which need a renderer
    from ..exports.exporting import export
    from ..exports.loss import in_words, written_files

    endings = endings_of("writes", "writes")
    for path in options.output:
        files.check_output(path, endings)
    asked = {Path(path).suffix.lower() for path in options.output}
    if options.basis and ".xml" not in asked:
        got = ", ".join(options.output)
        raise SettingError(f"--basis applies to .xml files only, got {got}")
    spectral = wavelengths_nm(records[0].channels) is not None
    set_variant("llvm_ad_spectral" if spectral else "llvm_ad_rgb")
    said: list[str] = []
    try:
        for path in options.output:
            losses = export(records, path, options.basis or "klems", progress=True)
            said += map(str, written_files(records[0], path))
            lines = losses if options.every else in_words(losses)
            if Path(path).suffix.lower() == ".xml":
                from ..exports.radiance_export import IN_FILE, READ_BACK, read_back

                back = in_words(read_back(records, path))
                lines = [f"{IN_FILE}: {line}" for line in lines]
                lines += [f"{READ_BACK}: {line}" for line in back]
                lines.append(f"blocks: {BLOCKS}")
            said += [f"  {line}" for line in lines]
            in_klems = Path(path).suffix.lower() == ".xml" and not options.basis
            if in_klems and max(one.misplaced for one in losses) > MAX_MISPLACED:
                rank = 4 if len(set(records[0].phi_i.tolist())) > 1 else 3
                said.append(f"  --basis tensor{rank} is finer")
    finally:  # of those files that were written
        for line in said:
            tell(line)
    return DONE

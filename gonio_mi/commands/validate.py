"""``gonio-mi validate``: whether a BSDF plugin is right, and who is wrong."""

import json

from ..instrument.loading import load_specimen
from .arguments import (
    DONE,
    FAILED,
    add_scene_options,
    add_specimen,
    number,
    specimen_of,
    tell,
)

__all__ = ["add", "run"]

EXAMPLES = """\
examples:
  gonio-mi validate roughconductor:alpha=0.2,distribution=ggx
  gonio-mi validate mybsdf:roughness=0.3 --plugin mybsdf.py --report mybsdf.html
  gonio-mi validate scene.xml -D alpha=0.3 --effort thorough --json
  gonio-mi validate cosinelobe --allow reciprocity

Exit code 3: something that --allow does not name biases images or breaks integrators
(with --strict: anything that fails).
"""


def add(commands):
    """Add the parser of the command."""
    parser = commands.add_parser(
        "validate",
        help="examine a BSDF plugin: is it right, which function is wrong?",
        usage="%(prog)s SPECIMEN [options]",
        description="Examine a BSDF plugin: what `sample`, `pdf` and `eval` say of the "
        "same directions, energy,\nreciprocity, transport modes, flags, masks, and the "
        "ends of its domain.",
        epilog=EXAMPLES,
    )
    parser.set_defaults(run=run)
    add_specimen(parser)
    parser.add_argument(
        "--effort",
        default="normal",
        metavar="E",
        help="quick (seconds), normal (default), thorough (minutes)",
    )
    parser.add_argument(
        "--allow",
        default="",
        metavar="NAMES",
        help="properties that the model knowingly lacks: energy,reciprocity",
    )
    parser.add_argument(
        "--strict", action="store_true", help="exit code 3 for whatever fails"
    )
    parser.add_argument("--seed", type=number, default=0, metavar="S")
    parser.add_argument(
        "--alpha",
        type=number,
        default=1e-3,
        metavar="P",
        help="probability with which a right plugin fails (default: 1e-3)",
    )
    parser.add_argument(
        "--report", metavar="HTML", help="write one file with verdict and maps"
    )
    parser.add_argument("--json", action="store_true", help="for machines")
    add_scene_options(parser.add_argument_group("scene"))


def run(options):
    """Run the command and return the exit code."""
    from ..validation import check_report, save_report, validate

    if options.report is not None:
        check_report(options.report)
    specimen, parameters = specimen_of(options.specimen, options)
    if parameters:
        specimen = load_specimen(specimen, parameters)
    verdict = validate(
        specimen,
        effort=options.effort,
        seed=options.seed,
        alpha=options.alpha,
        allow=[name for name in options.allow.split(",") if name],
        strict=options.strict,
    )
    if options.report is not None:
        save_report(verdict, options.report)
    if options.json:
        print(json.dumps(verdict.to_dict(), indent=2, allow_nan=False))
    else:
        tell(verdict)
    return DONE if verdict.passed else FAILED

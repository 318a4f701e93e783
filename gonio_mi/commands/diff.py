"""``gonio-mi diff``: what another Mitsuba version says of the same BSDF.

Compare what two installed versions of Mitsuba say of the same BSDFs, function by
function, in units of their errors, with what a difference means. Without a BSDF, all of
Mitsuba's own that this package knows are compared.
"""

import json
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from ..errors import SpecimenError
from .arguments import (
    DONE,
    FAILED,
    add_number,
    add_scene_options,
    add_text,
    sentence,
    set_variant,
    specimen_of,
    tell,
)

__all__ = ["add_options", "run"]

USAGE = "%(prog)s [BSDF ...] --against VENV [options]"

# The one that wheels of all versions have, with colours.
VARIANT = "llvm_ad_rgb"

EXAMPLES = """\
examples:
  python3 -m venv old && old/bin/pip install mitsuba==3.7.1 numpy
  gonio-mi diff --against old
  gonio-mi diff principled roughplastic:alpha=0.2 --against old
  gonio-mi diff mybsdf:roughness=0.3 --plugin mybsdf.py --against old --json

The other environment needs Mitsuba and NumPy, nothing of this package.
Exit code 3: something differs by more than errors explain.
"""


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add_text(
        parser,
        "specimens",
        "BSDF",
        "BSDFs in one word, or scene files with one shape; none for Mitsuba's own",
        nargs="*",
    )
    add_text(
        parser,
        "--against",
        "VENV",
        "the other virtual environment, or its Python",
        required=True,
    )
    add_number(parser, "--seed", "S", "of the random numbers", 0)
    add_number(
        parser,
        "--alpha",
        "P",
        "probability that equal albedos are said to differ",
        1e-3,
    )
    parser.add_argument("--json", action="store_true", help="for machines")
    add_scene_options(parser.add_argument_group("scene"), (VARIANT,))


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    from ..versions import diff
    from ..versions.asking import interpreter

    interpreter(options.against)  # before anything else takes time
    answers: list[dict[str, Any]] = []
    for name, specimen, parameters in _specimens(options):
        try:
            found = diff(
                specimen,
                options.against,
                parameters=parameters,
                plugins=options.plugin,
                seed=options.seed,
                alpha=options.alpha,
            )
        except SpecimenError as error:
            if len(options.specimens) == 1:
                raise
            answers.append({"name": name, "same": False, "error": sentence(error)})
        else:
            found = replace(found, name=name)
            answers.append(found.to_dict())
        if not options.json:
            tell(f"{name}: {answers[-1]['error']}" if "error" in answers[-1] else found)
    if options.json:
        print(json.dumps(answers, indent=2, allow_nan=False))
    else:
        same = sum(one["same"] for one in answers)
        tell(f"{same} of {len(answers)} are the same")
    return DONE if all(one["same"] for one in answers) else FAILED


def _specimens(options: Namespace) -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """Name, specimen and parameters of each BSDF, when its turn comes."""
    if options.specimens:
        for word in options.specimens:
            yield (word, *specimen_of(word, options))
    else:
        from ..benchmark.stock import cases

        set_variant(options.variant)
        for name, specimen in cases():
            yield name, specimen, {}

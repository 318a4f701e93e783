"""``gonio-mi diff``: compare what two Mitsuba versions say of the same BSDF.

Compare what two installed versions of Mitsuba say of the same BSDFs, function by
function, in units of their errors, with what a difference means. Without a BSDF, all of
Mitsuba's own that this package knows are compared. What one version says can be saved,
and two such files compared.

examples:
  python3 -m venv old && old/bin/pip install mitsuba==3.7.1 numpy
  gonio-mi diff --against old
  gonio-mi diff principled roughplastic:alpha=0.2 --against old
  gonio-mi diff mybsdf:roughness=0.3 --plugin mybsdf.py --against old --json
  gonio-mi diff mybsdf --plugin mybsdf.py --save new.json
  gonio-mi diff mybsdf --plugin mybsdf.py --against old --save old.json
  gonio-mi diff old.json new.json

The other environment needs Mitsuba and NumPy, nothing of this package.
Exit code 3: something differs by more than errors explain.
"""

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

from ...commands.arguments import (
    DONE,
    FAILED,
    add_json,
    add_number,
    add_scene_options,
    add_text,
    sentence,
    set_variant,
    specimen_of,
    tell,
    tell_json,
)
from ...errors import SettingError, SpecimenError, shown
from ...files.writing import check_output

USAGE = """%(prog)s [BSDF ...] --against VENV [options]
       %(prog)s [BSDF ...] [--against VENV] --save ANSWERS.json [options]
       %(prog)s ANSWERS.json OTHERS.json [--alpha P] [--json]"""

# The one that wheels of all versions have, with colours.
VARIANT = "llvm_ad_rgb"


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add_text(
        parser,
        "specimens",
        "BSDF",
        "BSDFs in one word, or scene files with one shape, or two files of --save. "
        "Default: Mitsuba's own BSDFs.",
        nargs="*",
    )
    text = "The other virtual environment, or its Python."
    add_text(parser, "--against", "VENV", text)
    text = "Save the answers of --against, or of this environment; compare nothing."
    add_text(parser, "--save", "JSON", text)
    add_number(parser, "--seed", "S", "Seed of the random numbers.", 0)
    text = "Probability that equal albedos are reported to differ."
    add_number(parser, "--alpha", "P", text, 1e-3)
    add_json(parser)
    add_scene_options(parser, (VARIANT,))


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    from ..versions import diff_saved
    from ..versions.asking import interpreter

    files = [word for word in options.specimens if _is_answers(word)]
    if files:
        if len(files) != len(options.specimens) or len(files) != 2:
            raise SettingError(
                "diff compares BSDFs, or two files of --save, got "
                f"{', '.join(map(shown, options.specimens))}"
            )
        if options.against is not None or options.save is not None:
            raise SettingError(
                "two files of --save cannot be combined with --against or --save"
            )
        return _reported(diff_saved(*files, alpha=options.alpha), options)
    if options.save is not None:
        return _save(options)
    if options.against is None:
        raise SettingError("diff needs --against, two files of --save, or --save")
    interpreter(options.against)  # before anything else takes time
    return _reported(_compared(options), options)


def _is_answers(word: str) -> bool:
    """Whether a word is a file of --save, and no BSDF whose last value ends so."""
    return word.endswith(".json") and "=" not in word


def _reported(found: Iterable[Any], options: Namespace) -> int:
    """Print what was found, and return the exit code."""
    answers: list[dict[str, Any]] = []
    for one in found:
        answers.append(one if isinstance(one, dict) else one.to_dict())
        if not options.json:
            tell(f"{one['name']}: {one['error']}" if isinstance(one, dict) else one)
    if options.json:
        tell_json(answers)
    else:
        same = sum(one["same"] for one in answers)
        tell(f"{same} of {len(answers)} are the same")
    return DONE if all(one["same"] for one in answers) else FAILED


def _compared(options: Namespace) -> Iterator[Any]:
    """Differences of each BSDF, or what went wrong with it if there are several."""
    from ..versions import diff

    for name, specimen, asked in _specimens(options):
        try:
            found = diff(specimen, options.against, alpha=options.alpha, **asked)
        except SpecimenError as error:
            if len(options.specimens) == 1:
                raise
            yield {"name": name, "same": False, "error": sentence(error)}
        else:
            yield replace(found, name=name)


def _save(options: Namespace) -> int:
    """Save what one environment says of each BSDF."""
    from ..versions import save_answers, saved
    from ..versions.asking import interpreter

    check_output(options.save, (".json",))
    python = interpreter(options.against or sys.executable)
    entries = [
        saved(specimen, python, name=name, **asked)
        for name, specimen, asked in _specimens(options)
    ]
    save_answers(options.save, entries)
    return DONE


def _specimens(options: Namespace) -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """Name, specimen and how each BSDF is asked, when its turn comes."""
    asked = {"plugins": options.plugin, "seed": options.seed}
    for word in options.specimens:
        specimen, parameters = specimen_of(word, options)
        yield word, specimen, {"parameters": parameters, **asked}
    if not options.specimens:
        from ..versions.stock import cases

        set_variant(options.variant)
        for name, specimen in cases():
            yield name, specimen, asked
